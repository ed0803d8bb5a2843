"""Overview of the judgements: each error with its expanded uncertainty against its tolerance, as a bar with a mark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from textual.content import Content
from textual.reactive import reactive
from textual.widget import Widget

from cellapp.estimation.uncertainty.records import Conformity, Judgement
from cellapp.interfaces.tui.marks import SIGNS

_STYLES: Mapping[Conformity, str] = {
    "conforms": "$text-success",
    "does not conform": "bold $text-error",
    "cannot say": "$text-warning",
}
_NUMBERS = 26
"""Columns of "0.049 ± 0.051 / 0.100 mm"."""
_LEAST_BAR, _MOST_BAR = 10, 60
_SCALE = 1.5
"""Length of a bar in tolerances: a larger error is drawn up to the end."""


class VerdictBars(Widget):
    """One line for each judgement: mark, name, bar, numbers. The tolerance is at two thirds of the bar."""

    DEFAULT_CSS = """
    VerdictBars { height: auto; padding: 1 0 0 0; }
    """

    judgements: reactive[tuple[Judgement, ...]] = reactive((), layout=True)

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id)
        self.tooltip = "━ the error, ─ its expanded uncertainty, │ the tolerance"

    def get_content_height(self, container: object, viewport: object, width: int) -> int:
        """Return one line for each judgement."""
        return len(self.judgements)

    def render(self) -> Content:
        """Return the bars."""
        return Content("\n").join(verdict_lines(self.judgements, self.content_size.width))


def verdict_lines(judgements: Sequence[Judgement], width: int) -> list[Content]:
    """Return a line for each judgement, at most ``width`` cells wide."""
    names = [f"{one.characteristic.replace('_', ' ')}, {one.where}" for one in judgements]
    longest = min(max(map(len, names), default=0), max(width - _NUMBERS - _LEAST_BAR - 6, 8))
    cells = max(min(width - longest - _NUMBERS - 6, _MOST_BAR), _LEAST_BAR)
    return [
        Content.assemble(
            (f"{SIGNS[one.conformity]} ", _STYLES[one.conformity]),
            f"{name[:longest]:<{longest}}  ",
            (error_bar(one, cells), _STYLES[one.conformity]),
            f"  {_numbers(one)}",
        )
        for one, name in zip(judgements, names, strict=True)
    ]


def error_bar(one: Judgement, cells: int) -> str:
    """Return ``━`` up to the error, ``─`` as far as its uncertainty extends it, ``│`` at the tolerance."""
    value, more = one.value, one.expanded or 0.0

    def place(amount: float) -> int:
        return min(max(round(amount / (_SCALE * one.tolerance) * cells), 0), cells)

    bar = [" "] * cells
    if value is not None:
        low, high = place(value - more), place(value + more)
        bar[: place(value)] = "━" * place(value)
        bar[low:high] = "─" * (high - low) if more else bar[low:high]
        bar[max(place(value) - 1, 0)] = "╋" if more else "━"
    bar[min(place(one.tolerance), cells - 1)] = "│"
    return "".join(bar)


def _numbers(one: Judgement) -> str:
    limit = f"{one.tolerance:.3f} {one.unit}"
    if one.value is None:
        return f"not measured / {limit}"
    sure = "" if one.expanded is None else f" ± {one.expanded:.3f}"
    return f"{one.value:.3f}{sure} / {limit}"
