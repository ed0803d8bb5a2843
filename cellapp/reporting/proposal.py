"""Proposed stops in words: which questions they answer, what they are worth, and how to go on."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from typing import Any

_WIDTH = 80
_COLUMNS = (("now", 7), ("proposed", 9), ("random", 8), ("gain", 6), ("needed", 7))


def proposal_lines(proposal: Mapping[str, Any]) -> list[str]:
    """What the stops shall tell and what they are worth, in lines of a terminal; from ``proposal`` of the JSON.

    The numbers are discriminations (lambda): now, with the proposed stops, with as many random ones of the same
    candidates; the gain of the former over the latter; and from where on the answer is clear.
    """
    heads = "".join(f"{head:>{width}}" for head, width in _COLUMNS)
    title = f"{proposal['count']} proposed stops, discrimination"
    lines = [f"{title:{_WIDTH - len(heads)}}{heads}"]
    for name, questions in proposal["arms"].items():
        lines.append(f"Arm {name}")
        for question in questions:
            lines += [*_row(question), f"    {_outcome(question)}"]
    words = [*proposal["advice"], *proposal["notes"]]
    if proposal["written"]:
        first = proposal["first_configuration"] + 1
        words.append(
            f"the plan now has stops {first} to {first + proposal['count'] - 1} too; measure them with"
            " 'cellapp collect DIR --resume', then calibrate and discover again"
        )
    for sentence in words:
        lines += textwrap.wrap(sentence, _WIDTH, subsequent_indent="  ")
    return lines


def _row(question: Mapping[str, Any]) -> list[str]:
    told = question["discrimination"]
    values = (told["now"], told["proposed"], told["random"], question["gain_over_random"], question["needed"])
    numbers = "".join(f"{_number(value):>{width}}" for value, (_, width) in zip(values, _COLUMNS, strict=True))
    label = f"  {question['effect']} / {question['against'] or 'nothing'}"
    if len(label) + len(numbers) > _WIDTH:
        return [label, f"{numbers:>{_WIDTH}}"]
    return [f"{label:{_WIDTH - len(numbers)}}{numbers}"]


def _outcome(question: Mapping[str, Any]) -> str:
    told, needed = question["discrimination"], question["needed"]
    if question["against"] is None:
        if told["now"] < 0.01 * told["proposed"]:
            return "hidden until now; these stops would show it"
        share = math.sqrt(told["now"] / max(told["proposed"], 1e-12))
        return f"the smallest size that would be seen falls to {100.0 * share:.0f} %"
    if told["now"] >= needed:
        return "told apart already; these stops would make it surer"
    return "these stops would tell" if told["proposed"] >= needed else "not even these stops would tell"


def _number(value: float) -> str:
    if value >= 9999.5:
        return f"{value:.0e}"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"
