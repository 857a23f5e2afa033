"""An FMU as the simulator of planning and identification."""

import pickle

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, commands_of_pair, driven_pair

from parameter_identification.identification import identify
from tricycle_core.errors import PlantError
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

pytest.importorskip("fmpy")
pytestmark = pytest.mark.slow
VEHICLE = load_vehicle()
COLUMNS = ("x", "y", "yaw", "yaw_rate", "drive_speed")


def test_it_simulates_what_the_batch_does_also_from_another_process(mapping_file):
    from tricycle_sim.fmi.batch import FmuSimulator

    simulator = pickle.loads(pickle.dumps(FmuSimulator(mapping_file())))
    commands, speed = commands_of_pair()["lane"], np.array([0.3])
    found = simulator(VEHICLE, commands, setpoint=0.3).run(TRUTH[None], COLUMNS, speed=speed)
    ours = CommandedBatch(VEHICLE, commands, setpoint=0.3).run(TRUTH[None], COLUMNS, speed=speed)
    for name in COLUMNS:
        assert np.abs(found.columns[name] - ours.columns[name]).max() < 1e-9, name


def test_it_is_steered_as_the_batch_is(mapping_file):
    from tricycle_sim.fmi.batch import FmuSimulator

    commands = commands_of_pair()["lane"]
    found, ours = (
        simulator(VEHICLE, commands) for simulator in (FmuSimulator(mapping_file()), CommandedBatch)
    )
    added = 0.02 * np.sin(ours.time)[np.newaxis]
    options = {"steered": added, "steering_delay": np.array([0.015])}
    x, own = (batch.run(TRUTH[None], ("x",), **options).columns["x"] for batch in (found, ours))
    assert np.abs(x - own).max() < 1e-9


def test_an_fmu_is_calibrated_as_our_model_is(mapping_file):
    from tricycle_sim.fmi.batch import FmuSimulator

    drives, names = driven_pair()[1:], ["cornering_stiffness", "yaw_inertia"]
    found = [
        identify(drives, VEHICLE, parameters=names, hold_others=True, starts=1, **more).parameters
        for more in ({}, {"simulator": FmuSimulator(mapping_file())})
    ]
    for name in names:
        own, other = (each[name] for each in found)
        width = own.high - own.low
        assert other.high - other.low == pytest.approx(width, rel=0.01)
        assert other.estimate == pytest.approx(own.estimate, abs=0.01 * width)


def test_it_is_the_planners_simulator(mapping_file):
    from tricycle_sim.fmi.batch import FmuFunction

    def commands(x):
        return commands_of_pair()["circle"]

    def furthest(columns, x):
        return np.hypot(columns["x"], columns["y"]).max(axis=1)

    function = FmuFunction(mapping_file(), VEHICLE, commands, furthest)
    broken = TRUTH.copy()
    broken[NAMES.index("yaw_inertia")] = np.nan  # the FMU refuses it
    outputs = function(np.array([1.0]), np.array([TRUTH, broken]))
    ours = CommandedBatch(VEHICLE, commands(None)).run(TRUTH[None], ("x", "y")).columns
    assert outputs[0] == pytest.approx(furthest(ours, None)[0], rel=1e-12)
    assert np.isnan(outputs[1])


def test_a_parameter_that_the_mapping_lacks_is_one_line(mapping_file):
    from tricycle_sim.fmi.batch import FmuSimulator

    simulator = FmuSimulator(mapping_file(parameters={"yaw_inertia": None}))
    with pytest.raises(PlantError, match="lacks yaw_inertia, which is unknown"):
        simulator(VEHICLE, commands_of_pair()["lane"])


def test_the_planners_simulator_names_all_that_the_mapping_lacks_when_it_is_made(mapping_file):
    from tricycle_sim.fmi.batch import FmuFunction

    file = mapping_file(parameters={"yaw_inertia": None, "camber_stiffness": None})
    with pytest.raises(PlantError) as caught:
        FmuFunction(file, VEHICLE, commands_of_pair().get, max)
    assert str(caught.value) == (
        f"{file}: parameters: lacks camber_stiffness, yaw_inertia, which are unknown: name the "
        "FMU's variable of each"
    )
