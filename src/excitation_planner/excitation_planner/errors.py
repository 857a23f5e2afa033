"""The two exceptions of planning: a user's mistake, and a maneuver that cannot be driven."""


class DesignError(ValueError):
    """A sensitivity analysis or a design cannot be made as asked; the message says why."""


class InfeasibleManeuver(Exception):  # noqa: N818  (an outcome of a simulation, not a mistake)
    """Raised by ``f(x, P)`` when the maneuver x cannot be driven, whatever the parameters.

    Parameters
    ----------
    reason : str
        What makes it infeasible, e.g. ``"steering saturates at 3.2 s"``.
    """
