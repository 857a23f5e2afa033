"""The pytest fixtures that this suite ships.

``plc_pair`` gives a test both PLCs, emulated, on serial devices of their own::

    def test_my_bridge(plc_pair):
        bridge = MyBridge(plc_pair.steer_path, plc_pair.drive_path)
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tricycle_sim.plc.pair import PlcPair


@pytest.fixture
def plc_pair(tmp_path: Path) -> Iterator[PlcPair]:
    """Both PLCs on ptys, running in real time with a vehicle that follows its set-points.

    Parameters
    ----------
    tmp_path : Path
        Folder in which the two serial devices appear.

    Yields
    ------
    PlcPair
        The boards; closed after the test.
    """
    # imported here: this plugin is loaded into every test run of the environment
    from tricycle_sim.plc.pair import PlcPair

    with PlcPair(tmp_path / "steer_plc", tmp_path / "drive_plc") as pair:
        yield pair
