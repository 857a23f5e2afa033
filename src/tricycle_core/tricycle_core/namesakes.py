"""Nodes of one name: their commands and answers cannot be told apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

UNNAMED = "_NODE_NAME_UNKNOWN_"
"""How the name of a node ends whose endpoint was discovered before it."""

FORGOTTEN = 20
"""Time after which the middleware forgets a node that did not end well, at most [s]."""

LEFT_BEHIND = f"one that crashed or was killed is forgotten within {FORGOTTEN} s"
"""What else than a running node may be seen, and what then helps."""


def full_name(namespace: str, name: str) -> str:
    """Return the name of a node with its namespace.

    Parameters
    ----------
    namespace : str
        As the graph tells it, `/` or `/first`.
    name : str
        Name of the node.
    """
    return f"{namespace.rstrip('/')}/{name}"


def namesakes(names: Iterable[str]) -> str:
    """Say which names several have, and what to do; empty where each has its own.

    Parameters
    ----------
    names : iterable of str
        Names of nodes, or of the nodes of endpoints.
    """
    doubled = {
        name: count
        for name, count in Counter(names).items()
        if count > 1 and not name.endswith(UNNAMED)
    }
    if not doubled:
        return ""
    which = ", ".join(f"{name} runs {count} times" for name, count in sorted(doubled.items()))
    return f"{which}: end all but one; {LEFT_BEHIND}"
