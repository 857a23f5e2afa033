"""Reports are one file that needs nothing else."""

import base64
from html.parser import HTMLParser

import pytest
from matplotlib.figure import Figure

from tricycle_cli.reports.html_page import FigureBlock, Section, TableBlock, html_page


class Tags(HTMLParser):
    """What is opened, with its attributes, and the text in between."""

    def __init__(self, page):
        super().__init__()
        self.opened, self.text = [], ""
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.opened.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def figure():
    drawn = Figure()
    drawn.subplots().plot([0, 1], [0, 1])
    return FigureBlock.of(drawn, alt="a line", caption="A line.")


def test_what_a_page_holds_is_in_it():
    table = TableBlock(("a", "b"), (("1", "2"),), "two numbers")
    tags = Tags(html_page("Title", [Section("First", ("some text", table, figure()))]))
    for text in ("Title", "First", "some text", "two numbers", "A line."):
        assert text in tags.text
    (picture,) = [attributes for tag, attributes in tags.opened if tag == "img"]
    assert picture["alt"] == "a line"
    kind, _, encoded = picture["src"].partition(",")
    assert kind == "data:image/svg+xml;base64"
    assert b"<svg" in base64.b64decode(encoded)


def test_text_is_escaped():
    hostile = "<script>alert(1)</script>"
    table = TableBlock((hostile,), ((hostile,),), hostile)
    page = html_page(hostile, [Section(hostile, (hostile, table))], subtitle=hostile)
    assert "script" not in {tag for tag, _ in Tags(page).opened}
    assert Tags(page).text.count(hostile) >= 6


def test_nothing_is_loaded_from_elsewhere():
    for tag, attributes in Tags(html_page("t", [Section("s", (figure(),))])).opened:
        assert tag not in {"link", "script", "iframe"}
        assert attributes.get("src", "data:").startswith("data:")


def test_the_same_figure_gives_the_same_page():
    assert figure() == figure()


def test_a_row_with_a_missing_cell_is_refused():
    with pytest.raises(ValueError, match="2 cells"):
        TableBlock(("a", "b"), (("1",),))
