"""Conversion of a discovery to the result of ``discover``."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.cell.planning.planned_stops import StopConditions
from cellapp.cell.planning.proposal.propose import PredictedDiscrimination, ProposedStop
from cellapp.cell.planning.proposal.propose import Proposal as ProposedStops
from cellapp.commands.calibrate.result import pair_result
from cellapp.estimation.discovery.outcome import CellDiscovery
from cellapp.estimation.discovery.records import (
    DiscoverResult,
    Discrimination,
    Proposal,
    ProposalQuestion,
)
from cellapp.estimation.discovery.records import ProposedStop as ProposedStopRow
from cellapp.ground.grouping import grouped
from cellapp.robot.effects import EFFECTS


def discover_result(found: CellDiscovery) -> DiscoverResult:
    """Build the object that ``discover --json`` writes and the run file stores."""
    return DiscoverResult(
        arms={name: discovery.result for name, discovery in found.arms.items()},
        pair={} if found.pair is None else {"effects": pair_result(found.pair)["effects"]},
        notes=tuple(f"not searched for: {one.refusal}" for one in EFFECTS.plugins if one.problem) or None,
    )


def proposal_result(proposed: ProposedStops, first: int | None, notes: Sequence[str]) -> Proposal:
    """Build the proposed stops; ``first`` is the number of the first one in the run's plan, None if not in the plan."""
    arms = grouped((prediction.arm, _question(prediction)) for prediction in proposed.predictions)
    return Proposal(
        count=len(proposed.stops),
        written=first is not None,
        first_configuration=first,
        arms={name: tuple(questions) for name, questions in arms.items()},
        stops=tuple(
            row for number, stop in enumerate(proposed.stops, start=first or 0) for row in _stop_rows(number, stop)
        ),
        notes=tuple(notes),
        advice=proposed.advice,
    )


def _question(predicted: PredictedDiscrimination) -> ProposalQuestion:
    return ProposalQuestion.like(
        predicted, against=predicted.against or None, discrimination=Discrimination.like(predicted)
    )


def _stop_rows(number: int, stop: ProposedStop) -> list[ProposedStopRow]:
    rows = []
    for name, q in stop.q.items():
        conditions = stop.conditions.get(name, StopConditions())
        via = None if conditions.via is None else tuple(conditions.via.tolist())
        dwell_s = conditions.dwell_s if conditions.dwell_s > 0.0 else None
        rows.append(ProposedStopRow(configuration=number, arm=name, q=tuple(q.tolist()), via=via, dwell_s=dwell_s))
    return rows
