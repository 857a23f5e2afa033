"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from setuptools import find_packages, setup

NAME = "parameter_identification"

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
    description="JUDGE and IDENTIFY: trajectory error of bags, parameter estimates",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "identification_monitor = parameter_identification.executables:identification_monitor",
        ],
    },
)
