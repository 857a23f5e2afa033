"""The driver's fence in front of the boards: what it stops stays on its area, on slopes too."""

import math

import numpy as np
import pytest

from excitation_planner.area.area import Area
from excitation_planner.area.polygons import contains
from excitation_planner.area.tube import footprint_of
from excitation_planner.localisation import PlanarState
from excitation_planner.playback import Playback, PlaybackState
from excitation_planner.schedule import Schedule
from excitation_planner.vehicle_watch import VehicleWatch
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.poses import placed
from tricycle_core.stopping import MAX_PAYLOAD
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.native import NativeRig
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.payload import Payload, with_payload

VEHICLE = load_vehicle()
LOW = {name: limits[0] for name, limits in VEHICLE.unknown.items()}
DOWNHILL = with_payload(
    VEHICLE.replace(**LOW, road_grade=math.atan(-0.05)), Payload(MAX_PAYLOAD, x=-0.3, z=0.6)
)
KEEP_IN = np.array([[-5.0, -3.0], [15.0, -3.0], [15.0, 3.0], [-5.0, 3.0]])
MARGIN = 0.5


def seen(state):
    speed = math.hypot(state.vx, state.vy)
    slip = math.atan2(state.vy, state.vx) if speed > 0.05 else 0.0
    return PlanarState(state.x, state.y, state.yaw, speed, slip, state.yaw_rate, "odom")


@pytest.mark.parametrize("boards", ["emulated", pytest.param("native", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("vehicle", "speed", "acceleration", "finished"),
    [
        (DOWNHILL, 0.6, 1.0, math.inf),
        (DOWNHILL, 1.5, 1.0, math.inf),
        (VEHICLE, 1.0, 0.1, math.inf),
        (DOWNHILL, 1.0, 1.0, 9.5),
    ],
)
def test_what_the_fence_stops_stays_within_its_margin(
    request, boards, vehicle, speed, acceleration, finished
):
    """Also what rolls on after a run that was ended early, at x = `finished` [m]."""
    footprint = footprint_of(VEHICLE)
    playback = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=50.0)
    playback.load(
        Schedule(np.array([0.0, 60.0]), np.zeros(2), np.full(2, speed / VEHICLE.tyre_radius))
    )
    playback.parts.add_path(np.array([[0.0, 0.0], [60.0, 0.0]]))
    playback.parts.add_area(
        {
            "ground": ("odom", Area(KEEP_IN, margin=MARGIN).within(MARGIN)),
            "footprint": footprint,
            "planned_start": (0.0, 0.0, 0.0),
            "twist": np.zeros(2),
        }
    )
    if boards == "emulated":
        rig = EmulatedRig(vehicle)
    else:
        rig = NativeRig(vehicle, request.getfixturevalue("firmware_libraries"))
    with rig:
        host = Host(rig, BridgeSettings(payload=MAX_PAYLOAD, max_acceleration=acceleration))
        host.arm()
        ended = PlaybackState.ABORTED, PlaybackState.DONE
        while playback.state not in ended or abs(rig.state.vx) > 0.02:
            now = host.now
            assert now < 160.0, playback.state
            playback.observe(seen(rig.state), now, now)
            playback.hear(host.bridge.readiness(now), now)
            if playback.state is PlaybackState.WAITING:
                playback.start(now)
            if rig.state.x > finished and playback.state is PlaybackState.RUNNING:
                playback.finish("ended early")
            command = playback.tick(now)
            host.target = None
            if command is not None and command.stop:
                host.bridge.set_command(None, stamp=now, now=now, source=Source.JOINT_COMMANDS)
            elif command is not None:
                host.target = VehicleCommand(
                    command.steering_motor_angle, command.wheel_rate * VEHICLE.tyre_radius
                )
            host.tick()
        corners = placed(footprint, rig.state.x, rig.state.y, rig.state.yaw)
        assert playback.reason.startswith("fence" if finished == math.inf else "ended early")
        assert rig.state.x > 5.0  # it drove
        assert contains(corners, (KEEP_IN - MARGIN * np.sign(KEEP_IN),)).all()
        assert not host.bridge.armed
        assert "stopped: by unnamed joint_commands" in host.bridge.readiness(host.now).reason
