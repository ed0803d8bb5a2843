"""Tables: numbers in cells, one formatter for all that draw them."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from cellapp.commands.view.parts import Part, Section
from cellapp.commands.view.table import Column, Interval, Table
from cellapp.ground.counting import mm, plain
from cellapp.interfaces.render.terminal import TerminalTable, shortened

TABLE = Table(
    "Errors [mm]",
    (Column("stage"), Column("mean", ".4f", "mm"), Column("n", "d"), Column("note")),
    (("nominal", 0.12345, 17, "[bold]"), ("effects", Interval(0.1, 0.25), None, None)),
)


def test_numbers_in_sentences_have_no_exponent_and_are_never_minus_zero() -> None:
    assert [mm(8.48e-5), mm(-1e-7), mm(12345.6)] == ["0.0001 mm", "0.0000 mm", "12345.6 mm"]
    assert [plain(3.5e4), plain(8.48e-5), plain(-0.0), plain(-2.5e-7, 1)] == ["35000", "0.0000848", "0", "-0.0000002"]


def test_a_row_needs_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="1 cells in a row of 2 columns"):
        Table("t", (Column("a"), Column("b")), (("only",),))


def test_of_a_long_view_a_terminal_gets_the_sentences_what_fits_and_the_command_for_the_rest() -> None:
    long, deep = replace(TABLE, rows=TABLE.rows * 20), Section(["detail"], title="deep")
    view: list[Part] = ["first", long, TABLE, Section([long, "inner", deep], title="outer"), "last"]
    assert shortened(view, str, 80, "rest") == ["first", TABLE, "outer", "  inner", "", "last", "rest"]
    assert shortened([*view[2:3], deep], str, 80, "rest") == [TABLE, "deep", "  detail", ""], "all of it fits"


def drawn(table: Table, width: int) -> str:
    output = io.StringIO()
    Console(file=output, width=width).print(TerminalTable(table, cut=False), crop=False)
    return output.getvalue()


def words_of(table: Table) -> list[str]:
    return " ".join([table.title, *table.headings, *(" ".join(row) for row in table.text_rows())]).split()


_WORDS = st.text("abcdefghijkl", min_size=1, max_size=14)
_CELLS = st.one_of(
    st.lists(_WORDS, min_size=1, max_size=12).map(" ".join), st.floats(-1e4, 1e4), st.just(Interval(0.1, 0.25))
)


@st.composite
def tables(draw: st.DrawFn) -> Table:
    texts = draw(st.lists(st.booleans(), min_size=1, max_size=14))
    columns = tuple(
        Column(draw(_WORDS)) if is_text else Column(draw(_WORDS), ".4f", draw(st.sampled_from(["", "mm rms"])))
        for is_text in texts
    )
    rows = draw(st.lists(st.tuples(*[_CELLS] * len(columns)), min_size=1, max_size=4))
    return Table(draw(_WORDS), columns, tuple(rows))


@given(tables(), st.integers(34, 120))
def test_no_word_is_broken_nothing_is_left_out_and_no_line_is_wider_than_the_terminal(table: Table, width: int) -> None:
    text = drawn(table, width)
    assert all(len(line) <= width for line in text.splitlines())
    assert {*words_of(table)} <= {*text.replace(":", " ").split()} | {":"}


def test_a_table_that_does_not_fit_is_printed_in_parts_that_repeat_the_names_of_its_rows() -> None:
    columns = (Column("arm"), Column("pose"), *(Column(f"value {k}", ".4f", "mm") for k in range(12)))
    rows = tuple((arm, pose, *(float(k) for k in range(12))) for arm in ("left", "right") for pose in ("P1", "P2"))
    lines = drawn(Table("Many", columns, rows), 80).splitlines()
    assert sum(line.split()[:2] == ["left", "P1"] for line in lines) == 2
    assert sum(line.split()[:2] == ["right", "P2"] for line in lines) == 2
    for k in range(12):
        assert sum(f"{k}.0000" in line.split() for line in lines) == 4


def test_a_table_whose_single_cells_do_not_fit_becomes_lines_and_long_words_stay_whole() -> None:
    digest = "5f" * 45
    text = drawn(Table("Hashes", (Column("file"), Column("sha256")), (("certificate.html", digest),)), 80)
    assert text.splitlines() == ["Hashes", "  file: certificate.html", "    sha256:", f"      {digest}", ""]
