"""Choice of topics by patterns of their names."""

from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase

from tricycle_core.errors import BagError, hint


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Return whether a name fits one of the patterns.

    Parameters
    ----------
    name : str
        Name of a topic, or of a value.
    patterns : sequence of str
        Patterns in which ``*`` and ``?`` match anything.

    Examples
    --------
    >>> matches("/maneuver/path", ["/odom", "/maneuver/*"])
    True
    """
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def chosen(names: Collection[str], patterns: Sequence[str], without: Sequence[str]) -> list[str]:
    """Return the topics of a bag that patterns select.

    Parameters
    ----------
    names : collection of str
        Names of the bag's topics.
    patterns, without : sequence of str
        Names or patterns to include, and to exclude from those; ``odom`` is ``/odom``.

    Raises
    ------
    BagError
        If a pattern fits no topic: it may be misspelt.

    Examples
    --------
    >>> chosen(["/odom", "/maneuver/path", "/maneuver/state"], ["odom", "/maneuver/*"], ["*/path"])
    ['/odom', '/maneuver/state']
    """
    wanted, unwanted = (
        [p if p.startswith(("/", "*")) else f"/{p}" for p in given] for given in (patterns, without)
    )
    for pattern in wanted + unwanted:
        if not any(matches(name, [pattern]) for name in names):
            raise BagError(f"no topic of the bag is {pattern}; {hint(pattern, names)}")
    return [name for name in names if matches(name, wanted) and not matches(name, unwanted)]
