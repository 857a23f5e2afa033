"""A report as one HTML file that needs nothing else: sections of text, tables and figures.

Light or dark as the reader's system is, and fit to be printed. Everything but the pictures and
`Markup` is escaped. A page with plots to zoom into carries Plotly's script once, compressed; the
page unpacks it after it is shown, and draws a plot when it comes into view.
"""

from __future__ import annotations

import base64
import gzip
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Self

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class TableBlock:
    """A table of a page.

    Attributes
    ----------
    headings : tuple of str
        Headings of the columns.
    rows : tuple of tuple of str
        Cells of each row, one per heading; a cell that ends with ✗ is marked as a miss. Cells of
        `Markup` hold HTML.
    caption : str
        Text above it.

    Raises
    ------
    ValueError
        If a row has another number of cells.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.headings) for row in self.rows):
            raise ValueError(f"{self.caption}: every row must have {len(self.headings)} cells")

    @classmethod
    def without_empty_columns(
        cls, headings: Sequence[str], rows: Sequence[Sequence[str]], caption: str = ""
    ) -> Self:
        """Return a table without the columns in which every cell is empty.

        Parameters
        ----------
        headings : sequence of str
            Headings of all columns.
        rows : sequence of sequence of str
            Rows with a cell in each column.
        caption : str
            Text above it.
        """
        filled = [k for k in range(len(headings)) if any(row[k] for row in rows)]
        cells = tuple(tuple(row[k] for k in filled) for row in rows)
        return cls(tuple(headings[k] for k in filled), cells, caption)


@dataclass(frozen=True)
class FigureBlock:
    """A picture inside the page.

    Attributes
    ----------
    uri : str
        The picture itself, as a `data:` address.
    alt : str
        Description of the figure for those who cannot see it.
    caption : str
        Text below it.
    """

    uri: str
    alt: str
    caption: str

    @classmethod
    def of(cls, figure: Figure, *, alt: str, caption: str) -> Self:
        """Return a Matplotlib figure as a block, drawn as SVG.

        Parameters
        ----------
        figure : Figure
            Figure to draw.
        alt, caption : str
            See the attributes.
        """
        from matplotlib import rc_context

        file = io.StringIO()
        # without salt and date the same figure would give another file each time
        with rc_context({"svg.hashsalt": "figure"}):
            figure.savefig(file, format="svg", metadata={"Date": None})
        encoded = base64.b64encode(file.getvalue().encode()).decode()
        return cls(f"data:image/svg+xml;base64,{encoded}", alt, caption)


@dataclass(frozen=True)
class PlotBlock:
    """Figures to zoom into, side by side where there are several and the page is wide enough.

    Attributes
    ----------
    name : str
        Name of the files that the figure is written to on demand.
    plots : tuple of go.Figure
        Texts in them are Plotly's HTML and must have been escaped.
    caption : str
        Text below them.
    """

    name: str
    plots: tuple[go.Figure, ...]
    caption: str

    @property
    def drawn(self) -> list[tuple[int, Markup]]:
        """Return each plot's height [px], kept free until it is drawn, and its data as JSON."""
        return [(int(plot.layout.height or 400), _script_json(plot)) for plot in self.plots]


def _script_json(plot: go.Figure) -> Markup:
    text = str(plot.to_json()).replace("<", "\\u003c")
    return Markup(text)  # noqa: S704 - without "<" nothing ends the script element


@dataclass(frozen=True)
class Section:
    """A heading and what is below it.

    Attributes
    ----------
    title : str
        Text of the heading.
    blocks : tuple of str, TableBlock, FigureBlock or PlotBlock
        A string is a paragraph.
    """

    title: str
    blocks: tuple[str | TableBlock | FigureBlock | PlotBlock, ...]


def html_page(title: str, sections: Sequence[Section], *, subtitle: str = "") -> str:
    """Return the page as the text of an HTML file.

    Parameters
    ----------
    title : str
        Title of the page.
    sections : sequence of Section
        Sections of the page; more than two get a table of contents.
    subtitle : str
        Line below the title.
    """
    template = (resources.files("tricycle_cli.reports") / "page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    script = ""
    if any(isinstance(block, PlotBlock) for section in sections for block in section.blocks):
        from plotly.offline import get_plotlyjs

        packed = gzip.compress(get_plotlyjs().encode(), mtime=0)
        script = Markup(base64.b64encode(packed).decode())  # noqa: S704 - a script of the package
    return environment.from_string(template).render(
        title=title, sections=sections, subtitle=subtitle, plotly=script
    )
