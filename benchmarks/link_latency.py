"""Latency of the bridge node as a process, on ptys at 100 Hz, and its CPU; stopping after kill -9.

    .venv/bin/python benchmarks/link_latency.py --seconds 20 --kills 10

Command to wire: a commander publishes joint_commands whose angle counts up; the emulated board
notes when the frame with that angle is there. Wire to topic: the board's measured angle counts up
in the state frame; the subscriber of joint_states notes when it sees it. Stopping: the bridge is
killed at 1 m/s; the time from the kill until the emulated wheel stands.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from tricycle_bridge.protocol.messages import SteerCommand
from tricycle_cli.operation.processes import own_domain, ros_environment
from tricycle_core.timing import TICK
from tricycle_sim.plc.pair import PlcPair


class Rig:
    """The bridge as a process between a commander node and a pair of emulated PLCs."""

    def __init__(self, folder: Path) -> None:
        env = ros_environment(domain=own_domain(), log_dir=folder / "log")
        os.environ.update(env)
        self.pair = PlcPair(folder / "steer", folder / "drive")
        self._env = env
        rclpy.init()
        self.node = rclpy.create_node("link_latency")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publisher = self.node.create_publisher(JointState, "joint_commands", 1)
        self.client = self.node.create_client(SetBool, "tricycle_bridge/arm")
        self.target = (0.0, 0.0)
        self.bridge = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        parameters = {
            "steer_port": self.pair.steer_path,
            "drive_port": self.pair.drive_path,
            "boot_wait": "0.0",
            "max_acceleration": "2.0",
        }
        command = [sys.executable, "-m", "tricycle_bridge.bridge_node", "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={value}"]
        return subprocess.Popen(command, env=self._env, stderr=subprocess.DEVNULL)

    def publish(self) -> None:
        """Send the target once."""
        angle, speed = self.target
        message = JointState(
            name=["steering_motor_joint", "rear_wheel_joint"],
            position=[angle, 0.0],
            velocity=[0.0, speed / 0.335],
        )
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.publisher.publish(message)

    def spin(self, seconds: float) -> None:
        """Let callbacks run for a time (s)."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def arm(self) -> None:
        """Stream standstill and ask until both boards are armed."""
        self.target = (0.0, 0.0)
        armed = False
        while not armed:
            self.publish()
            self.spin(TICK)
            if not self.client.service_is_ready():
                continue
            answer = self.client.call_async(SetBool.Request(data=True))
            give_up = time.monotonic() + 3.0  # a bridge that was killed does not answer
            while not answer.done() and time.monotonic() < give_up:
                self.publish()
                self.spin(TICK)
            armed = answer.done() and answer.result().success

    def restart(self) -> None:
        """Kill the bridge and start another."""
        self.bridge.kill()
        self.bridge.wait()
        self.bridge = self._start()

    def close(self) -> None:
        """End everything."""
        self.bridge.terminate()
        self.bridge.wait()
        self.pair.close()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()


def latencies(rig: Rig, seconds: float) -> None:
    """Print the latencies in both directions and the CPU of the bridge."""
    sent: dict[int, float] = {}
    to_wire: list[float] = []
    to_topic: list[float] = []
    measured: dict[int, float] = {}
    steer = rig.pair.steer
    take, tick = steer._take_command, steer.tick  # noqa: SLF001 - stamped where they happen

    def take_stamped(command: SteerCommand):
        if (at := sent.pop(command.angle, None)) is not None:
            to_wire.append(time.monotonic() - at)
        return take(command)

    def tick_stamped(now_us, measurement):
        measured[round(measurement.angle * 1e4)] = time.monotonic()
        return tick(now_us, measurement)

    def on_joint_states(message: JointState) -> None:
        if len(message.name) == 2 and (at := measured.pop(round(message.position[0] * 1e4), None)):
            to_topic.append(time.monotonic() - at)

    rig.arm()
    steer._take_command = take_stamped  # type: ignore[method-assign]  # noqa: SLF001
    steer.tick = tick_stamped  # type: ignore[method-assign]
    rig.node.create_subscription(JointState, "joint_states", on_joint_states, 10)
    rig.spin(0.5)
    ticks_per_s = os.sysconf("SC_CLK_TCK")
    stat = Path(f"/proc/{rig.bridge.pid}/stat")

    def cpu() -> float:
        fields = stat.read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / ticks_per_s

    cpu_before, start = cpu(), time.monotonic()
    next_at = start
    k = 0
    while time.monotonic() - start < seconds:
        k = (k + 1) % 7000
        rig.target = (k * 1e-4, 0.0)
        sent[k] = time.monotonic()
        rig.publish()
        next_at += TICK
        rig.spin(max(next_at - time.monotonic(), 0.0))
    used = (cpu() - cpu_before) / (time.monotonic() - start)
    for name, values in (("command to wire", to_wire), ("wire to topic", to_topic)):
        p50, p99, most = np.percentile(np.array(values) * 1e3, [50, 99, 100])
        print(f"{name:16} n {len(values):5}  p50 {p50:.2f}  p99 {p99:.2f}  max {most:.2f} ms")
    print(f"CPU of the bridge {used:.1%} of a core")
    load = os.getloadavg()[0]
    print(f"load average {load:.1f} on {os.cpu_count()} cores")
    steer._take_command, steer.tick = take, tick  # type: ignore[method-assign]  # noqa: SLF001


def stopping(rig: Rig, kills: int) -> None:
    """Print the distribution of the time to standstill after kill -9 at 1 m/s."""
    times = []
    for _ in range(kills):
        rig.restart()
        rig.arm()
        rig.target = (0.0, 1.0)
        while rig.pair.speed < 0.999:
            rig.publish()
            rig.spin(TICK)
        rig.bridge.kill()
        killed = time.monotonic()
        while rig.pair.speed != 0.0:
            time.sleep(1e-3)
        times.append(time.monotonic() - killed)
    p50, p90, most = np.percentile(times, [50, 90, 100])
    print(
        f"kill -9 at 1 m/s {kills} times: standstill after min {min(times):.2f}  "
        f"p50 {p50:.2f}  p90 {p90:.2f}  max {most:.2f} s"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--kills", type=int, default=10)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(Path(folder))
        try:
            latencies(rig, args.seconds)
            if args.kills:
                stopping(rig, args.kills)
        finally:
            rig.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
