"""A report as one HTML file that needs nothing else: sections of text, tables and figures.

Light or dark as the reader's system is, and fit to be printed. Everything but the pictures is
escaped. A page with plots to zoom into carries Plotly's script once.
"""

from __future__ import annotations

import base64
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
    """A table.

    Attributes
    ----------
    headings : tuple of str
        Of the columns.
    rows : tuple of tuple of str
        As many cells as there are headings in each.
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


@dataclass(frozen=True)
class FigureBlock:
    """A picture inside the page.

    Attributes
    ----------
    uri : str
        The picture itself, as a `data:` address.
    alt : str
        What it shows, for those who cannot see it.
    caption : str
        Text below it.
    """

    uri: str
    alt: str
    caption: str

    @classmethod
    def of(cls, figure: Figure, *, alt: str, caption: str) -> Self:
        """Return a Matplotlib figure, drawn as SVG.

        Parameters
        ----------
        figure : Figure
            What to draw.
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
    """A figure to zoom into.

    Attributes
    ----------
    plot : go.Figure
        Texts in it are Plotly's HTML and must have been escaped.
    caption : str
        Text below it.
    """

    plot: go.Figure
    caption: str

    @property
    def html(self) -> Markup:
        """The plot as an element and the script that fills it."""
        text = self.plot.to_html(
            full_html=False,
            include_plotlyjs=False,
            config={"displaylogo": False, "responsive": True},
        )
        return Markup(text)  # noqa: S704 - Plotly encodes what could end the script


@dataclass(frozen=True)
class Section:
    """A heading and what is below it.

    Attributes
    ----------
    title : str
        Heading.
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
        Of the page.
    sections : sequence of Section
        Its content; more than two get a table of contents.
    subtitle : str
        Line below the title.
    """
    template = (resources.files("tricycle_cli.reports") / "page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    script = ""
    if any(isinstance(block, PlotBlock) for section in sections for block in section.blocks):
        from plotly.offline import get_plotlyjs

        script = Markup(get_plotlyjs())  # noqa: S704 - a script of the package
    return environment.from_string(template).render(
        title=title, sections=sections, subtitle=subtitle, plotly=script
    )
