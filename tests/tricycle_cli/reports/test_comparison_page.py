"""Published numbers beside ours, on the page and in the terminal."""

import io

from matplotlib.figure import Figure
from rich.console import Console

from paper_reproduction.comparison import Agreement, Comparison, Item
from tricycle_cli.reports.comparison_page import comparison_page, comparison_table

ITEM = Item(
    "fig0",
    "Figure 0",
    (
        Comparison("S of p1", 0.5, 0.49, Agreement.REPRODUCED),
        Comparison("R²", 0.9, 0.999999, Agreement.BETTER),
    ),
    ("It was found so.",),
    None,
)


def test_the_page_has_numbers_verdict_and_findings():
    page = comparison_page([ITEM], [Figure()])
    for text in ("S of p1", "0.49", "1 − 1.0e-06", "It was found so.", "How the paper was read"):
        assert text in page
    assert page.count("<img") == 1
    assert 'data-heading=""' not in page  # the label of a cell on a narrow screen


def test_the_table_has_a_row_per_quantity():
    console = Console(width=100, file=io.StringIO(), record=True)
    console.print(comparison_table(ITEM))
    text = console.export_text()
    assert "Figure 0" in text
    assert "better than published" in text
