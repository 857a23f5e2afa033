"""Progress of an estimation, in steps of about the same time."""

from tricycle_core.quantities import Progress


class Steps:
    """Counts steps and tells how many are done.

    Parameters
    ----------
    progress : callable or None
        Told the numbers of steps done and in all.
    total : int
        Number in all.
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one step."""
        self.pass_to(self._done + 1)

    def pass_to(self, done: int) -> None:
        """Count all steps up to one: what they belong to has ended, perhaps early.

        Parameters
        ----------
        done : int
            Number done, of those since the beginning.
        """
        self._done = done
        if self._progress is not None:
            self._progress(done, self._total)


def uncounted() -> None:
    """Count nothing."""
