"""Sealed trials under many conditions: each cell of a matrix of conditions and kinds is sealed and judged in turn.

A matrix is a folder with one folder of sealed trials for each cell, so that it can be resumed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from cellapp.commands.trials.judge import judge_trials
from cellapp.commands.trials.judge_records import JudgeResult, PosteriorScore, ScoredRun, Spread, TargetScore
from cellapp.commands.trials.scoring import scores
from cellapp.commands.trials.sealed import TRUTH_FILE, seal_trials
from cellapp.commands.trials.sealed_cases import FLIP, KINDS, ONE
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Progress
from cellapp.ground.results import Record, Result

CONDITIONS: Mapping[str, Setup] = {
    "same": Setup(),
    "other": Setup(laws="other"),
    "unstated": Setup(laws="other", stated=False),
    "stops-150": Setup(laws="other", stops=150),
    "stops-60": Setup(laws="other", stops=60),
    "stops-60-unstated": Setup(laws="other", stops=60, stated=False),
    "narrow": Setup(laws="other", ranges="narrow"),
    "narrow-150-unstated": Setup(laws="other", ranges="narrow", stops=150, stated=False),
    "masses-10": Setup(laws="other", mass_error=0.1),
}
"""Conditions by name. ``same`` has laws of the library's shape; each from ``other`` on changes one or two things."""


@dataclass(frozen=True)
class MatrixCell:
    """One cell: its name, and the conditions and kind of its trials."""

    name: str
    setup: Setup


class CellScore(Record):
    """One cell of the matrix: its name, number of runs, targets, seconds for one arm, and runs that failed."""

    name: str
    runs: int
    targets: tuple[TargetScore, ...]
    seconds_an_arm: Spread | None
    failed: tuple[str, ...]


class MatrixResult(Result, schema="cellapp-trials-blind-matrix"):
    """``trials blind-matrix``: targets, posteriors and seconds over all cells together, and every cell."""

    date: str
    program: str
    source: str
    targets: tuple[TargetScore, ...]
    posteriors: tuple[PosteriorScore, ...]
    seconds_an_arm: Spread | None
    cells: tuple[CellScore, ...]

    @property
    def missed(self) -> tuple[TargetScore, ...]:
        """Bars that were missed over all cells in enough trials to say so."""
        return tuple(target for target in self.targets if target.missed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Runs that could not be judged."""
        return tuple(f"{cell.name}/{failure}" for cell in self.cells for failure in cell.failed)


def matrix_cells(pattern: str = "*") -> tuple[MatrixCell, ...]:
    """Return the cells whose name (``conditions.kind``) matches a shell pattern. Raises ``InputError`` if none does."""
    every = [
        MatrixCell(f"{name}.{kind}", setup.model_copy(update={"kind": kind}))
        for name, setup in CONDITIONS.items()
        for kind in KINDS
    ]
    every.append(MatrixCell(f"approach.{FLIP}", Setup(kind=ONE, flip_approach=True)))
    chosen = tuple(cell for cell in every if fnmatch(cell.name, pattern))
    if not chosen:
        raise InputError(f"--only: no cell is called '{pattern}'; cells are {', '.join(cell.name for cell in every)}")
    return chosen


def blind_matrix(
    profile: Profile,
    folder: Path,
    n: int,
    cells: Sequence[MatrixCell],
    work: Work = IN_PLACE,
    *,
    seed: int | None = None,
) -> MatrixResult:
    """Seal ``n`` runs in each cell without any, judge all runs not judged yet, and score them together.

    Without ``seed`` each cell draws its own; only its truth file states it.

    Raises
    ------
    InputError
        If the profile cannot be sealed, or a cell was sealed with another number of runs.
    CheckFailed
        If a seal is broken.
    Cancelled
        On request; what was judged so far is kept.
    """
    results: dict[str, JudgeResult] = {}
    for place, cell in enumerate(cells):
        work.cancel.check()
        work.listener(Progress("matrix", place, len(cells), cell.name))
        here = folder / cell.name
        _seal(profile, here, n, cell.setup, None if seed is None else seed + place, work.cancel)
        results[cell.name] = judge_trials(here, Work(work.resources, cancel=work.cancel))
        sealed = results[cell.name].sealed  # only the opened truth states its conditions
        if (sealed.profile, sealed.setup) != (profile.name, cell.setup):
            raise InputError(f"{here} was sealed from another profile or under other conditions; give another --out")
    work.listener(Progress("matrix", len(cells), len(cells), "done"))
    return _together(results)


def _seal(profile: Profile, folder: Path, n: int, setup: Setup, seed: int | None, cancel: CancelToken) -> None:
    """Seal the runs of a cell, unless it has them."""
    if not (folder / TRUTH_FILE).is_file():
        seal_trials(profile, folder, n, setup, seed=seed, cancel=cancel)
        return
    found = sum(path.is_dir() for path in folder.glob("run-*"))
    if found != n:
        raise InputError(f"{folder} holds {found} sealed runs, not {n}; give --n {found} or another --out")


def _together(results: Mapping[str, JudgeResult]) -> MatrixResult:
    """Return the scores over all cells and of each cell."""
    runs: list[ScoredRun] = [run for result in results.values() for run in result.trials]
    whole = scores(runs)
    last = list(results.values())[-1]
    return MatrixResult(
        date=last.date,
        program=last.program,
        source=last.source,
        targets=whole.targets,
        posteriors=whole.posteriors,
        seconds_an_arm=whole.seconds_an_arm,
        cells=tuple(CellScore.like(result, name=name, runs=len(result.trials)) for name, result in results.items()),
    )
