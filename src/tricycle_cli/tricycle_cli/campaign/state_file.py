"""`campaign.json`: the state of a campaign, written after every step of work."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from parameter_identification.drives.recorded import TopicNames
from parameter_identification.identification_file import IdentificationDocument
from tricycle_cli.campaign.request import Settings
from tricycle_core.documents import decode, encode, parse_json, read_bounded, write_whole
from tricycle_core.errors import PlanError

SCHEMA = 3
MAX_BYTES = 64_000_000


@dataclass(frozen=True)
class Step:
    """One drive of the campaign.

    Attributes
    ----------
    target : str
        Parameter that it was planned for.
    plan, bag : str
        Paths of the plan and the bag, relative to the campaign's folder.
    maneuver : str
        Name of the maneuver family.
    operation : mapping of str to float
        Value of each operation parameter.
    plan_id : str
        Id of the plan.
    duration : float
        Duration of the maneuver [s]; after the identification, of the part that was driven.
    predicted_std : mapping of str to float
        Expected standard deviation of each parameter after it, in its unit.
    driven : bool
        Whether it was driven to its end; the bag is then never deleted.
    identification : IdentificationDocument, optional
        Result after this drive; None: not yet identified.

    Raises
    ------
    PlanError
        If plan or bag is outside of the folder: the bag of an incomplete drive is deleted.
    """

    target: str
    plan: str
    bag: str
    maneuver: str
    operation: Mapping[str, float]
    plan_id: str
    duration: float
    predicted_std: Mapping[str, float]
    driven: bool = False
    identification: IdentificationDocument | None = None

    def __post_init__(self) -> None:
        for file, pattern in ((self.plan, "plans/[0-9]+[.]json"), (self.bag, "bags/[0-9]+")):
            if not re.fullmatch(pattern, file):
                raise PlanError(f"{file!r} must be plans/NUMBER.json, or bags/NUMBER of a bag")


@dataclass(frozen=True)
class CampaignState:
    """Content of the campaign's state file.

    Attributes
    ----------
    schema : int
        Version of this format.
    settings : Settings
        Settings of the campaign.
    steps : tuple of Step
        Drives so far; the last one may be unfinished.
    topics : TopicNames
        Names of the topics in the bags.
    """

    schema: int = field(default=SCHEMA, kw_only=True)
    settings: Settings
    steps: tuple[Step, ...] = ()
    topics: TopicNames = field(default_factory=TopicNames)

    def write(self, file: Path) -> None:
        """Write or replace the file."""
        write_whole(file, json.dumps(encode(self), indent=1) + "\n")

    @classmethod
    def read(cls, file: Path) -> "CampaignState":
        """Read the file.

        Raises
        ------
        PlanError
            If it is of another version, or not the state of a campaign; with the place.
        """
        content = read_bounded(file, MAX_BYTES, "the state of a campaign", PlanError)
        values = parse_json(content, str(file), PlanError)
        schema = values.get("schema") if isinstance(values, dict) else None
        if schema not in (SCHEMA, None):
            raise PlanError(f"{file}: schema {schema}; this one reads {SCHEMA}")
        return decode(cls, values, f"{file}: not the state of a campaign", PlanError)
