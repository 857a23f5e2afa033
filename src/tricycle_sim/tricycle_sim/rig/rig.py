"""Base of all rigs: vehicle, steer board and drive board on one clock."""

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable, Collection

from tricycle_bridge.protocol.messages import Board, Fault, PlcState, ResetCause
from tricycle_core.closing import Closing
from tricycle_core.errors import ExcitationError, PlantError
from tricycle_core.poses import Pose
from tricycle_core.timing import TICK
from tricycle_sim.plants.own import OwnPlant
from tricycle_sim.plants.plant import HoldsSpeed, Plant
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan, RigFault
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import ORIGIN, LiveState

_VECTORS = {"quaternion", "specific_force", "wheel_speeds", "loads"}
# numbers of a plant's state: name, and whether it is a tuple of them
_TOLD = [(field.name, field.name in _VECTORS) for field in dataclasses.fields(LiveState)]
_RESET = {Board.STEER: FaultKind.STEER_RESET, Board.DRIVE: FaultKind.DRIVE_RESET}
_HANG = {Board.STEER: FaultKind.STEER_HANG, Board.DRIVE: FaultKind.DRIVE_HANG}
_CABLE = {Board.STEER: FaultKind.STEER_CABLE, Board.DRIVE: FaultKind.DRIVE_CABLE}


class Rig(Closing):
    """Vehicle, steer board and drive board on one clock; `step` advances it by 10 ms.

    Bytes in, bytes and states out; ports, wall clock and topics belong to the node that owns it.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    faults : FaultPlan
        Faults of wires, boards and host.
    plant : Plant, optional
        Plant that the boards drive; by default our own model of the vehicle.
    """

    def __init__(
        self, vehicle: Vehicle, faults: FaultPlan = NO_FAULTS, plant: Plant | None = None
    ) -> None:
        self._vehicle = vehicle
        self._plan = faults
        self._faults = faults.at(0.0)
        self._ticks = 0
        self._plant = OwnPlant(vehicle) if plant is None else plant
        self._holds_speed = self._plant if isinstance(self._plant, HoldsSpeed) else None
        self._steered = False
        self._place(ORIGIN)

    @property
    def steered(self) -> bool:
        """Whether the servo got pulses in the last step: without, real steering turns freely."""
        return self._steered

    @property
    def time(self) -> float:
        """Simulated time in s; it never goes back."""
        return self._ticks * TICK

    @property
    def host_time(self) -> float:
        """Reading of the host's clock [s]: `time` and the clock's steps."""
        return self.time + self._faults.get(FaultKind.HOST_CLOCK, 0.0)

    @property
    def state(self) -> LiveState:
        """The vehicle's state at `time`."""
        return self._state

    @property
    def armed(self) -> bool:
        """Whether both boards are armed."""
        return all(self.plc_state(board) is PlcState.ARMED for board in (Board.STEER, Board.DRIVE))

    @abstractmethod
    def plc_state(self, board: Board) -> PlcState:
        """Return a board's state.

        Parameters
        ----------
        board : Board
            Steer or drive.
        """

    @abstractmethod
    def plc_faults(self, board: Board) -> Fault:
        """Return a board's faults.

        Parameters
        ----------
        board : Board
            Steer or drive.
        """

    @property
    def answered(self) -> bool:
        """Whether both boards were sent a command since the last step."""
        return all(self.heard(board) for board in (Board.STEER, Board.DRIVE))

    @abstractmethod
    def heard(self, board: Board) -> bool:
        """Return whether a board was sent a command since the last step.

        Parameters
        ----------
        board : Board
            Steer or drive.
        """

    @property
    def active_faults(self) -> set[FaultKind]:
        """Kinds of the faults that act at `time`."""
        return set(self._faults)

    def plugged(self, board: Board) -> bool:
        """Return whether a board's cable is in the host.

        Parameters
        ----------
        board : Board
            Steer or drive.
        """
        return _CABLE[board] not in self._faults

    def fail(self, kinds: Collection[FaultKind]) -> None:
        """Set the faults that act from the next step on; those already acting continue.

        Parameters
        ----------
        kinds : collection of FaultKind
            Parts that fail; empty: all are repaired.
        """
        began = {fault.kind: fault.start for fault in self._plan.faults}
        start = self.time + TICK  # the tick in which the next step looks at the plan
        self._plan = FaultPlan(
            tuple(RigFault(kind, min(began.get(kind, start), start)) for kind in kinds)
        )

    def reset(self, start: Pose = ORIGIN) -> None:
        """Put the vehicle at rest at a pose and reboot both boards; the clock is not reset.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].

        Raises
        ------
        PlantError
            If the plant cannot be placed there.
        LinkError
            If a board does not boot.
        """
        self._place(start)
        self._rest()
        for board in (Board.STEER, Board.DRIVE):
            self._reboot(board, ResetCause.EXTERNAL)

    def receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes of the host to a board; return its immediate answers.

        Parameters
        ----------
        board : Board
            Steer or drive.
        data : bytes
            Bytes as they come from the line.
        """
        if self._cut_off(board) or _HANG[board] in self._faults:
            return b""
        return self._receive(board, data)

    def step(self) -> dict[Board, bytes]:
        """Run one tick: boards measure and control, the vehicle moves. Return what boards sent.

        Raises
        ------
        PlantError
            If the plant has failed, or its state is not finite.
        LinkError
            If a board has crashed.
        """
        hung = {board for board in _HANG if _HANG[board] in self._faults}
        sent = self._step(hung)
        sent = {board: b"" if self._cut_off(board) else data for board, data in sent.items()}
        self._ticks += 1
        if self._plan.faults or self._faults:
            self._fail()
        return sent

    def close(self) -> None:
        """Free what boards and plant hold."""
        self._plant.close()

    def _place(self, start: Pose) -> None:
        self._take(lambda: self._plant.place(start))

    def _advance(
        self, steering: float | None, torque: float, brake: float, speed: float | None = None
    ) -> None:
        """Move the plant on by a tick; a `speed` is for one that holds speeds."""
        tick, plant = self._ticks, self._holds_speed
        self._steered = steering is not None
        if speed is None or plant is None:
            self._take(lambda: self._plant.advance(tick, steering, torque, brake))
        else:
            self._take(lambda: plant.hold_speed(tick, steering, speed, brake))

    def _take(self, move: Callable[[], LiveState]) -> None:
        """Take the state that the plant has after a move."""
        what = f"plant {type(self._plant).__name__} at {self.time:.2f} s"
        try:
            state = move()
            wrong = _wrong(state)
        except ExcitationError:
            raise
        except Exception as error:  # whatever somebody's plant may raise
            raise PlantError(f"{what}: {error!r}") from error
        if wrong:
            raise PlantError(f"{what}: {wrong}")
        self._state = state

    def _fail(self) -> None:
        """Take the faults of the new tick; reset the boards that they reset."""
        before, self._faults = self._faults, self._plan.at(self.time)
        begun, ended = self._faults.keys() - before.keys(), before.keys() - self._faults.keys()
        for board in (Board.STEER, Board.DRIVE):
            if _HANG[board] in ended:
                self._reboot(board, ResetCause.WATCHDOG)
            elif _RESET[board] in begun or _CABLE[board] in ended:
                self._reboot(board, ResetCause.EXTERNAL)

    def _cut_off(self, board: Board) -> bool:
        return FaultKind.HOST_SILENT in self._faults or not self.plugged(board)

    def _rest(self) -> None:
        """Forget what the vehicle's sensors have counted."""

    @abstractmethod
    def _reboot(self, board: Board, cause: ResetCause) -> None:
        """Bring a board into the state after its reset."""

    @abstractmethod
    def _receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes to a board that gets them; return its immediate answers."""

    @abstractmethod
    def _step(self, hung: set[Board]) -> dict[Board, bytes]:
        """Run one tick, in which the hung boards keep their outputs; return what boards sent."""


def _wrong(state: object) -> str:
    """Return what no instrument could read of a plant's state; empty: nothing."""
    if not isinstance(state, LiveState):
        return f"tells {type(state).__name__}, no LiveState"
    for name, several in _TOLD:
        value = getattr(state, name)
        if not math.isfinite(sum(value) if several else value):
            return f"{name} is {value}, no finite number"
    return ""
