"""What a view is made of: plain text says all of it but the charts, and a section has a message."""

from __future__ import annotations

import pytest

from cellapp.commands.view.charts import Axis, Chart
from cellapp.commands.view.parts import Facts, Parts, Section, printed, section_of
from cellapp.commands.view.table import Column, Table
from cellapp.interfaces.page.drawn import drawn_parts
from cellapp.interfaces.page.page import template
from cellapp.interfaces.render.notebook import html_view
from cellapp.interfaces.render.terminal import plain_text

pytestmark = pytest.mark.fast

TABLE = Table("a table", (Column("name"),), (("<b>",),))
CHART = Chart("a chart", Axis("x"), Axis("y"), (), "nothing")
INSIDE = Section("details", ["'cellapp docs x' says more"], folded=True)
SHOWN = Section(
    "shown", [CHART, "word " * 30, Section("empty", [CHART])], message="In a sentence.", about="how to read"
)
PARTS: Parts = ["first", Facts((("title", "text"), ("", "more"))), CHART, TABLE, INSIDE, SHOWN, "last"]


def test_plain_text_says_everything_but_charts_and_details_in_its_order() -> None:
    told = list(printed(PARTS))
    wrapped = ["  " + " ".join(["word"] * 15), "    " + " ".join(["word"] * 15)]
    section = ["shown", "  In a sentence.", *wrapped, ""]
    assert told == ["first", "title: text", "  more", TABLE, *section, "last"]
    for text in (plain_text(PARTS), html_view(PARTS)):
        assert all(words in text for words in ("first", "title: text", "a table", "shown", "last"))
        assert not any(words in text for words in ("a chart", "details", "empty", "how to read"))


def test_the_message_of_a_section_is_its_first_line_or_what_is_said() -> None:
    assert (section_of("t", [TABLE, "it holds", "second"]).message, section_of("t", [], message="yes!").message) == (
        "It holds.",
        "yes!".capitalize(),
    )
    assert section_of("t", [TABLE, "it holds", "second"]).parts == [TABLE, "second"]


def test_the_page_draws_parts_by_their_kind_and_leaves_empty_charts_out() -> None:
    drawn = drawn_parts(PARTS, "key")
    assert (drawn.sentences, drawn.figures, [table for table, _ in drawn.tables]) == (("first", "last"), (), [TABLE])
    html = str(template("sections/layout.html").module.draw_parts(drawn))  # type: ignore[attr-defined]
    assert "<dt>title</dt>" in html
    assert "&lt;b&gt;" in html
    assert "<code>cellapp docs x</code> says more" in html
    assert '<details class="more">' in html
