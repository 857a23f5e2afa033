"""Options that are given as a member or by its name."""

from enum import StrEnum
from typing import Never

from tricycle_core.errors import DesignError


class Choice(StrEnum):
    """Enumeration by name; for an unknown name ``Choice(name)`` lists the known ones."""

    @classmethod
    def _missing_(cls, value: object) -> Never:
        names = ", ".join(repr(str(member)) for member in cls)
        raise DesignError(f"unknown {cls.__name__.lower()} {value!r}; one of: {names}")
