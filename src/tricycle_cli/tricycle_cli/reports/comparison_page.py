"""The published numbers beside ours: the page and the tables of `tricycle reproduce`."""

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table

from paper_reproduction.comparison import Item
from paper_reproduction.first_stage import Predictions
from tricycle_cli.reports.html_page import FigureBlock, Section, TableBlock, html_page

READING = (
    "The wheelbase of Table 2 (1.43 m) is not the sum of the two distances to the centre of mass "
    "(0.724 m + 0.719 m = 1.443 m): the two distances are used.",
    "The speed range of the circle is printed as [0.6, 0.1]: read as 0.6 to 1.0 m/s.",
    "A ratio of right to left wheel angle of 0.8 at 0° cannot be: a symmetric linkage has 1 there, "
    "and inner and outer wheel change places with the side. Read as the ratio of outer to inner "
    "angle, 0.8 near straight ahead and 0.6 at 45°.",
    "Algorithm 1 stops when the largest Kriging variance is at most 0.01 of its mean. A largest "
    "value is never below the mean, so the whole budget is always spent.",
)


def comparison_table(item: Item[Any]) -> Table:
    """Return the published numbers of a table or figure beside ours, for the terminal.

    Parameters
    ----------
    item : Item
        Table or figure, computed again.
    """
    table = Table("quantity", "published", "ours", "verdict", title=item.title)
    for row in _rows(item):
        table.add_row(*row)
    return table


def comparison_page(items: Sequence[Item[Any]], figures: Sequence[Figure]) -> str:
    """Return the text of one HTML file.

    Parameters
    ----------
    items : sequence of Item
        Tables and figures, computed again.
    figures : sequence of Figure
        Drawing of each.
    """
    overview = TableBlock(("item", "verdict"), tuple((item.title, item.verdict) for item in items))
    sections = [Section("Overview", (overview,)), Section("How the paper was read", READING)]
    for item, figure in zip(items, figures, strict=True):
        table = TableBlock(("quantity", "published", "ours", "verdict"), _rows(item))
        picture = FigureBlock.of(figure, alt=f"{item.title}: {item.verdict}", caption=item.title)
        sections.append(Section(item.title, (table, picture, *_statistics(item), *item.findings)))
    return html_page(
        "The paper, reproduced",
        sections,
        subtitle="ASME IDETC2020-22257: published numbers beside those of this suite",
    )


def _number(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return f"1 − {1 - value:.1e}" if 0.99999 < value < 1 else f"{value:.6g}"


def _rows(item: Item[Any]) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (c.quantity, _number(c.published), _number(c.ours), str(c.agreement))
        for c in item.comparisons
    )


def _statistics(item: Item[Any]) -> tuple[TableBlock, ...]:
    """Error statistics of a metamodel as a table."""
    if not isinstance(item.data, Predictions):
        return ()
    headings = ("metamodel", "R²", "RAAE", "RMAE", "mean error", "std of error", "mean output",
                "std of output")  # fmt: skip
    rows = tuple(
        (label, _number(s.r2), *(f"{value:.2e}" for value in (s.raae, s.rmae, s.mean, s.std)),
         f"{s.output_mean:.4g}", f"{s.output_std:.4g}")
        for label, s in item.data.statistics.items()
    )  # fmt: skip
    unit = "without unit" if item.data.unit == "1" else f"in {item.data.unit}"
    return (TableBlock(headings, rows, f"Errors at the validation points; outputs {unit}"),)
