"""Tables of ``trials plans``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.planning.plan_quality import ERROR_NAMES
from cellapp.commands.trials.plan_trial import BARS, PlanTrialsResult
from cellapp.commands.trials.whole_plans import WholePlan
from cellapp.commands.view.table import Column, Table, number_column

_HEADINGS = {"parameters": "parameters, effects", "mean": "mean prediction", "worst": "worst prediction"}


def plan_trial_tables(result: PlanTrialsResult) -> list[Table]:
    """How many random stops one designed stop is worth, by arm; and the whole plans."""
    tables = [_information(result)] if result.trials else []
    whole = (_order(result.profile, result.plans), _safety(result.profile, result.plans)) if result.plans else ()
    return [*tables, *whole]


def _information(result: PlanTrialsResult) -> Table:
    arms = dict.fromkeys(one.arm for one in result.trials)
    first = result.trials[0]
    rows = []
    for arm in arms:
        bound = next((one.bound for one in result.trials if one.arm == arm and one.bound), None)
        for error in ERROR_NAMES:
            ratios = [one.equal[error] / one.stops for one in result.trials if one.arm == arm]
            rows.append(
                (
                    arm,
                    _HEADINGS[error],
                    float(np.median(ratios)),
                    min(ratios),
                    max(ratios),
                    None if bound is None else bound[error] / first.stops,
                    BARS[error],
                )
            )
    seeds = len({one.seed for one in result.trials})
    return Table(
        f"{result.profile}: random stops that one of {first.stops} designed stops is worth, {seeds} seeds",
        (
            Column("arm"),
            Column("error"),
            number_column("median", ".2f"),
            number_column("least", ".2f"),
            number_column("most", ".2f"),
            number_column("best possible", ".2f"),
            number_column("bar", ".1f"),
        ),
        tuple(rows),
    )


def _order(profile: str, plans: Sequence[WholePlan]) -> Table:
    return Table(
        f"{profile}: order and factors of {plans[0].asked} stops",
        (
            number_column("seed", "d"),
            number_column("travel", ".0f", "s"),
            number_column("random order", ".0f", "s"),
            number_column("saved", ".1f", "%"),
            number_column("correlation", ".3f"),
            number_column("random plan", ".3f"),
        ),
        tuple(
            (one.seed, one.travel_s, one.random_order_s, 100.0 * one.saved, one.correlation, one.random_correlation)
            for one in plans
        ),
    )


def _safety(profile: str, plans: Sequence[WholePlan]) -> Table:
    return Table(
        f"{profile}: ways of {plans[0].asked} stops",
        (
            number_column("seed", "d"),
            number_column("reached", "d"),
            number_column("rejected", ".2f", "%"),
            number_column("detours", "d"),
            number_column("motions", "d"),
            number_column("collisions", "d"),
            number_column("planned in", ".1f", "s"),
        ),
        tuple(
            (one.seed, one.reached, 100.0 * one.rejected, one.detours, one.motions, one.collisions, one.seconds)
            for one in plans
        ),
    )


def plan_trial_sentences(result: PlanTrialsResult) -> list[str]:
    """What the tables rest on, in words."""
    return [
        "Errors: mean standard error of geometry parameters and effect coefficients, standard uncertainty of predicted"
        " positions over the workspace, and at its worst point; at configurations that no choice has seen.",
        "Best possible: convex relaxation over all candidates, each error alone. Correlation: the largest of a factor"
        " that can be chosen. Collisions: every motion of the designed plan, finely sampled, in step and one late,"
        " by a collision library that the gate does not use.",
    ]
