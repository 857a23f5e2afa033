"""Campaigns: they end within the tolerance, go on after a kill, and refuse what does not fit."""

import contextlib
import dataclasses
import json
import shutil

import numpy as np
import pytest

from excitation_planner import MeasurementNoise
from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.plan import load_plan
from excitation_planner.planning import check_vehicle
from parameter_identification.drives.measured import Sensor, StartPose
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification_file import (
    IdentificationDocument,
    ParameterEntry,
    load_identification_file,
)
from tricycle_cli.campaign.cycle import Campaign
from tricycle_cli.campaign.request import CampaignRequest
from tricycle_cli.campaign.results import campaign_report
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_core.errors import ExcitationError, JudgeError, PlanError
from tricycle_sim.vehicle import draw_truth, load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
TRUTH = draw_truth(VEHICLE, np.random.default_rng(3))
TARGETS = ("cornering_stiffness", "camber_stiffness")


def request(**changes):
    noise = MeasurementNoise(yaw_rate_std=0.005)
    settings = {"tolerance": 0.05, "budget": 2600, "noise": noise, "true_seed": 3}
    families = (Circle(duration=8.0), DoubleLaneChange())
    return CampaignRequest(VEHICLE, families, **({"targets": TARGETS} | settings | changes))


@contextlib.contextmanager
def silent(_):
    yield lambda done, total: None


class Track:
    """Stands in for the nodes: a bag is a folder with its plan; reading it drives the truth."""

    def __init__(self, fails_at=0, **unlike_the_file):
        self.driven, self.fails_at, self.unlike_the_file = 0, fails_at, unlike_the_file

    def drive(self, plan, bag, progress, enough=None):
        self.driven += 1
        self.enough = enough
        bag.mkdir()
        (bag / "half.mcap").touch()
        if self.driven == self.fails_at:
            raise KeyboardInterrupt
        (bag / "plan").write_text(plan.id)

    def read(self, bag, vehicle):
        assert (bag / "plan").exists()
        plan = load_plan(bag.parents[1] / "plans" / f"{bag.name}.json")
        parameters = np.array([list(TRUTH.values())])
        vehicle = vehicle.replace(**self.unlike_the_file)
        return measure(
            SensedMotion.of(simulate(vehicle, plan.commands, parameters, threads=1)),
            plan.commands,
            {Sensor.POSITION: SensorNoise(0.01), Sensor.YAW_RATE: SensorNoise(0.005)},
            rng=np.random.default_rng(int(bag.name)),
            name=bag.name,
            standstill=1.0,
            start=StartPose(0.0, 0.0, 0.0, 0.02, 0.0175),
        )


def go_on(campaign, track):
    while not campaign.finished:
        campaign.plan(silent)
        campaign.drive(track.drive, lambda done, total: None)
        campaign.identify(track.read)


@pytest.mark.slow
def test_a_campaign_ends_within_its_tolerance_also_after_a_kill(tmp_path):
    track = Track(fails_at=1)
    with pytest.raises(KeyboardInterrupt):
        go_on(Campaign(tmp_path / "c", request()), track)
    campaign = Campaign(tmp_path / "c", request())
    planned = campaign.steps[0].plan_id
    assert not campaign.steps[0].driven
    go_on(campaign, track)
    assert campaign.steps[0].plan_id == planned  # not planned again, but driven again
    assert track.driven == len(campaign.steps) + 1
    assert campaign.missing() == ()
    for name in TARGETS:
        known = campaign.known()[name]
        assert known.share <= 0.05
        assert abs(known.estimate - TRUTH[name]) < 4.0 * known.std
    # as it was when it is opened again; a finished one has nothing left to do
    known, drives = campaign.known(), len(campaign.steps)
    del campaign
    again = Campaign(tmp_path / "c", request())
    assert again.finished
    assert again.known() == known
    report = campaign_report(again, TRUTH)
    assert report["targets"]["camber_stiffness"]["within_tolerance"]
    assert len(report["steps"]) == report["drives"] == drives
    del again
    # a finer tolerance goes on from there, with what is known as the prior
    finer = Campaign(tmp_path / "c", request(tolerance=0.002, most_drives=drives + 1))
    before = finer.known()
    go_on(finer, track)
    assert len(finer.steps) == drives + 1
    target = finer.steps[-1].target
    assert finer.steps[-1].predicted_std[target] < before[target].std
    # noise is estimated anew from all drives, so the deviation need not fall with every one
    assert finer.known()[target].std < 1.2 * before[target].std


def no_poses(bag, vehicle):
    raise JudgeError(f"{bag}: no poses")


def standing(bag, vehicle):
    """A vehicle that did not move."""
    drive = Track().read(bag, vehicle)
    signal = drive.signals[Sensor.POSITION]
    still = dataclasses.replace(signal, values=np.zeros_like(signal.values))
    return dataclasses.replace(drive, signals={Sensor.POSITION: still})


@pytest.mark.slow
@pytest.mark.parametrize(("read", "why"), [(no_poses, "no poses"), (standing, "too little motion")])
def test_a_bag_that_cannot_be_identified_is_kept_and_identified_again(tmp_path, read, why):
    track, campaign = Track(), Campaign(tmp_path / "c", request())
    campaign.plan(silent)
    campaign.drive(track.drive, lambda done, total: None)
    with pytest.raises(PlanError, match=rf"{why}.*; the bag is kept: give the same command again"):
        campaign.identify(read)
    del campaign
    again = Campaign(tmp_path / "c", request())
    assert again.driven
    again.drive(track.drive, lambda done, total: None)
    assert track.driven == 1
    (tmp_path / "c/bags/01").rename(tmp_path / "bad")  # by who wants it to be driven again
    assert not again.driven
    with pytest.raises(KeyboardInterrupt):
        again.drive(Track(fails_at=1).drive, lambda done, total: None)
    del again
    again = Campaign(tmp_path / "c", request())
    assert not again.driven  # half a bag is there
    again.drive(track.drive, lambda done, total: None)
    assert track.driven == 2
    again.identify(track.read)
    assert not again.driven


@pytest.mark.slow
def test_names_of_topics_are_kept_and_can_be_given_after_the_drive(tmp_path, monkeypatch):
    track, campaign = Track(), Campaign(tmp_path / "c", request())
    campaign.plan(silent)
    campaign.drive(track.drive, lambda done, total: None)

    def read(bag, vehicle, *, topics):
        if topics.pose != "/localization/odometry":
            raise JudgeError(f"{bag} holds no topic {topics.pose}: name the topic of the poses")
        return track.read(bag, vehicle)

    monkeypatch.setattr("tricycle_cli.campaign.cycle.read_measured_drive", read)
    with pytest.raises(PlanError, match=r"no topic odom.*--pose"):
        campaign.identify()
    campaign.read_by(TopicNames(pose="/localization/odometry"))
    del campaign
    again = Campaign(tmp_path / "c", request())
    assert again.topics.pose == "/localization/odometry"
    again.identify()
    assert track.driven == 1
    assert again.steps[0].identification is not None


@pytest.mark.slow
def test_a_drive_that_may_end_early_knows_what_the_ones_before_it_taught(tmp_path):
    track, campaign = Track(), Campaign(tmp_path / "c", request(tolerance=0.002, most_drives=2))
    for drive in range(2):
        if drive:  # whose bag is gone: that is told before another one is planned
            shutil.move(tmp_path / "c/bags/01", tmp_path / "01")
            with pytest.raises(PlanError, match=r"c/bags/01: missing, .* put it back"):
                campaign.plan(silent)
            shutil.move(tmp_path / "01", tmp_path / "c/bags/01")
        campaign.plan(silent)
        campaign.drive(track.drive, lambda done, total: None, stop_early=True)
        enough = track.enough
        assert enough.plan_file == tmp_path / "c" / campaign.steps[-1].plan
        assert (enough.targets, enough.tolerance) == (TARGETS, 0.002)
        if drive == 0:
            assert enough.known_file is None
            campaign.identify(track.read)
    prior = load_identification_file(enough.known_file).posterior()
    for name, known in campaign.known().items():
        at = prior.names.index(name)
        assert prior.mean[at] == pytest.approx(known.estimate)
        assert prior.covariance[at, at] == pytest.approx(known.std**2)


@pytest.mark.slow
def test_the_next_plan_counts_on_the_effects_that_were_found(tmp_path):
    track = Track(steering_offset=0.035)
    effects = {"effects": ("steering-zero",), "tolerance": 0.001, "most_drives": 2}
    campaign = Campaign(tmp_path / "c", request(**effects))
    go_on(campaign, track)
    plans = [load_plan(campaign.folder / step.plan) for step in campaign.steps]
    straight = [plan.commands.steering_motor_angle[0] for plan in plans]
    assert straight == pytest.approx([0.0, -0.035], abs=0.01)
    for plan in plans:  # the nodes are set up with the file
        check_vehicle(plan, VEHICLE)


@pytest.mark.parametrize(
    ("change", "needed"),
    [
        ({}, True),
        ({"most_drives": 2}, True),
        ({"tolerance": 0.5}, False),
        ({"most_drives": 1}, False),
        ({"targets": TARGETS[:1]}, False),
    ],
)
def test_an_open_plan_is_dropped_if_it_is_not_needed_any_more(change, needed, tmp_path):
    entry = ParameterEntry(
        estimate=1000.0, low=800.0, high=1200.0, standard_deviation=100.0, range=(500.0, 1500.0)
    )
    found = IdentificationDocument(
        level=0.95, parameters=dict.fromkeys(TARGETS, entry), covariance=1e4 * np.eye(2)
    )
    std = dict.fromkeys(TARGETS, 1.0)
    steps = (
        Step(
            *(TARGETS[0], "plans/01.json", "bags/01", "circle", {}, "id", 8.0, std),
            driven=True,
            identification=found,
        ),
        Step(TARGETS[1], "plans/02.json", "bags/02", "circle", {}, "id", 8.0, std),
    )
    for bag in ("bags/01", "bags/02"):
        (tmp_path / bag).mkdir(parents=True)
    (tmp_path / "plans").mkdir()
    (tmp_path / "plans/02.json").touch()
    CampaignState(request().settings(), steps).write(tmp_path / "campaign.json")
    campaign = Campaign(tmp_path, request(**change))
    assert len(campaign.steps) == (2 if needed else 1)
    assert len(CampaignState.read(tmp_path / "campaign.json").steps) == len(campaign.steps)
    assert campaign.finished == (not needed and "targets" not in change)
    for file in ("plans/02.json", "bags/02"):
        assert (tmp_path / file).exists() == needed
    assert (tmp_path / "bags/01").exists()


def test_a_second_campaign_stays_out_of_a_folder_until_the_first_has_ended(tmp_path):
    first = Campaign(tmp_path / "c", request())
    with pytest.raises(PlanError, match="another campaign is at work in this folder"):
        Campaign(tmp_path / "c", request())
    del first
    assert Campaign(tmp_path / "c", request()).steps == ()


def test_other_settings_do_not_continue_a_campaign(tmp_path):
    Campaign(tmp_path / "c", request())
    changes = {
        "true_seed, noise_std": {
            "noise": MeasurementNoise(noise_std=0.02, yaw_rate_std=0.005),
            "true_seed": 4,
        },
        "effects, weighed": {"effects": ("wheel-radius",), "weighed": True},
        "plan_effects": {"plan_effects": ("wheel-radius",)},
    }
    for different, change in changes.items():
        with pytest.raises(PlanError, match=rf"other settings \(different: {different}\)"):
            Campaign(tmp_path / "c", request(**change))


def test_another_area_does_not_continue_a_campaign(tmp_path):
    yard = Area(np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 25.0], [0.0, 25.0]]))
    Campaign(tmp_path / "c", request(area=yard))
    assert Campaign(tmp_path / "c", request(area=dataclasses.replace(yard))).steps == ()
    for other in (None, dataclasses.replace(yard, margin=1.0)):
        with pytest.raises(PlanError, match=r"other settings \(different: area\)"):
            Campaign(tmp_path / "c", request(area=other))


@pytest.mark.slow
def test_on_an_area_a_family_that_does_not_fit_is_left_out_and_named(tmp_path):
    yard = Area(np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 25.0], [0.0, 25.0]]))
    campaign = Campaign(tmp_path / "c", request(area=yard, budget=2600))
    plan = campaign.plan(silent)
    assert (plan.maneuver, plan.area is not None) == ("circle", True)
    assert plan.clearance >= 0.0
    (problem,) = campaign.left_out
    assert problem.startswith("double_lane_change: ")
    assert "m further out on every side would do" in problem


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"predicted_std": {}}, "campaign.json: drive bags/01: needs predicted_std of every"),
        ({"parameters": ["cornering_stiffness", "x"]}, "drive bags/01: .* estimates of param"),
        ({"covariance": np.empty((0, 0))}, r"prior: needs mean \(1,\) and covariance"),
    ],
)
def test_a_state_of_which_a_part_is_missing_is_told(change, message, tmp_path):
    entry = ParameterEntry(
        estimate=700.0, low=690.0, high=710.0, standard_deviation=100.0, range=(500.0, 1500.0)
    )
    names = change.get("parameters", ["cornering_stiffness"])
    found = IdentificationDocument(
        level=0.95,
        parameters=dict.fromkeys(names, entry),
        covariance=change.get("covariance", np.array([[1e4]])),
    )
    step = Step(
        *("cornering_stiffness", "plans/01.json", "bags/01", "circle", {}, "id", 8.0),
        predicted_std=change.get("predicted_std", dict.fromkeys(TARGETS, 1.0)),
        driven=True,
        identification=found,
    )
    (tmp_path / "bags/01").mkdir(parents=True)
    CampaignState(request().settings(), (step,)).write(tmp_path / "campaign.json")
    with pytest.raises(ExcitationError, match=message):
        Campaign(tmp_path, request()).plan(silent)


def test_a_foreign_folder_or_a_damaged_state_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(PlanError, match="holds something else"):
        Campaign(tmp_path, request())
    with pytest.raises(ExcitationError, match=r"mine\.txt is a file; a folder is needed"):
        Campaign(tmp_path / "mine.txt", request())
    state = tmp_path / "c" / "campaign.json"
    Campaign(state.parent, request())
    for text in ("{", "[]", json.dumps({"schema": 9}), json.dumps({"schema": 1, "settings": {}})):
        state.write_text(text)
        with pytest.raises(PlanError, match=str(state)):
            Campaign(state.parent, request())
        assert state.read_text() == text
