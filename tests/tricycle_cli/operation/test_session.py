"""Sessions: what the simulation drives with. Driving itself: tests/ros/test_drive.py."""

import io
from types import SimpleNamespace

import pytest

from excitation_planner.preflight import RECORDER
from tricycle_cli.operation.dashboard import DiagnosticEntry
from tricycle_cli.operation.session import (
    _go_back,
    _wait_for_enter,
    hidden_truth,
    running_session,
    simulated_session,
)
from tricycle_core.diagnostics import Level
from tricycle_core.errors import NodeError, PlanError
from tricycle_sim.vehicle import load_vehicle


def test_the_truth_is_drawn_from_its_seed_alone_and_is_nominal_without_one():
    vehicle = load_vehicle()
    drawn = hidden_truth(vehicle, 3)
    assert drawn == hidden_truth(vehicle, 3) != hidden_truth(vehicle, 4)
    assert all(low <= drawn[name] <= high for name, (low, high) in vehicle.unknown.items())
    assert hidden_truth(vehicle, -1) == vehicle.nominal


@pytest.fixture
def ask(monkeypatch, capsys):
    """Ask for Enter with these items failing; says what Enter does, once it is not only a look."""

    def ask(failing, *, back=False):
        items = {name: DiagnosticEntry(Level.ERROR, "no", 0.0) for name in failing}
        monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
        plan = SimpleNamespace(
            maneuver="circle",
            space=(4.0, 5.0, 1.0),
            area=None,
            start_pose=None,
            commands=SimpleNamespace(duration=8.0),
        )
        try:
            _wait_for_enter(plan, lambda: items, back)
        finally:
            shown = capsys.readouterr()
            assert shown.out == ""  # which --json prints one object to
        assert "circle, 8 s, needs 4 m x 5 m" in shown.err
        return shown.err.splitlines()[-1]

    return ask


def test_enter_drives_though_nothing_is_recorded_yet(ask):
    assert ask([RECORDER]).startswith("Enter drives,")
    assert ask([RECORDER, "start"], back=True).startswith("Enter drives back to the start")
    with pytest.raises(PlanError, match="nobody is there"):  # it only looks again
        ask([RECORDER, "start"])


@pytest.mark.ros
@pytest.mark.parametrize("domain", ["x", "-1", "233"])
def test_a_domain_that_there_is_not_is_refused_before_a_node_starts(domain, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    simulated = simulated_session(
        vehicle_file=None, true_seed=0, real_time_factor=1.0, folder=tmp_path / "session"
    )
    for session in (running_session(None), simulated):
        refused = pytest.raises(NodeError, match=f"ROS_DOMAIN_ID = {domain}: must be a number")
        with refused, session:
            pass
    assert list(tmp_path.iterdir()) == []


def test_where_the_last_way_back_fails_the_drives_are_said_to_be_recorded(tmp_path):
    def aborted(bag):
        raise NodeError(f"way back aborted: {bag.name}")

    recorded = "way back aborted: bag; all drives are recorded"
    with pytest.raises(NodeError, match=f"{recorded}$"):
        _go_back(aborted, tmp_path / "new" / "bag")
    assert (tmp_path / "new").is_dir()
    again = "ros2 service call /a/maneuver_driver/go_back std_srvs/srv/Trigger"
    with pytest.raises(NodeError, match=f"{recorded}; to try again, arm .* give: {again}$"):
        _go_back(aborted, tmp_path / "new" / "bag", "/a/maneuver_driver/go_back")
