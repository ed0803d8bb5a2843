"""What a view is made of: plain text says all of it but the charts, and a section has a message."""

from __future__ import annotations

import pytest

from cellapp.commands.view.charts import Axis, Chart
from cellapp.commands.view.parts import Facts, Section, printed, section_of
from cellapp.commands.view.table import Column, Table
from cellapp.interfaces.page.drawn import drawn_parts
from cellapp.interfaces.page.templates import template
from cellapp.interfaces.render.html_view import html_view
from cellapp.interfaces.render.plain import plain_text

pytestmark = pytest.mark.fast

TABLE = Table("a table", (Column("name"),), (("<b>",),))
CHART = Chart("a chart", Axis("x"), Axis("y"), (), "nothing")
INSIDE = Section("details", ["`cellapp docs x` says more"], folded=True)
PARTS = ["first", Facts((("title", "text"), ("", "more"))), CHART, TABLE, INSIDE, "last"]


def test_plain_text_says_everything_but_charts_in_its_order() -> None:
    told = list(printed(PARTS))
    assert told == ["first", "title: text", "  more", TABLE, "details", "`cellapp docs x` says more", "last"]
    for text in (plain_text(PARTS), html_view(PARTS)):
        assert all(words in text for words in ("first", "title: text", "a table", "details", "last"))
        assert "a chart" not in text


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
