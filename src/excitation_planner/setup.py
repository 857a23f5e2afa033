"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from setuptools import find_packages, setup

NAME = "excitation_planner"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[f"{NAME}*"]),
    package_data={"": ["py.typed", "*.pyi", "*.yaml", "*.xml", "*.html", "*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    extras_require={"test": ["pytest"]},  # colcon test then runs it
    maintainer="The tricycle excitation maintainers",
    maintainer_email="maintainers@example.org",
    description="PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "excitation_planner = excitation_planner.executables:excitation_planner",
            "maneuver_driver = excitation_planner.executables:maneuver_driver",
        ],
        "excitation_planner.maneuvers": [
            "circle = excitation_planner.maneuver:Circle",
            "double_lane_change = excitation_planner.maneuver:DoubleLaneChange",
            "slalom = excitation_planner.maneuver:Slalom",
            "step_steer = excitation_planner.maneuver.steering:StepSteer",
            "sine_sweep = excitation_planner.maneuver.steering:SineSweep",
        ],
    },
)
