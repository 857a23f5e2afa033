"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "tricycle_bringup"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[f"{NAME}*"]),
    package_data={"": ["py.typed", "*.xml", "config/*.yaml", "foxglove/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(map(str, Path("launch").glob("*.launch.py")))),
        (f"share/{NAME}/urdf", ["urdf/tricycle.urdf"]),
        (f"share/{NAME}/foxglove", [f"{NAME}/foxglove/tricycle.json"]),
        (f"share/{NAME}/config", sorted(map(str, Path(NAME, "config").glob("*.yaml")))),
        (f"share/{NAME}/plotjuggler", ["plotjuggler/tricycle.xml"]),
        (f"share/{NAME}/rviz", ["rviz/tricycle.rviz"]),
    ],
    zip_safe=False,
    extras_require={"test": ["pytest"]},  # colcon test then runs it
    maintainer="The tricycle excitation maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch files, configuration, robot description and Foxglove layout",
    license="Apache-2.0",
)
