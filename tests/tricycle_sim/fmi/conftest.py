"""The packaged tricycle as an FMU, and mappings of it."""

import shutil

import pytest
import yaml

from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
MAPPING = {
    "fmu": "tricycle.fmu",
    "inputs": {
        "steering": "steering_setpoint",
        "speed": "speed_setpoint",
        "torque": "torque_setpoint",
        "brake": "brake",
        "torque_mode": "torque_mode",
    },
    "outputs": {
        **{name: name for name in ("x", "y", "heading", "vx", "vy", "yaw_rate", "ax", "ay")},
        **{n: n for n in ("steering_motor_angle", "steering_motor_rate", "drive_speed")},
        "motor_torque": "drive_torque",
    },
    "parameters": {
        name: name for name in (*VEHICLE.unknown, "start_speed", "start_speed_setpoint")
    },
    "start_values": {"slewed": True},
}


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """The FMU of the packaged tricycle."""
    pytest.importorskip("fmpy")
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    from tricycle_sim.fmi.export import export_fmu

    path = tmp_path_factory.mktemp("fmu") / "tricycle.fmu"
    assert export_fmu(VEHICLE, path) == ()
    return path


@pytest.fixture
def mapping_file(exported, tmp_path):
    """Write the mapping with changes by part; return its path."""

    def write(**changes):
        content = {
            name: dict(part) if isinstance(part, dict) else part for name, part in MAPPING.items()
        }
        content["fmu"] = str(exported)
        for part, change in changes.items():
            if isinstance(change, dict) and part in content:
                content[part].update(change)
                content[part] = {n: v for n, v in content[part].items() if v is not None}
            else:
                content[part] = change
        path = tmp_path / "mapping.yaml"
        path.write_text(yaml.safe_dump(content))
        return path

    return write
