"""Our vehicle as an FMU: valid, without Python, and the same motion as the batch's."""

import dataclasses
import subprocess
import zipfile

import numpy as np
import pytest

from tricycle_cli.main import main
from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

fmpy = pytest.importorskip("fmpy")
VEHICLE = load_vehicle()
pytestmark = pytest.mark.slow  # the first one compiles the FMU


def test_it_is_valid_to_fmpy(exported):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(exported)) == []


def test_its_binary_needs_the_c_library_only(exported, tmp_path):
    with zipfile.ZipFile(exported) as archive:
        archive.extract("binaries/linux64/tricycle.so", tmp_path)
    binary = tmp_path / "binaries" / "linux64" / "tricycle.so"
    needed = subprocess.run(["readelf", "-d", binary], capture_output=True, text=True, check=True)
    libraries = [line.split("[")[1][:-1] for line in needed.stdout.splitlines() if "NEEDED" in line]
    assert set(libraries) <= {"libm.so.6", "libc.so.6"}
    symbols = subprocess.run(["nm", "-D", binary], capture_output=True, text=True, check=True)
    assert "Py" not in symbols.stdout
    assert "numba" not in symbols.stdout


def test_it_moves_as_the_batch_does_with_any_parameters(exported):
    time = np.arange(0.0, 6.5, 0.5)
    commands = Commands(time, 0.25 * np.sin(1.3 * time), np.where(time < 4.0, 3.0, 0.5))
    rng = np.random.default_rng(3)
    points = np.array([[rng.uniform(*ends) for ends in VEHICLE.unknown.values()] for _ in range(3)])
    ours = simulate(VEHICLE, commands, points)
    held = np.arange(len(ours.time) - 1) * 0.01
    rows = np.searchsorted(time, held + 1e-8, side="right") - 1
    angle, speed = commands.steering_motor_angle[rows], commands.speed[rows]
    signals = np.array(
        list(zip(held, angle, speed, strict=True)),
        dtype=[("time", float), ("steering_setpoint", float), ("speed_setpoint", float)],
    )
    for i, point in enumerate(points):
        found = _driven(exported, signals, dict(zip(VEHICLE.unknown, point, strict=True)))
        for name, column in (
            ("x", ours.x), ("y", ours.y), ("heading", ours.yaw), ("vx", ours.vx),
            ("yaw_rate", ours.yaw_rate), ("drive_speed", ours.drive_speed),
            ("load_left", ours.load_left),
        ):  # fmt: skip
            assert np.abs(found[name] - column[i]).max() < 1e-9 * np.abs(column[i]).max(), name


def _driven(path, signals, parameters):
    description = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    names = [v.name for v in description.modelVariables if v.causality == "output"]
    folder = fmpy.extract(str(path))
    slave = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal([references[name] for name in parameters], [*parameters.values()])
    slave.exitInitializationMode()
    told = [slave.getReal([references[name] for name in names])]
    for time, angle, speed in signals:
        slave.setReal(
            [references["steering_setpoint"], references["speed_setpoint"]], [angle, speed]
        )
        slave.doStep(currentCommunicationPoint=time, communicationStepSize=0.01)
        told.append(slave.getReal([references[name] for name in names]))
    slave.terminate()
    slave.freeInstance()
    return dict(zip(names, np.array(told).T, strict=True))


def test_fmpy_simulates_it_from_its_own_start_values(exported):
    result = fmpy.simulate_fmu(
        str(exported),
        stop_time=2.0,
        step_size=0.01,
        output_interval=0.01,
        start_values={"speed_setpoint": 1.0, "start_x": 5.0, "start_heading": 2.5 * np.pi},
        output=["x", "y", "heading"],
    )
    assert result["x"][-1] == pytest.approx(5.0, abs=1e-3)
    assert 0.5 < result["y"][-1] < 2.0
    assert result["heading"] == pytest.approx(2.5 * np.pi, abs=1e-3)  # not wrapped


def test_the_command_writes_it_once(tmp_path, capsys, monkeypatch):
    path = tmp_path / "mine.fmu"
    path.write_text("mine")
    assert main(["vehicle", "export-fmu", "--output", str(path)]) != 0
    assert "exists already; --overwrite replaces it" in capsys.readouterr().err
    assert path.read_text() == "mine"
    monkeypatch.setenv("PATH", "")
    assert main(["vehicle", "export-fmu", "--output", str(path), "--overwrite"]) != 0
    assert "gcc" in capsys.readouterr().err
    assert path.read_text() == "mine"


def test_the_command_refuses_another_ending(tmp_path, capsys):
    path = tmp_path / "mine.txt"
    with pytest.raises(SystemExit, match="2"):
        main(["vehicle", "export-fmu", "--output", str(path)])
    assert "mine.txt: needs to end in .fmu" in capsys.readouterr().err
    assert not path.exists()


def test_a_name_with_other_letters_makes_an_identifier_of_c(tmp_path):
    from tricycle_sim.fmi.export import export_fmu

    path = tmp_path / "named.fmu"
    export_fmu(dataclasses.replace(VEHICLE, name="Dreirad für Ω-Tests"), path)
    description = fmpy.read_model_description(str(path), validate=True)
    assert description.coSimulation.modelIdentifier == "Dreirad_f_r___Tests"


def test_a_vehicle_too_stiff_for_the_steps_is_refused(tmp_path):
    from tricycle_sim.fmi.export import export_fmu

    stiff = VEHICLE.replace(vertical_stiffness=1e9)
    with pytest.raises(VehicleError):
        export_fmu(stiff, tmp_path / "stiff.fmu")
    assert list(tmp_path.iterdir()) == []
