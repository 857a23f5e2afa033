"""`name=value` arguments of the command line."""

from collections.abc import Sequence

from tricycle_core.errors import PlanError


def parse_assignments(pairs: Sequence[str]) -> dict[str, float]:
    """Numbers by name from `name=value` texts.

    Raises
    ------
    PlanError
        If one is not of that form, or a name comes twice.
    """
    values: dict[str, float] = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            value = float(text)
        except ValueError:
            raise PlanError(f"{pair!r}: want name=number") from None
        if name in values:
            raise PlanError(f"{name} is given twice")
        values[name] = value
    return values
