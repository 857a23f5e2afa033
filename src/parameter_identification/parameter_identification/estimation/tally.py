"""Progress of an estimation: how many of its parts, which take about the same time, are done."""

from tricycle_core.quantities import Progress


class Tally:
    """Counts what is done, and tells it.

    Parameters
    ----------
    progress : callable or None
        Told the numbers of parts done and in all.
    total : int
        Number in all.
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        """Count one part."""
        self.pass_to(self._done + 1)

    def pass_to(self, done: int) -> None:
        """Count all parts up to one: what they belong to has ended, perhaps early.

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
