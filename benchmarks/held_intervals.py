"""How many intervals hold the truth, and whether so many may be expected."""

from scipy.stats import binom

COVERAGE, LEVEL = 0.9, 0.01


class Tally:
    """How many intervals hold the truth, by row of a table.

    A row fails where an exact binomial test at 1 %, Holm-corrected over the rows, rejects a
    coverage of 90 % or more.
    """

    def __init__(self):
        self.held, self.made = {}, {}

    def count(self, row, held):
        """Count an interval."""
        self.held[row] = self.held.get(row, 0) + bool(held)
        self.made[row] = self.made.get(row, 0) + 1

    @property
    def failed(self):
        """Rows that fail."""
        chances = {row: binom.cdf(self.held[row], n, COVERAGE) for row, n in self.made.items()}
        failed, left = set(), len(chances)
        for row in sorted(chances, key=chances.get):
            if chances[row] >= LEVEL / left:
                break
            failed.add(row)
            left -= 1
        return failed

    def summary(self):
        """All rows in a line."""
        held, made = sum(self.held.values()), sum(self.made.values())
        failed = "; ".join(sorted(self.failed)) or "none"
        return f"{held} of {made} hold; of {len(self.made)} cells rejected: {failed}"

    def print(self):
        """Print the table, with the verdicts of the test."""
        failed = self.failed
        for row, n in self.made.items():
            held, verdict = self.held[row], "fails" if row in failed else "passes"
            print(f"{row:42s} {held:6d} of {n:6d} held ({held / n:6.1%}), {verdict}")
