"""Errors against their tolerances in the terms of their norms, and the verdict on all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from cellapp.commands.view.table import Table, table_of
from cellapp.estimation.uncertainty.records import Characteristic, Conformity, Judgement, overall
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped
from cellapp.ground.results import DecisionRule

CHARACTERISTIC_WORDS: Mapping[Characteristic, str] = {
    "position": "Position error",
    "orientation": "Orientation error",
    "distance": "Distance error",
    "cooperative": "Cooperative error",
    "pose_accuracy": "Pose accuracy AP",
    "pose_repeatability": "Pose repeatability RP",
    "multidirectional": "Multi-directional variation vAP",
    "distance_accuracy": "Distance accuracy AD",
    "distance_repeatability": "Distance repeatability RD",
    "drift": "Drift of pose accuracy dAP",
    "path_accuracy": "Path accuracy AT",
    "path_repeatability": "Path repeatability RT",
}
"""Names of the characteristics; those with letters are of ISO 9283."""
RULE_WORDS: Mapping[DecisionRule, str] = {
    "guarded": (
        "An error conforms if it is inside its tolerance by its expanded uncertainty U (k = 2), it does not conform if"
        " it is outside by U, and nobody can say between (ISO 14253-1)."
    ),
    "simple": "Errors alone are compared with their tolerances, without their uncertainty (simple acceptance).",
}


def undecided_words(not_given: Sequence[str]) -> str:
    """Say why the guarded rule decides nothing; empty if all contributions to U are given."""
    if not not_given:
        return ""
    return f"U is not known, so that nothing is proven: not given in traceability or the run: {', '.join(not_given)}."


VERDICT_TITLES: Mapping[Conformity, str] = {
    "conforms": "The cell conforms to its tolerances",
    "does not conform": "The cell does not conform to its tolerances",
    "cannot say": "Cannot say: conformity is not decided",
}
_STATES: tuple[Conformity, ...] = get_args(Conformity)


@dataclass(frozen=True)
class Verdict:
    """The verdict on the cell's tolerances; ``state`` is None if nothing is judged."""

    state: Conformity | None
    title: str
    sentence: str


def verdict_of(judgements: Sequence[Judgement]) -> Verdict:
    """Summarize all judgements in a title and a sentence."""
    state = overall(judgements) or "cannot say"
    if not judgements:
        return Verdict(state, VERDICT_TITLES[state], "Nothing that has a tolerance was measured.")
    return Verdict(state, VERDICT_TITLES[state], judged_sentence(judgements))


def judged_sentence(judgements: Sequence[Judgement]) -> str:
    """State how many errors conform, which do not, and how many are undecided or not measured."""
    total = len(judgements)
    counts = {state: [one for one in judgements if one.conformity == state] for state in _STATES}
    out, unsure = counts["does not conform"], counts["cannot say"]
    missing = [one for one in unsure if one.value is None]
    if len(counts["conforms"]) == total:
        return f"All {counted(total, 'error')} with a tolerance are inside it."
    parts = [f"{len(counts['conforms'])} of {counted(total, 'error')} with a tolerance conform"]
    if out:
        parts.append(f"{f'{len(out)} do' if len(out) > 1 else 'one does'} not: {named_errors(out)}")
    if len(unsure) > len(missing):
        parts.append(f"{len(unsure) - len(missing)} not decided within the uncertainty")
    if missing:
        parts.append(f"{len(missing)} not measured")
    return "; ".join(parts) + "."


def named_errors(judgements: Sequence[Judgement]) -> str:
    """List what is judged and where."""
    places = grouped((one.characteristic, one.where) for one in judgements)
    words = ((CHARACTERISTIC_WORDS[characteristic], where) for characteristic, where in places.items())
    return ", ".join(f"{name[0].lower()}{name[1:]} of {' and '.join(where)}" for name, where in words)


def judgement_table(judgements: Sequence[Judgement]) -> Table:
    """Show every judgement with its uncertainty; up to the verdict it fits into 80 columns, its source follows."""
    turned = any(one.unit == "mrad" for one in judgements)
    return table_of(
        f"Errors against their tolerances [mm{', of orientation mrad' if turned else ''}]",
        judgements,
        ("error", lambda one: CHARACTERISTIC_WORDS[one.characteristic]),
        ("of", "where"),
        ("measured", "value", ".3f"),
        ("U (k = 2)", "expanded", ".3f"),
        ("tolerance", lambda one: round(one.tolerance, 6), "g"),
        ("verdict", "conformity"),
        ("n", lambda one: one.n or None, "d"),
        ("measured by", "source"),
    )
