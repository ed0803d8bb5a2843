"""Bars of errors against their tolerances: what reaches how far, in which mark, in the width there is."""

from __future__ import annotations

import pytest

from cellapp.estimation.uncertainty.records import Conformity, Judgement
from cellapp.interfaces.tui.widgets.charts_view import error_bar, verdict_lines

pytestmark = pytest.mark.fast


def judged(value: float | None, expanded: float | None, conformity: Conformity, tolerance: float = 0.1) -> Judgement:
    return Judgement(
        characteristic="pose_accuracy", where="left", value_mm=value, expanded_mm=expanded, tolerance_mm=tolerance,
        rule="guarded", conformity=conformity, source="",
    )  # fmt: skip


INSIDE = judged(0.05, 0.02, "conforms")
OUTSIDE = judged(0.3, 0.02, "does not conform")
BETWEEN = judged(0.09, 0.02, "cannot say")
NONE = judged(None, None, "cannot say")


@pytest.mark.parametrize("cells", [10, 30, 60])
def test_a_bar_is_as_wide_as_it_may_be_and_marks_the_tolerance_at_two_thirds(cells: int) -> None:
    for one in (INSIDE, OUTSIDE, BETWEEN, NONE):
        bar = error_bar(one, cells)
        assert len(bar) == cells
        assert bar.index("│") == round(cells / 1.5)


def test_error_and_uncertainty_end_where_they_should() -> None:
    bar = error_bar(INSIDE, 30)  # 0.005 mm a cell
    assert bar.rindex("━") < bar.index("╋") == 9
    assert bar.rindex("─") == 13
    assert set(bar[14:20]) == {" "}
    crosses = error_bar(BETWEEN, 30)
    assert crosses.rindex("─") > crosses.index("│"), "it reaches beyond the tolerance, so nobody can say"
    assert " " not in error_bar(OUTSIDE, 30).replace("│", ""), "drawn to the end"
    assert error_bar(NONE, 30).replace("│", "").strip() == ""


@pytest.mark.parametrize("width", [60, 76, 116, 196])
def test_lines_fit_and_say_mark_and_numbers(width: int) -> None:
    lines = [line.plain for line in verdict_lines((INSIDE, OUTSIDE, BETWEEN, NONE), width)]
    assert [line[0] for line in lines] == ["≤", "✗", "?", "?"]
    assert all(len(line.rstrip()) <= width for line in lines)
    assert "0.050 ± 0.020 / 0.100 mm" in lines[0]
    assert "not measured / 0.100 mm" in lines[3]
