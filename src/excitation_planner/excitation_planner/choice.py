"""Options that are given as a member or by its name."""

from enum import StrEnum
from typing import Never

from tricycle_core.errors import DesignError


class Choice(StrEnum):
    """Options with names; ``Choice(name)`` lists the names where it is none of them."""

    @classmethod
    def _missing_(cls, value: object) -> Never:
        names = ", ".join(repr(str(member)) for member in cls)
        raise DesignError(f"unknown {cls.__name__.lower()} {value!r}; one of: {names}")
