"""Reports: what is in the files is on the page, and the page works in a browser that is offline."""

import dataclasses
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.plan import SearchHistory, load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at
from trajectory_recorder.bag.topics import Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import main
from tricycle_cli.reports import interactive_figures
from tricycle_cli.reports.run_folder import Maneuver, Run, read_run, wheel_loads
from tricycle_cli.reports.run_page import run_page
from tricycle_core.errors import ReportError
from tricycle_sim.vehicle import load_vehicle

TYPES = jazzy().types
VEHICLE = load_vehicle()
OFFSET = 0.05  # m to the left that the recorded vehicle drives
START = 1_000_000_000_000  # ns
HOSTILE = "</script><img src=x onerror=alert(1)>"


def header(ns):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="odom")


def pose(x, y, yaw):
    return TYPES["geometry_msgs/msg/Pose"](
        position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)
        ),
    )


def odometry(ns, x, y, yaw):
    zero = TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(ns),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(x, y, yaw), covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
            twist=TYPES["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
            covariance=np.zeros(36),
        ),
    )


def status(plan, state):
    values = {"state": state, "plan_id": plan.id, "start_time": f"{START / 1e9:.9f}"}
    values |= {"duration": f"{plan.reference.time[-1]:.3f}"}
    return TYPES["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0,
        name="maneuver_driver: maneuver",
        message=state,
        hardware_id="",
        values=[TYPES["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()],
    )


def joints(ns, angle, rate):
    return TYPES["sensor_msgs/msg/JointState"](
        header=header(ns),
        name=["steering_motor_joint", "rear_wheel_joint"],
        position=np.array([angle, 0.0]),
        velocity=np.array([0.0, rate]),
        effort=np.array([]),
    )


def record(plan, bag, *, end="done"):
    """A bag of the plan driven `OFFSET` to the left, after a second of standstill."""
    reference = plan.reference
    path = TYPES["nav_msgs/msg/Path"](
        header=header(0),
        poses=[
            TYPES["geometry_msgs/msg/PoseStamped"](header=header(round(t * 1e9)), pose=pose(*at))
            for t, *at in zip(*vars(reference).values(), strict=True)
        ],
    )
    rows = [(START - 10**9, "maneuver/reference", path)]
    rows += [(START, "maneuver/state", status(plan, "running"))]
    time = np.arange(-1.0, reference.time[-1] + 0.5, 0.01)
    x, y, yaw = (
        np.interp(time, reference.time, v) for v in (reference.x, reference.y, reference.yaw)
    )
    y = y + OFFSET * (time > 0.0)
    for ns, *at in zip(START + np.round(time * 1e9).astype(int), x, y, yaw, strict=True):
        rows += [(int(ns), "odom", odometry(int(ns), *map(float, at)))]
        rows += [(int(ns), "joint_states", joints(int(ns), 0.25, 2.0))]
    rows += [(rows[-1][0], "maneuver/state", status(plan, end))]
    with BagWriter(bag) as writer:
        ids = {}
        for ns, name, message in rows:
            kind = message.__msgtype__
            if name not in ids:
                ids[name] = writer.add_topic(Topic.of_type(f"/{name}", kind))
            writer.write(ids[name], ns, bytes(jazzy().serialize_cdr(message, kind)))


@pytest.fixture(scope="module")
def plan():
    request = PlanRequest(VEHICLE, Circle(duration=4.0), "cornering_stiffness", samples=20)
    x, y = np.meshgrid([2.5, 3.0, 4.0], [0.7, 0.9])
    tried = np.column_stack([x.ravel(), y.ravel()])
    cost = np.array([3.0, 2.0, 2.5, 1.5, 1.0, np.inf])
    found = plan_at(request, np.array([3.0, 0.8]))
    return dataclasses.replace(found, search=SearchHistory(tried, cost))


@pytest.fixture
def folder(plan, tmp_path):
    save_plan(plan, tmp_path / "plans" / "designed.json")
    record(plan, tmp_path / "bags" / "recorded")
    (tmp_path / "result.json").write_text(json.dumps({"designed": {"te_expected": 0.00123}}))
    return tmp_path


def test_a_bag_is_shown_with_the_plan_that_was_driven_whatever_their_names(folder, plan):
    (maneuver,) = read_run(folder).maneuvers
    assert maneuver.name == "designed"
    assert maneuver.plan.id == plan.id
    assert maneuver.judgement.te == pytest.approx(OFFSET**2, rel=0.01)
    assert maneuver.te_expected == 0.00123
    assert np.all(maneuver.joints.wheel_rate == 2.0)
    assert maneuver.joints.time[0] == 0.0


def test_the_table_says_what_was_measured(folder):
    page = run_page(read_run(folder), vehicle=VEHICLE)
    table = page.partition("<h2>Results</h2>")[2].partition("</table>")[0]
    for text in ("designed", "radius 3, speed 0.8", "0.00123", "50.0"):
        assert f">{text}<" in table


def test_the_command_writes_one_file_and_says_where(folder, capsys):
    assert main(["report", str(folder), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"report": str(folder / "report.html"), "maneuvers": ["designed"]}
    assert {p.name for p in folder.iterdir()} == {"plans", "bags", "result.json", "report.html"}


@pytest.mark.parametrize("where", ["", "bags", "bags/recorded", "plans/.."])
def test_any_directory_of_a_run_will_do(folder, where, capsys):
    assert main(["report", str(folder / where), "--output", str(folder / "r.html")]) == 0
    assert (folder / "r.html").stat().st_size > 1e6


def test_a_bag_that_cannot_be_judged_is_shown_with_its_reason(plan, tmp_path):
    record(plan, tmp_path / "bag", end="aborted")
    (maneuver,) = read_run(tmp_path).maneuvers
    assert "aborted" in maneuver.failure
    assert "Not judged" in run_page(read_run(tmp_path), vehicle=VEHICLE)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "holds no plan"),
        ({"result.json": "[1]"}, "must hold an object"),
        ({"result.json": "{"}, "not JSON"),
        ({"result.json": "[" * 100_000}, "not JSON"),
        ({"plan.json": "{}"}, "plan.json: schema None"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(content, message, tmp_path, capsys):
    for name, text in content.items():
        (tmp_path / name).write_text(text)
    assert main(["report", str(tmp_path)]) == 2
    errors = capsys.readouterr().err
    assert message in errors.splitlines()[-1]
    assert {p.name for p in tmp_path.iterdir()} == set(content)


def test_no_directory_is_told(tmp_path):
    with pytest.raises(ReportError, match="is not a directory"):
        read_run(tmp_path / "nowhere")


def test_loads_carry_the_vehicle_and_belong_to_the_plans_vehicle(plan):
    loads = wheel_loads(VEHICLE, plan)
    carried = loads.left + loads.right + loads.rear
    assert np.mean(carried) == pytest.approx(VEHICLE.mass * VEHICLE.gravity, rel=1e-3)
    other = dataclasses.replace(plan, vehicle_hash="0" * 64)
    run = Run(Path("run"), (Maneuver("other", other),))
    assert "No wheel loads" in run_page(run, vehicle=VEHICLE)


def test_figures_show_the_numbers_of_the_plan(plan):
    main_index, total = interactive_figures.indices(plan).data
    assert main_index.name == "main index S"
    assert list(main_index.x) == [index.value for index in plan.main.values()]
    assert list(total.error_x.array) == [i.high - i.value for i in plan.total.values()]
    traces = {
        trace.name: trace for trace in interactive_figures.search_path(plan, plan.search).data
    }
    assert list(traces["best so far"].x) == [2.5, 3.0, 2.5, 3.0]  # costs 3, 2, 1.5, 1
    assert list(traces["cannot be driven"].x) == [4.0]


IDENTIFIED = {
    "level": 0.95,
    "parameters": {
        "cornering_stiffness": {
            "estimate": 610.0, "low": 590.0, "high": 640.0, "unit": "N/rad", "range": [500, 1500],
            "identifiable": True, "truth": 600.0,
            "profile": {"values": [590.0, 610.0, 640.0], "rise": [3.8, 0.0, 3.8]},
        },
        "yaw_inertia": {
            "estimate": 50.0, "low": 25.0, "high": 75.0, "unit": "kg m^2", "range": [25, 75],
            "identifiable": False, "profile": None,
        },
    },
}  # fmt: skip


def test_an_identification_is_shown_with_its_profiles(tmp_path):
    (tmp_path / "identification.json").write_text(json.dumps(IDENTIFIED))
    run = read_run(tmp_path)
    page = run_page(run, vehicle=VEHICLE)
    for text in ("610", "590 … 640", "600", "not shown"):
        assert f"<td>{text}</td>" in page
    (tmp_path / "report.html").write_text("of identify")
    assert main(["report", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").read_text() == "of identify"
    assert (tmp_path / "run.html").exists()
    (curve,) = interactive_figures.profiles(run.identifications[0][1]).data
    assert list(curve.y) == [3.8, 0.0, 3.8]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("estimate", "x", "estimate must be a number"),
        ("range", [1, 2, 3], "range must be a list"),
        ("profile", {"values": [1, 2], "rise": [0]}, "profile must be a list"),
        ("low", None, "low must be a number"),
    ],
)
def test_a_damaged_identification_is_told(name, value, message, tmp_path):
    document = json.loads(json.dumps(IDENTIFIED))
    document["parameters"]["cornering_stiffness"][name] = value
    (tmp_path / "identification.json").write_text(json.dumps(document))
    with pytest.raises(ReportError, match=f"cornering_stiffness: {message}"):
        read_run(tmp_path)


def test_a_search_over_three_parameters_is_drawn_over_each(plan):
    search = SearchHistory(np.random.default_rng(0).random((5, 3)), np.arange(1.0, 6.0))
    wide = dataclasses.replace(plan, operation={"a": 0.1, "b": 0.2, "c": 0.3}, search=search)
    figure = interactive_figures.search_path(wide, search)
    assert len(figure.data) == 3
    assert [axis.title.text for axis in figure.select_xaxes()] == ["a", "b", "c"]


@pytest.mark.slow
def test_a_browser_shows_it_offline_without_a_complaint(folder, plan, tmp_path):
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on PATH (Debian: apt-get install chromium)")
    sync_api = pytest.importorskip("playwright.sync_api")
    file = folder / "plans" / "designed.json"
    hostile = dataclasses.replace(
        plan, maneuver=HOSTILE, operation={HOSTILE: 3.0, "speed": 0.8}, verdict=HOSTILE
    )
    save_plan(hostile, file)
    assert load_plan(file).maneuver == HOSTILE
    assert main(["report", str(folder)]) == 0
    complaints, requests = [], []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        grounds = {}
        for scheme in ("light", "dark"):
            page = browser.new_page(color_scheme=scheme)
            page.on("console", lambda message: complaints.append(message.text))
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("request", lambda request: requests.append(request.url))
            page.context.set_offline(True)
            page.goto((folder / "report.html").as_uri())
            page.wait_for_function(
                "[...document.querySelectorAll('.plot')].every(p => p.querySelector('.main-svg'))"
            )
            drawn = page.locator(".plot .xtitle").all_text_contents()
            grounds[scheme] = page.evaluate("getComputedStyle(document.body).backgroundColor")
            texts = page.locator(".plot text.xtitle").first
            grounds[scheme, "text"] = texts.evaluate("text => getComputedStyle(text).fill")
        width = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        page.pdf(path=tmp_path / "report.pdf", format="A4")
        browser.close()
    assert complaints == []
    assert {url.partition(":")[0] for url in requests} <= {"file", "data"}
    assert {"x / m", "time since the start / s", "share of the variance of TE"} <= set(drawn)
    assert HOSTILE in drawn  # as text, not as an element
    assert grounds["light"] == "rgb(255, 255, 255)"
    assert grounds["light", "text"] == "rgb(27, 27, 27)"
    assert grounds["dark"] == "rgb(22, 24, 27)"
    assert grounds["dark", "text"] == "rgb(232, 232, 232)"
    assert width
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
