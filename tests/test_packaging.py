"""The two ways to install agree: the root pyproject.toml and each ament_python package."""

import ast
import importlib.util
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tricycle_core import __version__

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PACKAGES = sorted(path.name for path in (ROOT / "src").iterdir())


def setup_arguments(package):
    """Keyword arguments of setup() that are literals."""
    tree = ast.parse((ROOT / "src" / package / "setup.py").read_text())
    (call,) = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"
    )
    arguments = {}
    for keyword in call.keywords:
        try:
            arguments[keyword.arg] = ast.literal_eval(keyword.value)
        except ValueError:
            continue
    return arguments


@pytest.mark.parametrize("package", PACKAGES)
def test_versions_agree(package):
    xml = ElementTree.parse(ROOT / "src" / package / "package.xml")
    assert xml.findtext("name") == package
    versions = {xml.findtext("version"), setup_arguments(package)["version"]}
    assert versions == {__version__}


def test_every_list_of_packages_is_complete():
    tool = PROJECT["tool"]
    wheel = tool["hatch"]["build"]["targets"]["wheel"]
    first, *others = tool["importlinter"]["contracts"]
    forbidden = [contract for contract in others if contract["type"] == "forbidden"]
    lists = {
        "wheel": [Path(folder).name for folder in wheel["packages"]],
        "package.xml": [Path(f).parts[1] for f in wheel["shared-data"] if f.endswith(".xml")],
        "resource": [Path(f).parts[1] for f in wheel["shared-data"] if f.endswith("/resource")],
        "ruff": tool["ruff"]["lint"]["isort"]["known-first-party"],
        "mypy": tool["mypy"]["packages"],
        "mypy_path": [Path(folder).name for folder in tool["mypy"]["mypy_path"].split(":")],
        "import-linter": tool["importlinter"]["root_packages"],
        "layers": first["layers"],
    } | {contract["name"]: contract["source_modules"] for contract in forbidden}
    assert {name: sorted(packages) for name, packages in lists.items()} == dict.fromkeys(
        lists, PACKAGES
    )


def test_entry_points_agree():
    found = {}
    for package in PACKAGES:
        for group, points in setup_arguments(package).get("entry_points", {}).items():
            found.setdefault(group, {}).update(point.split(" = ") for point in points)
    project = PROJECT["project"]
    assert found == {"console_scripts": project["scripts"], **project["entry-points"]}


def test_the_installed_distribution_is_an_ament_prefix(monkeypatch):
    index = pytest.importorskip("ament_index_python")
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    for package in PACKAGES:
        share = Path(index.get_package_share_directory(package))
        version = ElementTree.parse(share / "package.xml").findtext("version")
        assert version == __version__
    share = Path(index.get_package_share_directory("tricycle_bringup"))
    source = ROOT / "src" / "tricycle_bringup"
    for installed, folder in (
        (share / "launch", source / "launch"),
        (share / "urdf", source / "urdf"),
        (share / "foxglove", source / "tricycle_bringup" / "foxglove"),
        (share / "config", source / "tricycle_bringup" / "config"),
        (share / "plotjuggler", source / "plotjuggler"),
        (share / "rviz", source / "rviz"),
    ):
        assert names(installed) == names(folder)


def names(folder):
    return {path.name for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("package", PACKAGES)
def test_package_dependencies_follow_the_import_order(package):
    order = PROJECT["tool"]["importlinter"]["contracts"][0]["layers"][::-1]
    xml = ElementTree.parse(ROOT / "src" / package / "package.xml")
    own = [d.text for d in xml.findall("exec_depend") if d.text in PACKAGES]
    assert all(order.index(dependency) < order.index(package) for dependency in own)


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_is_what_bloom_and_the_build_farm_want(package):
    path = ROOT / "deploy" / "rosdistro" / "check_release.py"
    specification = importlib.util.spec_from_file_location("check_release", path)
    check = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(check)
    assert check.problems(package) == []
    assert setup_arguments(package)["extras_require"] == {"test": ["pytest"]}  # colcon test asks


def test_the_workspace_links_every_package():
    links = {link.name: link.resolve() for link in (ROOT / "ros_ws" / "src").iterdir()}
    assert links == {package: ROOT / "src" / package for package in PACKAGES}
