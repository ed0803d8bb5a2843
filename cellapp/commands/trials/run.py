"""The verbs of ``trials``: effects hidden in the user's own simulated cell, by its own plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cellapp.cell.profile import load_profile
from cellapp.commands.record import Request, View, Work
from cellapp.commands.trials.detectability import (
    DetectabilityResult,
    detectability_at,
    detectability_sentence,
    detectability_table,
)
from cellapp.commands.trials.judge import judge_trials
from cellapp.commands.trials.request import JudgeRequest, PowerRequest, SealRequest
from cellapp.commands.trials.scoring import JudgeResult, judge_sentences, judge_tables
from cellapp.commands.trials.sealed import SEAL_FILE, TRUTH_FILE, SealResult, seal_trials
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.view.parts import Parts
from cellapp.ground.counting import counted, first_few
from cellapp.ground.executors import PoolWork, TimeLimit, kept_results

TrialsResult = SealResult | JudgeResult | DetectabilityResult
_MOST_NAMED = 10
"""Most failures that are named one by one."""


def run(request: SealRequest | JudgeRequest | PowerRequest, work: Work) -> TrialsResult:
    """Seal trials, judge them, or find what a plan would have named."""
    if isinstance(request, SealRequest):
        asked = request.model_dump(include={"kind", "laws", "stops", "ranges"})
        setup = Setup(**asked, stated=not request.unstated, plan_method=request.plan)
        cell = load_profile(request.profile)
        return seal_trials(cell, request.out, request.n, setup, seed=request.seed, job=work.control)
    if isinstance(request, JudgeRequest):
        pool = PoolWork(request.jobs, request.scheduler, None, work.control)
        return judge_trials(request.folder, pool, again=request.again)
    kept_results(request.results)  # one that is none is refused before hours of work
    pool = PoolWork(request.jobs, request.scheduler, request.results, work.control)
    return detectability_at(request.where, request.trials, request.seed, pool, TimeLimit.from_now(request.minutes))


def view(result: TrialsResult, request: Request | None = None) -> View:
    """Show what was found; limits that were missed fail, and what could not be computed."""
    if isinstance(result, DetectabilityResult):
        tables = (detectability_table(name, arm) for name, arm in result.arms.items())
        return _computed((*tables, detectability_sentence(result)), result.failed)
    if isinstance(result, JudgeResult):
        shown = _computed((*judge_tables(result), *judge_sentences(result)), result.failed)
        missed = [f"{one.kind}: {one.target}" for one in result.missed]
        return View(shown.parts, missed, "limits missed") if missed and not shown.failed else shown
    folder = Path(result.folder)
    where = f"their truth is in {folder / TRUTH_FILE}: open it with 'trials judge' only"
    return View(
        (
            f"{counted(result.runs, 'run')} in {folder}; {where}",
            f"SHA-256 of the truth, also in {folder / SEAL_FILE}: {result.sha256}",
        )
    )


def _computed(parts: Parts, failed: Sequence[str]) -> View:
    """Return the view of what was computed, with the first tasks that failed."""
    return View(parts, tuple(first_few(failed, "and {} more", _MOST_NAMED)), f"{len(failed)} could not be computed")
