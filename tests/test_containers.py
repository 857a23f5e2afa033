"""The containers' rights: a user that is not root, and no device but the two boards."""

from pathlib import Path

import pytest
import yaml

FOLDER = Path(__file__).parents[1] / "docker"
SERVICES = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]


def test_the_image_does_not_end_as_root():
    users = [
        line.split()[1]
        for line in (FOLDER / "Dockerfile").read_text().splitlines()
        if line.startswith("USER")
    ]
    assert users[-1:] == ["tricycle"]


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
