"""A report as one HTML file that needs nothing else: sections of text, tables and figures.

Light or dark as the reader's system is, and fit to be printed. Everything but the pictures is
escaped. A page with plots to zoom into carries Plotly's script once.
"""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Self

import plotly.graph_objects as go
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure
from plotly.offline import get_plotlyjs


@dataclass(frozen=True)
class TableBlock:
    """A table; every row has as many cells as there are headings."""

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
    uri
        The picture itself, as a `data:` address.
    alt
        What it shows, for those who cannot see it.
    caption
        Text below it.
    """

    uri: str
    alt: str
    caption: str

    @classmethod
    def of(cls, figure: Figure, *, alt: str, caption: str) -> Self:
        """Draw a Matplotlib figure as SVG."""
        file = io.StringIO()
        # without salt and date the same figure would give another file each time
        with rc_context({"svg.hashsalt": "figure"}):
            figure.savefig(file, format="svg", metadata={"Date": None})
        encoded = base64.b64encode(file.getvalue().encode()).decode()
        return cls(f"data:image/svg+xml;base64,{encoded}", alt, caption)


@dataclass(frozen=True)
class PlotBlock:
    """A figure to zoom into; text in it is Plotly's HTML and must have been escaped."""

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
    """A heading and what stands below it; a string is a paragraph."""

    title: str
    blocks: tuple[str | TableBlock | FigureBlock | PlotBlock, ...]


def html_page(title: str, sections: Sequence[Section], *, subtitle: str = "") -> str:
    """Return the page as the text of an HTML file."""
    template = (resources.files("tricycle_cli.reports") / "page.html").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    plots = any(isinstance(block, PlotBlock) for section in sections for block in section.blocks)
    return environment.from_string(template).render(
        title=title,
        sections=sections,
        subtitle=subtitle,
        plotly=Markup(get_plotlyjs()) if plots else "",  # noqa: S704 - a script of the package
    )
