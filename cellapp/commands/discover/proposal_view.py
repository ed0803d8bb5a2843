"""Proposed stops in words: which questions they answer, their gain, and how to go on."""

from __future__ import annotations

import math
import textwrap

from cellapp.estimation.discovery.records import Proposal, ProposalQuestion

_WIDTH = 80
_COLUMNS = (("now", 7), ("proposed", 9), ("random", 8), ("gain", 6), ("needed", 7))
_HIDDEN = 0.01
"""If the present discrimination is below this share of the proposed one, the data show nothing of the effect yet."""


def proposal_lines(proposal: Proposal) -> list[str]:
    """State the questions with their discriminations, advice and next steps, in lines for a terminal.

    Each number is a discrimination (non-centrality lambda): now, with the proposed stops, with as many random stops
    of the same candidates; then the gain of proposed over random stops, and the value that a clear answer needs.
    """
    heads = "".join(f"{head:>{width}}" for head, width in _COLUMNS)
    title = f"{proposal.count} proposed stops, discrimination"
    lines = [f"{title:{_WIDTH - len(heads)}}{heads}"]
    for name, questions in proposal.arms.items():
        lines.append(f"Arm {name}")
        for question in questions:
            lines += [*_row(question), f"    {_outcome(question)}"]
    words = [*proposal.advice, *proposal.notes]
    if proposal.written and proposal.first_configuration is not None:
        first = proposal.first_configuration + 1
        words.append(
            f"the plan now has stops {first} to {first + proposal.count - 1} too; measure them with"
            " 'cellapp collect DIR --resume', then calibrate and discover again"
        )
    for sentence in words:
        lines += textwrap.wrap(sentence, _WIDTH, subsequent_indent="  ")
    return lines


def _row(question: ProposalQuestion) -> list[str]:
    lambdas = question.discrimination
    values = (lambdas.now, lambdas.proposed, lambdas.random, question.gain_over_random, question.needed)
    numbers = "".join(f"{_number(value):>{width}}" for value, (_, width) in zip(values, _COLUMNS, strict=True))
    label = f"  {question.effect} / {question.against or 'nothing'}"
    if len(label) + len(numbers) > _WIDTH:
        return [label, f"{numbers:>{_WIDTH}}"]
    return [f"{label:{_WIDTH - len(numbers)}}{numbers}"]


def _outcome(question: ProposalQuestion) -> str:
    now, proposed = question.discrimination.now, question.discrimination.proposed
    if question.against is None:
        if now < _HIDDEN * proposed:
            return "not visible so far; these stops would show it"
        # the visible size scales with the inverse square root of the non-centrality
        share = math.sqrt(now / max(proposed, 1e-12))
        return f"the smallest visible size falls to {100.0 * share:.0f} %"
    if now >= question.needed:
        return "already distinguished; these stops would make it more certain"
    return "these stops would distinguish them" if proposed >= question.needed else "these stops would not suffice"


def _number(value: float) -> str:
    if value >= 9999.5:
        return f"{value:.0e}"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.1f}" if value >= 10.0 else f"{value:.2f}"
