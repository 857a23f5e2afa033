"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from setuptools import find_packages, setup

NAME = "trajectory_recorder"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[f"{NAME}*"]),
    package_data={"": ["py.typed", "*.yaml", "*.xml", "*.html", "*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    extras_require={"test": ["pytest"]},  # colcon test then runs it
    maintainer="The tricycle excitation maintainers",
    maintainer_email="maintainers@example.org",
    description="RECORD: MCAP bags: recorder, replayer and a reader without ROS",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "trajectory_recorder = trajectory_recorder.executables:trajectory_recorder",
            "bag_replayer = trajectory_recorder.executables:bag_replayer",
        ]
    },
)
