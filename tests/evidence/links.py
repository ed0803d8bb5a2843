"""Two emulated UR controllers that brake like real ones, under the real client, both arms moving at once; one in some
motions meets a random fault, then is repaired as an operator would. Measured at the controllers, from the first doubt
about the cell: the stop received by the other arm, and its rest, less its ideal braking time. No real arm was
braked."""

from __future__ import annotations

import argparse
from typing import Any

from tests.evidence.skeleton import Evidence, Limit, Table
from tests.evidence.wire.link_results import LinksResult, Times
from tests.evidence.wire.links import link_trials

TITLE = "Faults on the wire"
ALONE = True


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--moves", type=int, default=328, help="motions in all, of two arms at once")
    parser.add_argument("--every", type=int, default=8, help="motions to each fault")
    parser.add_argument("--seed", type=int, default=7)


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"moves": {"moves": asked.moves, "every": asked.every, "seed": asked.seed}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    return {"result": link_trials(case["moves"], case["every"], case["seed"]).to_json()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = LinksResult.from_json(results[0]["result"], "links")
    rows = [
        [fault, *map(_ms, (its.detected_s, its.commanded_s, its.beyond_braking_s, its.at_rest_s, its.recovered_s))]
        for fault, its in result.by_fault.items()
    ]
    commanded = max(its.commanded_s.max for its in result.by_fault.values() if its.commanded_s is not None)
    beyond = max(its.beyond_braking_s.max for its in result.by_fault.values() if its.beyond_braking_s is not None)
    columns = ["fault", "first doubt", "other arm: stop received after it", "other arm: rest beyond its braking time"]
    quiet = {"connect": result.connect_s, "state": result.state_s, "motion overhead": result.move_overhead_s}
    said = [
        f"{result.moves} moves, {result.faults} faults, {result.host_stalls} motions in which this computer stalled."
    ]
    said += [f"{what}: median {_ms(its, worst=False)}, longest {_ms(its)}." for what, its in quiet.items()]
    return Evidence(
        {"faults": str(result.faults), "stop": f"{1e3 * commanded:.0f} ms"},
        [Table("Longest times after a fault", [*columns, "faulty arm at rest", "ready again"], rows)],
        [
            Limit("stop received after the first doubt [s]", commanded, result.commanded_within_s),
            Limit("rest beyond braking [s]", beyond, result.rest_beyond_braking_s),
            Limit("complaints", len(result.complaints), 0),
        ],
        [*said, *result.complaints],
    )


def _ms(times: Times | None, *, worst: bool = True) -> str:
    return "-" if times is None else f"{1e3 * (times.max if worst else times.median):.0f} ms"
