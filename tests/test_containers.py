"""The containers' rights: a user that is not root, and no device but the two boards."""

import re
from pathlib import Path

import pytest
import yaml

FOLDER = Path(__file__).parents[1] / "docker"
SERVICES = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]


def image(instruction):
    """What the Dockerfile gives that instruction at last."""
    lines = (FOLDER / "Dockerfile").read_text().splitlines()
    return [line.split()[1] for line in lines if line.startswith(f"{instruction} ")][-1]


def test_the_image_does_not_end_as_root():
    assert image("USER") == "tricycle"


def test_a_stopped_container_ends_as_ros2_launch_does_of_ctrl_c():
    assert image("STOPSIGNAL") == "SIGINT"


def test_rosdep_leaves_out_what_it_would_install_with_pip():
    """As root it may not on Ubuntu 24.04; `make setup` installs the same in an environment."""
    packages = (FOLDER.parent / "src").glob("*/package.xml")
    found = {key for p in packages for key in re.findall(r">(\S+-pip)<", p.read_text())}
    (skipped,) = re.findall(r"--skip-keys (\S+|\"[^\"]*\")", (FOLDER / "Dockerfile").read_text())
    assert found == {*skipped.strip('"').split()}


@pytest.mark.parametrize("name", SERVICES)
def test_no_service_has_or_gains_rights(name):
    service = SERVICES[name]
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert {"privileged", "cap_add", "user", "device_cgroup_rules"}.isdisjoint(service)
    assert all(volume.startswith("bags:") for volume in service["volumes"])  # no host folder


def test_only_the_vehicle_has_devices_and_only_its_two():
    devices = {name: service.get("devices", []) for name, service in SERVICES.items()}
    inside = [entry.rpartition(":")[2] for entry in devices.pop("vehicle")]
    assert inside == ["/dev/tricycle_steer", "/dev/tricycle_drive"]
    assert not any(devices.values())
