"""The lock file pins, with hashes, something that satisfies each requirement of pyproject.toml."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCK = (ROOT / "requirements" / "lock.txt").read_text()
PINS = re.findall(
    r"^([\w.-]+)==([^\s;]+)(?: ; [^\\]*)?\s*\\\n    --hash=sha256:", LOCK, re.MULTILINE
)


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


def test_every_pin_has_a_hash():
    assert len(PINS) == len(re.findall(r"^[\w.-]+==", LOCK, re.MULTILINE)) > 50
