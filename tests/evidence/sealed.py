"""Simulated cells hide effects by physics of their own (statics solved to equilibrium, segmented beams, eccentric
gears), which shares no code with the models; sizes are drawn, masses are 5 % off, laws are of another shape than the
library's. Only the judge opens the sealed truth, after calibration and search. *Outside*: laws that the library lacks;
*narrow*: joints move over 10 to 50 degrees; *unstated*: readings state no uncertainty; *few*: 15 to 60 readings to
learn from; *hard*: what once got a false additional name. False names are counted in arms that hide nothing; exact and
second names in runs whose effects are all above the noise."""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.judge import judge_trials
from cellapp.commands.trials.scoring import ACCEPTED, JudgeResult, ScoredRun, posterior_scores
from cellapp.commands.trials.sealed import seal_trials
from cellapp.commands.trials.sealed_setup import HARD, MIXED, NONE, ONE, OUT, PAIR, Setup
from cellapp.ground.executors import PoolWork
from cellapp.ground.grouping import grouped
from tests.evidence.shared.cells import TWIN
from tests.evidence.skeleton import Evidence, Limit, Share, Table

TITLE = "Sealed effects"
BLOCK = 5
"""Runs that are sealed together, with one plan, and judged in one process."""
FEW_STOPS = (25, 40, 60, 80)
"""Stops of the blocks of *few* in turn: 15, 30, 45 and 60 of them are for learning."""
SETS = {
    "clean": Setup(kind=NONE),
    "single": Setup(kind=ONE, laws="other"),
    "pair": Setup(kind=PAIR, laws="other"),
    "outside": Setup(kind=OUT),
    "narrow": Setup(kind=MIXED, laws="other", ranges="narrow"),
    "unstated": Setup(kind=MIXED, laws="other", stated=False),
    "few": Setup(kind=MIXED, laws="other"),
    "hard": Setup(kind=HARD, laws="other"),
}
MOST_FALSE, MOST_SECOND, MOST_BRIER = 0.01, 0.02, 0.05
OPTIONS = {"runs": "clean=25,single=50,pair=50,outside=50,narrow=25,unstated=25", "seed": 20261203}


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    found = {}
    for name, runs in (part.split("=") for part in asked.runs.split(",")):
        for number in range(-(-int(runs) // BLOCK)):
            seed = int(np.random.default_rng([asked.seed, [*SETS].index(name), number]).integers(2**31))
            size = min(BLOCK, int(runs) - number * BLOCK)
            few = FEW_STOPS[number % len(FEW_STOPS)] if name == "few" else None
            found[f"{name}, block {number + 1}"] = {"set": name, "draw": seed, "runs": size, "stops": few}
    return found


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Seal one block, judge it, and return the judge's result."""
    setup = SETS[case["set"]]
    if case["stops"] is not None:
        setup = setup.model_copy(update={"stops": case["stops"]})
    with TemporaryDirectory() as folder:
        seal_trials(load_profile(TWIN), Path(folder) / "block", case["runs"], setup, seed=case["draw"])
        result = judge_trials(Path(folder) / "block", PoolWork())
    if result.failed:
        raise ValueError("; ".join(result.failed))
    return {"set": case["set"], "judged": result.to_json()}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    judged = ((its["set"], JudgeResult.from_json(its["judged"], its["set"])) for its in results)
    runs = {name: [run for one in some for run in one.trials] for name, some in grouped(judged).items()}
    every = [run for some in runs.values() for run in some]
    rows = [_row(f"{name}, {len(some)} runs", some) for name, some in {**runs, "total": every}.items()]
    columns = ["set", "false names", "exact names", "second names", "outside, not named", "accepted names"]
    false, _, second, _ = _shares(every)
    scores = {score.about: score for score in posterior_scores(every)}
    limits = [
        Limit("false names", false.hits / max(false.n, 1), MOST_FALSE),
        Limit("second names", second.hits / max(second.n, 1), MOST_SECOND),
    ]
    if ACCEPTED in scores:
        limits.append(Limit("Brier score of accepted names", scores[ACCEPTED].brier, MOST_BRIER))
    return Evidence(tables=[Table("", [*columns, "Brier score"], rows)], limits=limits)


def _shares(runs: list[ScoredRun]) -> tuple[Share, Share, Share, Share]:
    """False names, exact names, second names, and laws outside the library without a name."""
    empty = [bool(found.names) for run in runs for arm, found in run.arms.items() if arm != run.arm]
    known = [run for run in runs if run.hidden and run.expected is None and run.visible]
    outside = [not run.findings.names for run in runs if run.expected is not None and run.visible]
    exact, second = [run.outcome == "named" for run in known], [bool(run.second_names) for run in known]
    false, named, twice, without = (Share(sum(facts), len(facts)) for facts in (empty, exact, second, outside))
    return false, named, twice, without


def _row(name: str, runs: list[ScoredRun]) -> list[str]:
    accepted = next((score for score in posterior_scores(runs) if score.about == ACCEPTED), None)
    brier = ["0", ""] if accepted is None else [str(accepted.n), f"{accepted.brier:.3f}"]
    return [name, *map(str, _shares(runs)), *brier]
