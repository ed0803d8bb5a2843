"""A person at a real pseudo terminal, in front of an emulated cell whose arms all move: from the act, a key or a fault,
to the stop command at the last controller. Presses are spread over screens, a text field, the palette, a question and
the handbook. Emulated controllers and the thread that presses run before all other programs."""

from __future__ import annotations

import argparse
from typing import Any

from tests.evidence.skeleton import ROOT, Evidence, Limit, Table
from tests.evidence.wire.person import person_trial
from tests.evidence.wire.person_results import PersonResult, PersonRow

TITLE = "From a key to the brakes"
ALONE = True


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--presses", type=int, default=50, help="of each key")
    parser.add_argument("--repeats", type=int, default=10, help="of everything else")
    parser.add_argument("--busy", type=int, default=0, help="processes that compute beside it")


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"person": {"presses": asked.presses, "repeats": asked.repeats, "busy": asked.busy}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    profile = ROOT / "profiles" / "twin-rtde.yaml"
    return {"result": person_trial(profile, case["presses"], case["repeats"], case["busy"]).to_json()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = PersonResult.from_json(results[0]["result"], "person")
    rows = [
        [row.what, str(row.n), _value(row, row.median), _value(row, row.worst), f"{row.worst_bar:g} {row.unit}".strip()]
        for row in result.rows
    ]
    pressed = result.rows[:5]
    worst = max((row.worst or float("inf") for row in pressed), default=float("inf"))
    presses = sum(row.n for row in pressed)
    return Evidence(
        {"worst": f"{worst:.0f} ms", "presses": str(presses)},
        [Table(f"Beside {result.busy} busy processes", ["from the act", "n", "median", "worst", "limit"], rows)],
        [Limit("rows that missed their limit, or were not measured", len(result.missed()), 0)],
        result.not_measured,
    )


def _value(row: PersonRow, value: float | None) -> str:
    return "never" if value is None else f"{value:.0f} {row.unit}".strip()
