"""Measurements through an emulated tracker bridge over TCP, a random fault in each group of them: none may be lost,
delivered twice or mixed up."""

from __future__ import annotations

import argparse
from typing import Any

from cellapp.cell.profile import load_profile
from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Limit
from tests.evidence.wire.bridge import BridgeResult, bridge_trial

TITLE = "Tracker bridge"
ALONE = True


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--measurements", type=int, default=1000)
    parser.add_argument("--every", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    return {"bridge": {key: getattr(asked, key) for key in ("measurements", "every", "seed")}}


def one(case: dict[str, Any]) -> dict[str, Any]:
    return {"result": bridge_trial(load_profile(TWIN), case["measurements"], case["every"], case["seed"]).to_json()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    result = BridgeResult.from_json(results[0]["result"], "bridge")
    wrong = {"lost": result.lost, "doubled": result.doubled, "of another nest": result.strange}
    said = "" if result.undisturbed_s is None else f"Median without a fault: {1e3 * result.undisturbed_s:.0f} ms; "
    longest = max(result.recovery_s.values(), default=0.0)
    return Evidence(
        {"delivered": f"{result.delivered} of {result.asked}"},
        (),
        [Limit(what, count, 0) for what, count in wrong.items()],
        [
            f"{result.delivered} of {result.asked} measurements delivered, beside {len(result.faults)} kinds of faults."
            f" {said}longest time of a measurement: {longest:.2f} s."
        ],
    )
