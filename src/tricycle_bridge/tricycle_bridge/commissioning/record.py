"""The signed-off record of a bring-up: a JSON file that arming can ask for."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path

from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.documents import decode, encode, parse_json, read_bounded, write_whole
from tricycle_core.errors import LinkError

_FORMAT = "tricycle bring-up 2"
_LARGEST = 1_000_000  # bytes
_DAY = timedelta(days=1)
# how often is commanded, and what is loaded today: nothing that a bring-up shows
_PASSING = "command_rate", "standstill_rate", "payload"
# what the boards may be set up for with less, but not with more
_LIMITS = "max_steering_angle", "max_steering_rate", "max_speed", "max_acceleration"


@dataclass(frozen=True)
class StepResult:
    """Result of a step of the bring-up.

    Attributes
    ----------
    name : str
        What the step checked.
    passed : bool
        Whether it passed.
    measured : dict
        Measured values, by name with unit.
    problem : str
        Why it did not pass; empty if it did.
    """

    name: str
    passed: bool
    measured: dict[str, float | str]
    problem: str = ""


@dataclass(frozen=True)
class BringUpRecord:
    """A bring-up, signed off by an engineer.

    Attributes
    ----------
    engineer : str
        Name of the engineer.
    time : str
        When it ended, ISO 8601 with the offset from UTC.
    steer_firmware, drive_firmware : str
        Version and build of each board.
    steps : tuple of StepResult
        Results of the steps in their order; the last one is the first that did not pass.
    complete : bool
        Whether every step was run and passed.
    settings : dict of str to float
        `BridgeSettings` of the vehicle that was brought up.
    format : str
        Name and version of the file format.
    digest : str
        SHA-256 of everything else in the file, which reveals a later change by hand.
    """

    engineer: str
    time: str
    steer_firmware: str
    drive_firmware: str
    steps: tuple[StepResult, ...]
    complete: bool
    settings: dict[str, float] = field(default_factory=dict)
    format: str = _FORMAT
    digest: str = ""

    def problem(
        self,
        firmware: Mapping[Board, str],
        settings: BridgeSettings,
        now: datetime,
        max_age: timedelta,
    ) -> str | None:
        """Return why this record does not allow to arm; None if it does.

        Parameters
        ----------
        firmware : mapping of Board to str
            `firmware_build` of the boards that are connected.
        settings : BridgeSettings
            Settings of the vehicle that is to be armed.
        now : datetime
            Present time, with its time zone.
        max_age : timedelta
            Largest age of a record.
        """
        if not self.complete:
            failed = next((step.name for step in self.steps if not step.passed), "its steps")
            return f"the bring-up did not pass: {failed}"
        then = {Board.STEER: self.steer_firmware, Board.DRIVE: self.drive_firmware}
        for board, here in firmware.items():
            if then[board] != here:
                return f"the bring-up was made with {board.plc_name} {then[board]}, not {here}"
        for name, here_too in asdict(settings).items():
            made = self.settings.get(name, math.nan)
            lower = name in _LIMITS and here_too < made
            if name not in _PASSING and not lower and not math.isclose(here_too, made):
                return (
                    f"the bring-up was made with {name} {made:g}, not {here_too:g}: "
                    "`tricycle plc check --vehicle FILE` of this vehicle"
                )
        age = now - datetime.fromisoformat(self.time)
        if age > max_age:
            days, most = age / _DAY, max_age / _DAY
            return f"the bring-up is {days:.1f} days old, at most {most:.1f} are allowed"
        if age < -_DAY:  # less is two computers' clocks
            return f"the bring-up is dated {self.time}, {-age / _DAY:.1f} days ahead of this clock"
        return None


def _digest(record: BringUpRecord) -> str:
    content = json.dumps(encode(replace(record, digest="")), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def write_record(path: Path, record: BringUpRecord) -> BringUpRecord:
    """Write a record with its digest, and return the digest; an older file is replaced.

    Parameters
    ----------
    path : Path
        File to write.
    record : BringUpRecord
        Record to write.
    """
    sealed = replace(record, digest=_digest(record))
    write_whole(path, json.dumps(encode(sealed), indent=2) + "\n")
    return sealed


def read_record(path: Path) -> BringUpRecord:
    """Read a record.

    Parameters
    ----------
    path : Path
        File of `write_record`.

    Raises
    ------
    LinkError
        It cannot be read, is none, or was changed.
    """
    try:
        content = read_bounded(path, _LARGEST, "a bring-up record", LinkError)
    except OSError as error:
        raise LinkError(f"{path}: {error.strerror}; `tricycle plc check` writes it") from None
    record = decode(BringUpRecord, parse_json(content, str(path), LinkError), str(path), LinkError)
    if record.format != _FORMAT:
        raise LinkError(
            f"{path}: format is {record.format!r}, must be {_FORMAT!r}: bring the vehicle up again"
        )
    try:
        aware = datetime.fromisoformat(record.time).tzinfo is not None
    except ValueError:
        aware = False
    if not aware:
        raise LinkError(f"{path}: time is {record.time!r}, must be ISO 8601 with its UTC offset")
    if record.digest != _digest(record):
        raise LinkError(f"{path}: its digest does not fit: it was changed after the bring-up")
    return record
