"""Tables of ``trials plans``."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from cellapp.cell.planning.design_records import ErrorName
from cellapp.cell.planning.plan_quality import ERROR_NAMES
from cellapp.commands.trials.plan_trial import BARS, PlanTrialsResult
from cellapp.commands.trials.whole_plans import WholePlan
from cellapp.commands.view.table import Table, table_of
from cellapp.ground.counting import counted

_HEADINGS = {"parameters": "parameters, effects", "mean": "mean prediction", "worst": "worst prediction"}


def plan_trial_tables(result: PlanTrialsResult) -> list[Table]:
    """Show how many random stops one designed stop is worth, by arm; and the whole plans."""
    tables = [_information(result)] if result.trials else []
    whole = (_order(result.profile, result.plans), _safety(result.profile, result.plans)) if result.plans else ()
    return [*tables, *whole]


def _information(result: PlanTrialsResult) -> Table:
    first, seeds = result.trials[0], len({one.seed for one in result.trials})
    arms = dict.fromkeys(one.arm for one in result.trials)
    return table_of(
        f"{result.profile}: random stops that one of {first.stops} designed stops is worth, {counted(seeds, 'seed')}",
        [_worth(result, arm, error) for arm in arms for error in ERROR_NAMES],
        ("arm", itemgetter(0)),
        ("error", lambda row: _HEADINGS[row[1]]),
        ("median", lambda row: float(np.median(row[2])), ".2f"),
        ("least", lambda row: min(row[2]), ".2f"),
        ("most", lambda row: max(row[2]), ".2f"),
        ("best possible", itemgetter(3), ".2f"),
        ("bar", lambda row: BARS[row[1]], ".1f"),
    )


def _worth(result: PlanTrialsResult, arm: str, error: ErrorName) -> tuple[str, ErrorName, list[float], float | None]:
    """Return how many random stops one designed stop of an arm is worth, with each seed and at best."""
    its = [one for one in result.trials if one.arm == arm]
    best = next((one.bound[error] / result.trials[0].stops for one in its if one.bound), None)
    return arm, error, [one.equal[error] / one.stops for one in its], best


def _order(profile: str, plans: Sequence[WholePlan]) -> Table:
    return table_of(
        f"{profile}: order and factors of {counted(plans[0].asked, 'stop')}",
        plans,
        ("seed", "seed", "d"),
        ("travel", "travel_s", ".0f", "s"),
        ("random order", "random_order_s", ".0f", "s"),
        ("saved", "saved", ".1f", "%"),
        ("correlation", "correlation", ".3f"),
        ("random plan", "random_correlation", ".3f"),
    )


def _safety(profile: str, plans: Sequence[WholePlan]) -> Table:
    return table_of(
        f"{profile}: ways of {counted(plans[0].asked, 'stop')}",
        plans,
        ("seed", "seed", "d"),
        ("reached", "reached", "d"),
        ("rejected", "rejected", ".2f", "%"),
        ("detours", "detours", "d"),
        ("motions", "motions", "d"),
        ("collisions", "collisions", "d"),
        ("planned in", "seconds", ".1f", "s"),
    )


def plan_trial_sentences(result: PlanTrialsResult) -> list[str]:
    """State the assumptions of the tables."""
    return [
        "Errors: mean standard error of geometry parameters and effect coefficients, standard uncertainty of predicted"
        " positions over the workspace, and at its worst point; at configurations that no choice has seen.",
        "Best possible: convex relaxation over all candidates, each error alone. Correlation: the largest of a factor"
        " that can be chosen. Collisions: every motion of the designed plan, finely sampled, in step and one late,"
        " by a collision library that the gate does not use.",
    ]
