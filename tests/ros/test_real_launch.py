"""The packaged launch file under `launch` itself, which is no wheel: run where a ROS is sourced."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from bicycle_fmu import needs_compiler, write_bicycle_fmu
from launch_recorder import LAUNCH_FOLDER, NODES

pytest.importorskip("fmpy")
pytest.importorskip("launch_ros", reason="no ROS is sourced")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    needs_compiler,
]
PATIENCE = 60.0  # s
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *arguments = sys.argv[1:]
given = [argument.split(":=", 1) for argument in arguments]
source = PythonLaunchDescriptionSource(file)
service = LaunchService(argv=arguments)
included = IncludeLaunchDescription(source, launch_arguments=given)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


@pytest.fixture
def prefix(tmp_path):
    """A ROS prefix in which `launch` finds the nodes of this environment."""
    index = tmp_path / "prefix" / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    for executable, node in NODES.items():
        package = node.partition(".")[0]
        (index / package).touch()
        folder = tmp_path / "prefix" / "lib" / package
        folder.mkdir(parents=True, exist_ok=True)
        (folder / executable).symlink_to(Path(sys.executable).with_name(executable))
    return tmp_path / "prefix"


def test_an_fmu_that_cannot_be_ends_the_launch_with_one_line(ros_environment, prefix, tmp_path):
    outputs = {"x": "ex", "y": "y", "heading": "heading"}
    mapping = write_bicycle_fmu(tmp_path, mapping={"outputs": outputs})
    others = os.environ.get("AMENT_PREFIX_PATH", sys.prefix)
    arguments = [f"plant:=fmu:{mapping}", "namespace:=real_launch", "bag:="]
    done = subprocess.run(
        [sys.executable, "-c", LAUNCH, LAUNCH_FOLDER / "simulation.launch.py", *arguments],
        cwd=tmp_path, env=ros_environment | {"AMENT_PREFIX_PATH": f"{prefix}:{others}"},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    told = done.stdout.splitlines()
    (line,) = (line for line in told if "[FATAL]" in line)
    assert line.endswith("bicycle.fmu: outputs: no variable 'ex'; did you mean x?")
    assert "Traceback" not in done.stdout
    assert any(line.endswith("tricycle_sim has ended") for line in told)
    assert done.returncode == 1
    ended = {line.split("]")[1].split("[")[1] for line in told if "finished cleanly" in line}
    assert {name.rpartition("-")[0] for name in ended} == {
        *("tricycle_bridge", "excitation_planner", "maneuver_driver", "trajectory_recorder"),
    }
