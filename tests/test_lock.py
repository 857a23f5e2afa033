"""The lock files pin, with hashes, something that satisfies each requirement of pyproject.toml."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCK, RUN = ((ROOT / "requirements" / name).read_text() for name in ("lock.txt", "run.txt"))


def pins(lock):
    """Name and version of each pin that has a hash."""
    form = r"^([\w.-]+)(?:\[[\w,-]+\])?==([^\s;]+)(?: ; [^\\]*)?\s*\\\n    --hash=sha256:"
    return re.findall(form, lock, re.MULTILINE)


PINS = pins(LOCK)


def requirements(*extras):
    """What the distribution needs with these extras; it may name itself with further ones."""
    for extra in extras:
        for text in PROJECT["optional-dependencies"][extra]:
            requirement = Requirement(text)
            if requirement.name == PROJECT["name"]:
                yield from requirements(*sorted(requirement.extras))
            else:
                yield requirement


@pytest.mark.parametrize(
    "requirement",
    [*map(Requirement, PROJECT["dependencies"]), *requirements("dev", "ros")],
    ids=str,
)
def test_every_requirement_is_pinned(requirement):
    versions = [
        Version(version)
        for name, version in PINS
        if canonicalize_name(name) == canonicalize_name(requirement.name)
    ]
    assert versions, "run `make lock`"
    assert all(version in requirement.specifier for version in versions), "run `make lock`"


@pytest.mark.parametrize("lock", [LOCK, RUN])
def test_every_pin_has_a_hash(lock):
    assert len(pins(lock)) == len(re.findall(r"^[\w.,\[\]-]+==", lock, re.MULTILINE)) > 50


def test_what_runs_is_a_part_of_what_develops():
    assert set(pins(RUN)) < set(PINS)
    needed = [*map(Requirement, PROJECT["dependencies"]), *requirements("reports", "ros")]
    pinned = {canonicalize_name(name) for name, _ in pins(RUN)}
    assert {canonicalize_name(requirement.name) for requirement in needed} <= pinned
    assert "mypy" not in pinned
