"""ament_python build of this package; without ROS the root pyproject.toml installs it."""

from setuptools import find_packages, setup

NAME = "paper_reproduction"

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
    description="The tables and figures of ASME IDETC2020-22257, computed again",
    license="Apache-2.0",
)
