"""``trials benchmark``: methods on sealed problems. The truth is opened only after a method has answered."""

from __future__ import annotations

import hashlib
import importlib.util
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of
from cellapp.commands.trials.benchmark.methods.answer import answer_of
from cellapp.commands.trials.benchmark.methods.registry import METHODS, NEEDED
from cellapp.commands.trials.benchmark.problem import Problem
from cellapp.commands.trials.benchmark.real import REAL_ANSWERS, RealQuestion
from cellapp.commands.trials.benchmark.scoring import ScoredAnswer, SetScore, by_set, scored, set_score
from cellapp.commands.trials.league.series import Rows, SeriesTexts
from cellapp.commands.trials.sealed import TRUTH_FILE, check_readings, check_seal, open_truth, seal_trials
from cellapp.commands.trials.sealed_cases import MIXED, MOTION, ONE, OUT, PAIR
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.trials.skeleton import IN_PLACE, Work, not_computed
from cellapp.commands.trials.visible_size import registered_model
from cellapp.commands.view.table import Table, table_of
from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.task import TaskKind, as_given
from cellapp.ground.version import __version__
from cellapp.robot.kinematics.transforms import Array

KINDS = (ONE, PAIR, OUT)
"""Sets of sealed runs. One arm of each run has no effects: these arms form the set ``clean``."""
ALL = "all"


class MethodScore(Record):
    """Scores of one method by set and in total."""

    sets: Mapping[str, SetScore]
    total: SetScore


class BenchmarkResult(Result, schema="cellapp-trials-benchmark"):
    """``trials benchmark``: the scores of the first method, those of further ones beside it, and every answer.

    ``failed`` names problems that a method could not answer, and why.
    """

    date: str
    program: str
    folder: str
    method: str
    sets: Mapping[str, SetScore]
    total: SetScore
    compared: Mapping[str, MethodScore] = {}
    answers: tuple[ScoredAnswer, ...]
    failed: tuple[str, ...] = ()


class _Shared(Record):
    """SHA-256 of the truth of each set: a store has no answers to problems that were made anew in the same folder."""

    truths: tuple[str, ...]


class _Question(Record):
    """One arm of one sealed run for one method; ``folder`` is that of all sets, ``kind`` the set in it."""

    method: str
    folder: str
    kind: str
    run: str
    arm: str


def _answered(shared: _Shared, asked: _Question) -> ScoredAnswer:
    """Let the method answer, then open the truth."""
    folder = Path(asked.folder) / asked.kind
    problem, measured = sealed_problem(folder, asked.run, asked.arm)
    answer, seconds = answer_of(asked.method, problem)
    truth = next(one for one in open_truth(folder).trials if one.run == asked.run)
    cell = "" if asked.kind in (*KINDS, MOTION) else asked.kind
    return scored(asked.method, problem.name, asked.arm, truth, answer, measured, seconds, cell)


ANSWERS = TaskKind(
    "cellapp.commands.trials.benchmark.trial:ANSWERS", _Shared, _Question, ScoredAnswer, as_given, _answered
)


@dataclass(frozen=True)
class RealProblems:
    """Real series as problems: their texts, numbers of rows to learn from, and how many draws."""

    texts: SeriesTexts
    rows: Rows = 300
    draws: int = 2


def benchmark_trials(
    profile: Profile,
    folder: Path,
    methods: Sequence[str],
    n: int,
    seed: int | None,
    work: Work = IN_PLACE,
    *,
    cells: Sequence[Profile] = (),
    real: RealProblems | None = None,
    sweeps: int | None = None,
) -> BenchmarkResult:
    """Let each method answer every problem of a folder; missing problems are made first.

    Parameters
    ----------
    folder : Path
        Sealed problems, a folder for each of ``KINDS``; those of an earlier benchmark are reused.
    methods : sequence of str
        Names of ``METHODS``; ``all`` stands for all of them.
    n : int
        Runs of each kind to make, two arms each, by laws of other shapes than the library's.
    seed : int or None
        Draws the problems; None draws a secret seed.
    cells : sequence of Profile
        Further simulated cells, as of another make or with orientations: each a set of mixed runs with the cell's name.
    real : RealProblems, optional
    sweeps : int, optional
        Stops at which a sweep of each arm is recorded: the set ``motion``, whose held-out stops are at rest.

    Raises
    ------
    InputError
        For an unknown method, a folder that holds something else, or a missing run.
    CheckFailed
        If a seal is broken, or the readings of a run are not those that were sealed.
    Cancelled
        On request.
    """
    names, sets, truths = _known(methods), _sets(profile, cells, sweeps), list[str]()
    for place, (kind, (cell, setup)) in enumerate(sets.items()):
        own = folder / kind
        if not (own / TRUTH_FILE).is_file():
            drawn = None if seed is None else seed + place
            seal_trials(cell, own, n, setup, seed=drawn, listener=work.listener, cancel=work.cancel)
        truths.append(hashlib.sha256(check_seal(own)).hexdigest())
    asked = [
        _Question(method=method, folder=str(folder), kind=kind, run=run.name, arm=arm)
        for method in names
        for kind, (cell, _) in sets.items()
        for run in sorted((folder / kind).glob("run-*"))
        for arm in cell.arms
    ]
    shared, name = _Shared(truths=tuple(truths)), "{0.method}, {0.kind}/{0.run}, arm {0.arm}"
    gathered = work.gather(ANSWERS, "benchmark", shared, asked, name)
    for kind in sets:
        for truth in open_truth(folder / kind).trials:
            check_readings(folder / kind, truth)
    answers, failed = [*gathered.found], [*gathered.failed]
    if real is not None:
        drawn_rows = [
            RealQuestion(method=method, series=series, rows=real.rows, seed=draw)
            for method in names
            for series in real.texts.series
            for draw in range(real.draws)
        ]
        of_real = work.gather(REAL_ANSWERS, "real series", real.texts, drawn_rows, "{0.method}, {0.series}, {0.seed}")
        answers += of_real.found
        failed += of_real.failed
    return _result(folder, names, answers, failed)


def benchmark_table(result: BenchmarkResult) -> Table:
    """Build a table with a row for each method and set."""
    everything = {result.method: MethodScore(sets=result.sets, total=result.total), **result.compared}
    rows = [
        (method, name, score)
        for method, its in everything.items()
        for name, score in {**its.sets, "total": its.total}.items()
    ]
    return table_of(
        "Name the missing effect",
        rows,
        ("method", lambda row: row[0]),
        ("set", lambda row: row[1]),
        ("arms", lambda row: row[2].n, "d"),
        ("answered", lambda row: row[2].answered, "d"),
        ("exact names", lambda row: row[2].exact, ".0f", "%"),
        ("with a false name", lambda row: row[2].false_arms, ".0f", "%"),
        ("Brier score", lambda row: row[2].brier, ".3f"),
        ("held-out error / noise", lambda row: row[2].heldout_ratio, ".2f"),
        ("held-out mean", lambda row: row[2].heldout_mm, ".3f", "mm"),
        ("processor time", lambda row: row[2].seconds, ".1f", "s"),
    )


def sealed_problem(folder: Path, run: str, arm: str) -> tuple[Problem, Array]:
    """Return an arm of a sealed run as a problem, and its held-out points (m, 3) [m]."""
    with RunFile.open(folder / run) as file:
        profile, readings = file.profile, {name: file.readings(name) for name in file.profile.arms}
        recordings = read_recordings_of(file, arm)
    models = {name: registered_model(profile, name, own.q, own.p_M) for name, own in readings.items()}
    own = readings[arm]
    conditions = conditions_of_arms(models, readings)[arm]
    name = f"{folder.name}/{run}/{arm}"
    problem, measured = Problem.of(name, profile, arm, own, conditions), own.p_M[own.in_split("validate")]
    return (problem.with_motion(recordings) if recordings else problem), measured


def refused(result: BenchmarkResult) -> str:
    """State what could not be answered; empty if all was."""
    said = not_computed(result.failed)
    return f"trials benchmark: {said}" if said else ""


# -- inside -----------------------------------------------------------------------------------------------------------


def _sets(profile: Profile, cells: Sequence[Profile], sweeps: int | None) -> dict[str, tuple[Profile, Setup]]:
    """Return set -> its cell and conditions. Raises ``InputError`` if two cells have the same name."""
    sets = {kind: (profile, Setup(kind=kind, laws="same" if kind == OUT else "other")) for kind in KINDS}
    if sweeps is not None:
        sets[MOTION] = profile, Setup(kind=MOTION, laws="other", sweeps=sweeps)
    for cell in cells:
        if cell.name in sets or not re.fullmatch(r"[\w.-]+", cell.name):
            raise InputError(f"--cells: a set cannot be called '{cell.name}', as this profile is; give it another name")
        sets[cell.name] = cell, Setup(kind=MIXED, laws="other")
    return sets


def _known(methods: Sequence[str]) -> list[str]:
    """Return the requested methods. Raises ``InputError`` for one that does not exist or cannot run here."""
    names = [name for one in methods for name in (METHODS if one == ALL else (one,))]
    for name in names:
        if name not in METHODS:
            why = METHODS.refusal(name) or f"methods are {', '.join(METHODS)}, and {ALL}"
            raise InputError(f"--method: '{name}' is not known; {why}")
        package = NEEDED.get(name)
        if package is not None and importlib.util.find_spec(package) is None:
            raise InputError(f"method '{name}' needs {package}: pip install 'cellapp[benchmark]', or leave it out")
    return list(dict.fromkeys(names))


def _result(
    folder: Path, names: Sequence[str], answers: Sequence[ScoredAnswer], failed: Sequence[str]
) -> BenchmarkResult:
    scores = {}
    for name in names:
        own = [one for one in answers if one.method == name]
        if own:
            scores[name] = MethodScore(sets=by_set(own), total=set_score(own))
    (first, score), *others = scores.items()
    return BenchmarkResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        folder=str(folder),
        method=first,
        sets=score.sets,
        total=score.total,
        compared=dict(others),
        answers=tuple(answers),
        failed=tuple(failed),
    )
