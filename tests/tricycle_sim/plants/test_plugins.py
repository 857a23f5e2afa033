"""Plants of other distributions: the class and the entry point of the how-to, installed."""

import math
import re
import sys
import tomllib
from pathlib import Path

import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_core.errors import PlantError
from tricycle_sim.plants.installed import plant_by_name, plant_names
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.native import NativeRig
from tricycle_sim.vehicle import load_vehicle

PAGE = Path(__file__).parents[3] / "docs" / "how-to-plant.md"
EXAMPLE = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]
POINTS = tomllib.loads(re.search(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)[1])
(GROUP, ENTRIES) = POINTS["project"]["entry-points"].popitem()
VEHICLE = load_vehicle()


@pytest.fixture
def bicycle(install_distribution, monkeypatch):
    """Install the plant of the how-to, with changes of its source; return it."""

    def make(old="", new=""):
        install_distribution(GROUP, "bikes", "bicycle", EXAMPLE.replace(old, new), ENTRIES)
        monkeypatch.delitem(sys.modules, "bicycle", raising=False)
        return plant_by_name("bicycle", VEHICLE)

    return make


def drive(rig, angle, speed, seconds):
    host = Host(rig)
    host.arm()
    host.target = VehicleCommand(angle, speed)
    host.run(seconds)
    return host


@pytest.mark.slow
def test_the_plant_of_the_how_to_is_listed_and_driven_by_the_emulated_boards(bicycle):
    rig = EmulatedRig(VEHICLE, plant=bicycle())
    assert plant_names()[0] == "own"
    assert "bicycle" in plant_names()
    host = drive(rig, 0.2, 1.0, 8.0)
    assert rig.armed, host.log
    assert rig.state.vx == pytest.approx(1.0, abs=0.02)
    assert rig.state.yaw_rate == pytest.approx(math.tan(0.2) / VEHICLE.wheelbase, rel=0.03)
    host.target = VehicleCommand(0.0, 0.0)
    host.run(4.0)
    assert rig.state.vx == pytest.approx(0.0, abs=0.02)
    rig.reset((1.0, 2.0, 0.5))
    assert (rig.state.x, rig.state.y, rig.state.yaw) == (1.0, 2.0, 0.5)


def test_the_firmwares_logic_drives_it_too(bicycle, firmware_libraries):
    rig = NativeRig(VEHICLE, firmware_libraries, plant=bicycle())
    drive(rig, 0.0, 1.0, 5.0)
    assert rig.armed
    assert rig.state.vx == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("yaw_rate = v", "yaw_rate = math.nan * v", r"Bicycle at 0\.00 s: x is nan"),
        ("acceleration - yaw_rate * vy", "math.nan", r"specific_force is \(nan, "),
        ("return self.state(tick, (", "self.state(tick, (", "tells NoneType, no LiveState"),
        ("held = TICK", "held = 1 / (tick < 99) * TICK", r"at 0\.99 s: ZeroDivisionError"),
    ],
)
def test_a_plant_that_dies_is_one_line(bicycle, old, new, message):
    plant = bicycle(old, new)
    with pytest.raises(PlantError, match=message) as caught:
        drive(EmulatedRig(VEHICLE, plant=plant), 0.0, 1.0, 2.0)
    assert "\n" not in str(caught.value)


def test_a_plant_that_cannot_be_made_is_one_line(bicycle):
    with pytest.raises(PlantError, match=r"'bicycle' cannot be made of bicycle:Bicycle: .*car"):
        bicycle("self.vehicle = vehicle", "self.vehicle = car")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("swan", "unknown plant 'swan'; there are: own"),
        ("own:car.yaml", "the plant own takes no file"),
        ("mujoco:car.yaml", "the plant mujoco takes no file, but car.yaml is given"),
    ],
)
def test_a_wrong_name_is_one_line(name, message):
    with pytest.raises(PlantError, match=message) as caught:
        plant_by_name(name, VEHICLE)
    assert "\n" not in str(caught.value)


def test_two_classes_under_one_name_are_refused(install_distribution, bicycle):
    install_distribution(GROUP, "other", "other", "", {"bicycle": "other:Bicycle"})
    with pytest.raises(PlantError, match=r"'bicycle' is registered for .* and for "):
        bicycle()
