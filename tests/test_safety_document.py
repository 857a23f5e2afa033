"""Every hazard in docs/safety.md names tests that exist."""

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "safety.md").read_text()
TABLE = PAGE.split("<!-- hazards -->")[1].split("<!-- end -->")[0]
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")] for line in TABLE.strip().splitlines()[2:]
]
NAMED = re.findall(r"`([\w/]+\.py)::(\w+)`", TABLE)


def test_every_hazard_has_all_its_cells_and_a_test():
    assert len(ROWS) >= 30
    for row in ROWS:
        assert len(row) == 6
        assert all(row), row
        assert "::" in row[-1], row


@pytest.mark.parametrize(("file", "name"), sorted(set(NAMED)))
def test_the_named_test_exists(file, name):
    assert re.search(rf"^def {name}\(", (TESTS / file).read_text(), re.MULTILINE)
