"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from setuptools import find_packages, setup

NAME = "tricycle_sim"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[f"{NAME}*"]),
    package_data={"": ["py.typed", "*.yaml", "*.xml", "*.html", "*.json", "*.c"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    extras_require={"test": ["pytest"]},  # colcon test then runs it
    maintainer="The tricycle excitation maintainers",
    maintainer_email="maintainers@example.org",
    description="The 9-DOF tricycle, its emulated PLCs and the simulation node",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "tricycle_sim = tricycle_sim.executables:tricycle_sim",
        ],
        "tricycle_sim.plants": [
            "mujoco = tricycle_sim.plants.mujoco_plant:MujocoPlant",
            "commonroad = tricycle_sim.plants.commonroad_plant:MultiBodyPlant",
            "elsewhere = tricycle_sim.plants.elsewhere_node:ElsewherePlant",
            "fmu = tricycle_sim.plants.fmu_plant:fmu_plant",
        ],
        "pytest11": ["tricycle = tricycle_sim.pytest_plugin"],
    },
)
