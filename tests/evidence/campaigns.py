"""The whole engine with real run file, gate and profile, on doubles of arms, tracker, air, disk, clock and person, with
faults of all kinds at seeded moments, on simulated time. Nothing may be lost, doubled or false; no motion may begin
after a stop or beside a doubt; no arms may collide. A failure names the seed that repeats it."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict
from functools import cache
from typing import Any

import numpy as np

from cellapp.cell.profile import load_profile
from tests.evidence.campaigning.campaign import Bench, make_bench, run_campaign
from tests.evidence.campaigning.faults import KINDS
from tests.evidence.campaigning.monitor import KINDS_OF_FAILURE
from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Limit

TITLE = "Campaigns"
OPTIONS = {"n": 400, "seed": 1000, "stops": 400}
"""``seed``: of the first."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    seeds = range(asked.seed, asked.seed + asked.n)
    return {f"seed {seed}": {"seed": seed, "stops": asked.stops} for seed in seeds}


@cache
def bench(stops: int) -> Bench:
    """The cell and its undisturbed campaign, made once a process."""
    return make_bench(load_profile(TWIN), stops)


def one(case: dict[str, Any]) -> dict[str, Any]:
    return asdict(run_campaign(bench(case["stops"]), case["seed"])[0])


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    wrong = Counter(failure["kind"] for its in results for failure in its["failures"])
    struck = Counter[str]()
    for its in results:
        struck.update(its["struck"])
    readings, faults = sum(its["readings"] for its in results), struck.total()
    hours = sum(its["simulated_s"] for its in results) / 3600.0
    said = [
        f"{len(results)} campaigns, {faults} faults of {len(struck)} of {len(KINDS)} kinds, {readings} readings;"
        f" {sum(its['missing'] for its in results)} planned readings are missing with a reason; {hours:.0f} h of"
        f" simulated time, {np.mean([its['seconds'] for its in results]):.1f} s of one core for each campaign."
    ]
    said += [f"Seed {its['seed']}: {its['failures'][:3]}" for its in results if its["failures"]]
    return Evidence(
        {"faults": str(faults), "wrong": str(wrong.total())},
        (),
        [Limit(kind, wrong[kind], 0) for kind in KINDS_OF_FAILURE],
        said,
    )
