"""Checks that bloom and the ROS build farm could take the packages, as far as a script can tell.

    python deploy/rosdistro/check_release.py

Compares each package.xml with what its modules import and with `keys.txt`, the keys of rosdep and
the packages of ROS 2 Jazzy of a day. Exit status 1 where a package.xml is wrong; what only a
release needs is told, and changes nothing.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
KEYS = {
    line
    for line in (Path(__file__).parent / "keys.txt").read_text().splitlines()
    if not line.startswith("#")
}
OWN = {path.name for path in (ROOT / "src").iterdir()}
KEY_OF = {
    "PIL": "python3-pil",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
    "rosbags": "python3-rosbags-pip",
}
WITHOUT_KEY = {  # Python modules that rosdep does not know: `pip install` brings them
    *("cobs", "cobyqa", "lazy_loader", "llvmlite", "lz4", "markupsafe", "mcap", "msgspec"),
    *("cloudpickle", "loky", "plotly", "threadpoolctl", "zstandard"),
}
# imported where they are installed
OPTIONAL = {
    *("aiohttp", "fmpy", "fsspec", "mujoco", "paramiko", "pyarrow", "pytest", "upath"),
    "vehiclemodels",
}
NOT_IMPORTED = {"robot_state_publisher", "python3-pytest"}  # started, or used by colcon
PLACEHOLDERS = ("example.org",)


def imported(package: str) -> set[str]:
    """Return the first names of what a package imports, launch files included."""
    return {name.split(".")[0] for tree in _trees(package) for name in _imports(tree)}


def launched(package: str) -> set[str]:
    """Return the packages whose names a package's launch files and modules hold as strings."""
    if package != "tricycle_bringup":
        return set()
    nodes = (node for tree in _trees(package) for node in ast.walk(tree))
    return OWN & {
        n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)
    }


def _trees(package: str) -> list[ast.Module]:
    folder = ROOT / "src" / package
    files = [*(folder / package).rglob("*.py"), *(folder / "launch").glob("*.py")]
    return [ast.parse(file.read_text()) for file in files]


def _imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
        elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield from _imports(node)


def needed(package: str) -> set[str]:
    """Return the keys of what a package imports, those without a key left out."""
    names = imported(package) | launched(package)
    names -= set(sys.stdlib_module_names) | WITHOUT_KEY | OPTIONAL | {package}
    return {
        name if name in OWN or name in KEYS else KEY_OF.get(name, f"python3-{name}")
        for name in names - {"__future__"}
    }


def problems(package: str) -> list[str]:
    """Return what is wrong with a package.xml, one line each."""
    folder = ROOT / "src" / package
    xml = ElementTree.parse(folder / "package.xml").getroot()  # noqa: S314 - our own
    found = []
    declared = {element.text or "" for element in xml if element.tag.endswith("depend")}
    unknown = declared - OWN - KEYS
    found += [f"{key} is no key of rosdep and no package of Jazzy" for key in sorted(unknown)]
    wanted = needed(package)
    found += [f"{key} is imported and not declared" for key in sorted(wanted - declared)]
    unused = declared - wanted - NOT_IMPORTED
    found += [f"{key} is declared and not imported" for key in sorted(unused)]
    for tag in ("name", "version", "description", "maintainer", "license", "url"):
        if not xml.findtext(tag):
            found.append(f"<{tag}> is missing")
    if "python3-pytest" not in {element.text for element in xml.findall("test_depend")}:
        found.append(
            "<test_depend>python3-pytest</test_depend> is missing: colcon test runs nothing"
        )
    changelog = folder / "CHANGELOG.rst"
    if not changelog.exists() or f"Changelog for package {package}" not in changelog.read_text():
        found.append("CHANGELOG.rst, from which bloom makes the release, is missing")
    return found


def open_ends(package: str) -> list[str]:
    """Return what a release still needs."""
    text = (ROOT / "src" / package / "package.xml").read_text()
    found = [f"{p} stands for an address" for p in PLACEHOLDERS if re.search(re.escape(p), text)]
    modules = sorted(imported(package) & WITHOUT_KEY)
    return found + [f"{module} has no key in rosdep" for module in modules]


def main() -> int:
    """Print all of it; return the exit status."""
    wrong = 0
    for package in sorted(OWN):
        mistakes = problems(package)
        wrong += len(mistakes)
        for line in mistakes:
            print(f"{package}: {line}")
    for package in sorted(OWN):
        for line in open_ends(package):
            print(f"{package}: before a release: {line}")
    print(f"{wrong} mistakes")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
