"""excitation_planner: plans on request in a process of its own and publishes the newest plan."""

import multiprocessing
import signal
import sys
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from excitation_planner import planning
from excitation_planner.area.area import load_area
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import NOISE_FIELDS, MeasurementNoise
from excitation_planner.maneuver import (
    family_by_name,
    family_names,
    parse_ranges,
    with_lead_in,
    with_ranges,
)
from excitation_planner.maneuver.lead_in import LONGEST
from excitation_planner.plan import Plan, load_plan, save_plan
from excitation_planner.plan_publisher import PlanPublisher
from excitation_planner.planning import PlanRequest, check_vehicle
from tricycle_core.diagnostics import Level
from tricycle_core.documents import check_folder
from tricycle_core.errors import ExcitationError, PlanError, message_of
from tricycle_core.nodes import declare, overridable, run_node
from tricycle_sim.effects import named_effects
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, load_vehicle, warnings_about

POLL = 0.2  # s between polls of the planning process
DIAGNOSTICS_PERIOD = 1.0  # s
SPAWN = multiprocessing.get_context("spawn")  # a fork would inherit the middleware's threads
PLAN_PARAMETERS = (
    *("vehicle_file", "area_file", "maneuver", "ranges", "lead_in", "target"),
    *("criterion", "effects", "samples", "budget", "seed"),
    *NOISE_FIELDS,
)
Settings = dict[str, Any]  # parameter name -> value, as declared below


def _request(settings: Settings) -> PlanRequest:
    """Request that the parameters describe; raises ExcitationError or OSError."""
    file = settings["vehicle_file"]
    ranges = parse_ranges([text for text in settings["ranges"] if text])
    family = family_by_name(settings["maneuver"])
    families = with_ranges([family], ranges, smaller=bool(settings["area_file"]))
    if settings["lead_in"] >= 0.0:
        families = with_lead_in(families, settings["lead_in"])
    return PlanRequest(
        vehicle=load_vehicle(Path(file) if file else None),
        family=families[0],
        target=settings["target"],
        criterion=Criterion(settings["criterion"]),
        samples=settings["samples"],
        budget=settings["budget"],
        seed=settings["seed"],
        noise=MeasurementNoise(**{name: settings[name] for name in NOISE_FIELDS}),
        area=load_area(Path(settings["area_file"])) if settings["area_file"] else None,
        effects=named_effects(settings["effects"], planned=True),
    )


def _plan_in_process(settings: Settings, output: Path, connection: Connection) -> None:
    """Plan and save to `output`; send ("progress", done, total), ("done",) or ("failed", why)."""
    # Ctrl-C is the node's to handle; it sends SIGTERM, on which workers are shut down in order
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    try:
        plan = planning.plan_maneuver(  # imports SciPy and Numba: in this process only
            _request(settings),
            progress=lambda done, total: connection.send(("progress", done, total)),
        )
        save_plan(plan, output)
        connection.send(("done",))
    except BrokenPipeError:  # the node was killed
        sys.exit(1)
    except (ExcitationError, OSError) as error:
        connection.send(("failed", message_of(error)))


class ExcitationPlanner(Node):
    """Starts and watches the planning process; publishes plans from files."""

    def __init__(self) -> None:
        super().__init__("excitation_planner")
        setting = partial(declare, self, read_only=False)
        setting("vehicle_file", "", "vehicle YAML; empty: the packaged tricycle")
        setting("area_file", "", "YAML of the ground that plans stay on; empty: no limit")
        setting("other_vehicle", False, "take plan files of other vehicles than this one")
        setting("maneuver", "circle", f"family: {', '.join(family_names())}")
        setting("ranges", [""], "search box: NAME=LOW:HIGH of operation parameters, as radius=3:12")
        setting(
            "lead_in",
            -1.0,
            "m of straight before the family's own, on which the driver steers closed loop while "
            "the vehicle gets up to speed; negative: all is open loop",
            (-1.0, LONGEST),
        )
        setting("target", UNKNOWN_PARAMETERS[0], "unknown parameter to excite")
        setting("criterion", Criterion.C.value, f"what is minimised: {', '.join(Criterion)}")
        setting("effects", "none", "counted as not known either: all, or names with commas")
        setting("samples", 100, "for criterion h: simulations per maneuver", (1, 1e6))
        setting("budget", 12_000, "largest number of simulations of the search", (1, 1e9))
        setting("seed", 0, "same seed, same plan", (0, 2**31 - 1))
        for name, (unit, text) in NOISE_FIELDS.items():
            setting(name, getattr(MeasurementNoise, name), f"{unit}, {text}", (0, 1e4))
        setting("plan_file", "plan.json", "the newest plan: published when it exists or is made")
        self._plans = PlanPublisher(self)
        self._plan: Plan | None = None
        self._checked: Plan | None = None  # of the newest plan_file that was set
        self._process: SpawnProcess | None = None
        self._connection: Connection | None = None
        self._planned = Path()  # file of the plan that is being made
        self._progress = (0, 0)
        self._problem = ""
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", **overridable(10)
        )
        self.create_service(Trigger, "~/plan", self._on_plan)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self.add_post_set_parameters_callback(self._on_parameters)
        self.add_on_set_parameters_callback(self._check_parameters)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # planning goes on without a /clock
        self.create_timer(POLL, self._watch, clock=steady)
        self.create_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics, clock=steady)
        try:
            _request(self._settings()).check_budget()
            check_folder(self._file.absolute().parent)
        except (ExcitationError, OSError) as error:  # a file is published
            self.get_logger().warning(f"no plan can be made: {message_of(error)}")
        if self._file.exists():
            try:
                self._publish(self._load(self._file, {}))
            except PlanError as error:  # a new plan will replace it
                self.get_logger().error(f"not published: {error}")

    @property
    def _file(self) -> Path:
        return Path(self.get_parameter("plan_file").value)

    def _load(self, file: Path, new: Settings) -> Plan:
        """Return the plan in a file; raises PlanError if it is for another vehicle."""
        plan = load_plan(file)
        vehicle, other = (
            new.get(name, self.get_parameter(name).value)
            for name in ("vehicle_file", "other_vehicle")
        )
        if not other:
            try:
                check_vehicle(plan, load_vehicle(Path(vehicle) if vehicle else None))
            except PlanError as error:
                raise PlanError(f"{error}, or set the parameter other_vehicle") from error
        return plan

    def _publish(self, plan: Plan) -> None:
        self._plan = plan
        self._plans.publish(plan)
        self.get_logger().info(f"plan {plan.id}: {plan.maneuver} for {plan.target}")

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse what no plan can be made of, and a plan file that is not one of this vehicle."""
        new = {parameter.name: parameter.value for parameter in parameters}
        try:
            if new.keys() & set(PLAN_PARAMETERS):
                _request(self._settings() | new)
            if "plan_file" in new:
                file = Path(new["plan_file"])
                self._checked = self._load(file, new) if file.exists() else None
                if self._checked is None:
                    check_folder(file.absolute().parent)
        except (ExcitationError, OSError) as error:
            return SetParametersResult(successful=False, reason=message_of(error))
        return SetParametersResult(successful=True)

    def _warn_about(self, request: PlanRequest) -> None:
        """Log what is doubtful about files that were given."""
        warnings = []
        if file := self.get_parameter("vehicle_file").value:
            warnings += [f"{file}: {warning}" for warning in warnings_about(request.vehicle)]
        if request.area is not None and request.area.doubt:
            warnings.append(f"{self.get_parameter('area_file').value}: {request.area.doubt}")
        for warning in warnings:
            self.get_logger().warning(warning)

    def _settings(self) -> Settings:
        return {name: self.get_parameter(name).value for name in PLAN_PARAMETERS}

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        if any(parameter.name == "plan_file" for parameter in parameters) and self._checked:
            self._publish(self._checked)

    def _on_plan(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = False
        if self._process is not None:
            response.message = "planning is under way; ~/cancel ends it"
            return response
        settings = self._settings()
        try:
            request = _request(settings)
            request.check_budget()
            check_folder(self._file.absolute().parent)
        except (ExcitationError, OSError) as error:
            response.message = message_of(error)
            return response
        self._warn_about(request)
        self._connection, theirs = SPAWN.Pipe(duplex=False)
        self._planned = self._file.absolute()
        self._process = SPAWN.Process(
            target=_plan_in_process, args=(settings, self._planned, theirs)
        )
        self._process.start()
        theirs.close()
        self._progress, self._problem = (0, 0), ""
        response.success, response.message = True, "planning started; see /diagnostics"
        return response

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._process is not None
        response.message = "cancelled" if response.success else "nothing is being planned"
        if response.success:
            self._end("cancelled")
        return response

    def _watch(self) -> None:
        """Read what the planning process has sent."""
        if self._process is None or self._connection is None:
            return
        try:
            while self._connection.poll():
                kind, *content = self._connection.recv()
                if kind == "progress":
                    self._progress = (content[0], content[1])
                elif kind == "failed":
                    self._end(content[0])
                    return
                else:
                    plan = load_plan(self._planned)
                    self._end("")
                    self._publish(plan)
                    return
        except EOFError:
            self._end("the planning process died")
        except (PlanError, OSError) as error:
            self._end(message_of(error))

    def _end(self, problem: str) -> None:
        """End the planning process, or reap one that has ended."""
        if self._process is not None and self._connection is not None:
            if problem:
                self._process.terminate()
            self._process.join()
            self._connection.close()
        self._process = self._connection = None
        self._problem = problem
        if problem:
            self.get_logger().error(f"planning: {problem}")

    def _publish_diagnostics(self) -> None:
        status = DiagnosticStatus(name="excitation_planner: plan", hardware_id="")
        done, total = self._progress
        if self._process is not None:
            counted = f"{done} of at most {total} simulations" if total else "no simulation yet"
            status.message = f"planning: {counted}"
        elif self._problem:
            status.level, status.message = bytes([Level.WARN]), self._problem
        elif self._plan is None:
            status.message = "no plan yet; call ~/plan"
        else:
            excites = f"excites {self._plan.target}"
            if self._plan.predicted_cost is None:
                excites = f"a given maneuver: whether it {excites} was not judged"
            status.message = self._plan.verdict or excites
        values = {"simulations": str(done), "budget": str(total)}
        if (plan := self._plan) is not None:
            values |= {"plan_id": plan.id, "vehicle_hash": plan.vehicle_hash}
            values |= {f"S {name}": f"{index.value:.4f}" for name, index in plan.main.items()}
            values |= {f"ST {name}": f"{index.value:.4f}" for name, index in plan.total.items()}
            values |= {"H": f"{plan.cost:.4f}", "criterion": plan.criterion.value}
            values |= {f"std {name}": f"{std:.4g}" for name, std in plan.predicted_std.items()}
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def destroy_node(self) -> None:
        """End a planning process that is still at work."""
        if self._process is not None:
            self._end("the node is shutting down")
        super().destroy_node()


def main() -> None:
    """Run the node."""
    run_node(ExcitationPlanner)
