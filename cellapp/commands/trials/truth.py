"""``trials truth``: many blind runs in sets that each answer one question, in sealed blocks that are judged in turn.

A set is a folder of blocks of 25 runs that share a plan. The sets take turns in proportion, so that a trial that is
stopped, or has a time limit, has results for all sets; the same command resumes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cellapp.commands.trials.check_records import exact_interval
from cellapp.commands.trials.judge import judge_trials, source_digest
from cellapp.commands.trials.judge_records import ScoredRun
from cellapp.commands.trials.posteriors import ACCEPTED, posterior_scores
from cellapp.commands.trials.sealed import TRUTH_FILE, seal_trials
from cellapp.commands.trials.sealed_cases import MIXED, NONE, ONE, OUT, PAIR
from cellapp.commands.trials.sealed_setup import Setup
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.view.table import Interval, Table, table_of
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Progress
from cellapp.ground.results import Record, Result
from cellapp.ground.time_limit import UNLIMITED, TimeLimit
from cellapp.ground.version import __version__

BLOCK = 25
"""Runs of a block."""
FEW_STOPS = (25, 40, 60, 80)
"""Stops of the blocks of the set ``few`` in turn: 10 to 20 of them are held out, 15, 30, 45 and 60 are for learning."""


@dataclass(frozen=True)
class TrialSet:
    """One question: its conditions, and how many runs answer it."""

    setup: Setup
    runs: int


SETS: Mapping[str, TrialSet] = {
    "clean": TrialSet(Setup(kind=NONE), 300),
    "single": TrialSet(Setup(kind=ONE, laws="other"), 400),
    "pair": TrialSet(Setup(kind=PAIR, laws="other"), 200),
    "outside": TrialSet(Setup(kind=OUT), 100),
    "narrow": TrialSet(Setup(kind=MIXED, laws="other", ranges="narrow"), 100),
    "unstated": TrialSet(Setup(kind=MIXED, laws="other", stated=False), 100),
    "few": TrialSet(Setup(kind=MIXED, laws="other"), 100),
}
"""Name -> conditions and usual size; a run has two arms, of which at most one has effects."""


class Share(Record):
    """How many of some cases, and the exact 95 % interval of the share."""

    hits: int
    n: int
    low: float
    high: float

    @classmethod
    def of(cls, hits: Sequence[bool]) -> Share | None:
        """Count the hits among cases; None without any case."""
        if not hits:
            return None
        low, high = exact_interval(sum(hits), len(hits))
        return cls(hits=sum(hits), n=len(hits), low=low, high=high)


class TruthScore(Record):
    """What a set answers.

    Attributes
    ----------
    runs, wanted : int
        Runs that were judged, and that were asked for.
    false_names, false_unknown : Share or None
        Arms in which nothing is hidden that got a name, or an unknown effect without a name.
    exact : Share or None
        Runs whose hidden effects of the library are all visible, and that got exactly their names.
    second_names : Share or None
        Those of them that got a further name.
    outside : Share or None
        Runs with a visible law outside the library whose arm got no name.
    brier : float or None
        Mean square of probability less truth over ``names`` accepted names.
    """

    runs: int
    wanted: int
    false_names: Share | None
    false_unknown: Share | None
    exact: Share | None
    second_names: Share | None
    outside: Share | None
    names: int
    brier: float | None


class TruthResult(Result, schema="cellapp-trials-truth-sets"):
    """``trials truth``: scores by set and in total, and runs that could not be judged."""

    date: str
    program: str
    source: str
    profile: str
    seed: int
    sets: Mapping[str, TruthScore]
    total: TruthScore
    failed: tuple[str, ...] = ()


def sizes_of(text: str) -> dict[str, int]:
    """Parse the runs of each set, as ``clean=300,single=100``; sets that are not named have their usual size.

    Raises
    ------
    InputError
        For an unknown set, or a number that is not zero or more.
    """
    sizes = {name: one.runs for name, one in SETS.items()}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (piece.strip() for piece in part.partition("="))
        if name not in sizes or not number.isdecimal():
            raise InputError(f"--runs: '{part}': expected SET=NUMBER; sets are {', '.join(SETS)}")
        sizes[name] = int(number)
    return sizes


def truth_trials(
    profile: Profile,
    folder: Path,
    sizes: Mapping[str, int],
    seed: int,
    work: Work = IN_PLACE,
    limit: TimeLimit = UNLIMITED,
) -> TruthResult:
    """Seal and judge the blocks of all sets in turn, and score the judged runs.

    Parameters
    ----------
    sizes : mapping
        Set -> number of runs.
    seed : int
        Draws everything.
    limit : TimeLimit
        No block starts after it; the next call judges the rest.

    Raises
    ------
    InputError
        If the profile cannot be sealed, or the folder has blocks of another seed.
    CheckFailed
        If a seal is broken.
    Cancelled
        On request; judged runs stay judged.
    """
    scored: dict[str, list[ScoredRun]] = {name: [] for name, size in sizes.items() if size}
    failed: list[str] = []
    blocks = _blocks(sizes, seed)
    for place, block in enumerate(blocks):
        if limit.left_s < 0.0:
            break
        work.cancel.check()
        work.listener(Progress("truth", place, len(blocks), block.name))
        own = folder / block.name
        if not (own / TRUTH_FILE).is_file():
            own.parent.mkdir(parents=True, exist_ok=True)
            seal_trials(profile, own, block.runs, block.setup, seed=block.seed, cancel=work.cancel)
        result = judge_trials(own, Work(work.resources, cancel=work.cancel))
        if (result.sealed.seed, result.sealed.runs) != (block.seed, block.runs):  # only the opened truth states them
            raise InputError(f"{own} has runs of another seed or size; give those, or another --out")
        scored[block.set] += result.trials
        failed += [f"{block.name}/{one}" for one in result.failed]
    work.listener(Progress("truth", len(blocks), len(blocks), "done"))
    every = [run for runs in scored.values() for run in runs]
    return TruthResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        source=source_digest(),
        profile=profile.name,
        seed=seed,
        sets={name: truth_score(runs, sizes[name]) for name, runs in scored.items()},
        total=truth_score(every, sum(sizes.values())),
        failed=tuple(failed),
    )


def truth_score(runs: Sequence[ScoredRun], wanted: int) -> TruthScore:
    """Score some runs."""
    empty = [found for run in runs for arm, found in run.arms.items() if arm != run.arm]
    known = [run for run in runs if run.hidden and run.expected is None and run.visible]
    outside = [run for run in runs if run.expected is not None and run.visible]
    accepted = next((one for one in posterior_scores(runs) if one.about == ACCEPTED), None)
    return TruthScore(
        runs=len(runs),
        wanted=wanted,
        false_names=Share.of([bool(arm.names) for arm in empty]),
        false_unknown=Share.of([arm.unknown and not arm.names for arm in empty]),
        exact=Share.of([run.outcome == "named" for run in known]),
        second_names=Share.of([bool(run.second_names) for run in known]),
        outside=Share.of([not run.arms[run.arm].names for run in outside]),
        names=0 if accepted is None else accepted.n,
        brier=None if accepted is None else accepted.brier,
    )


def truth_table(result: TruthResult) -> Table:
    """Build a table with a row for each set: counts, and the interval of each share."""
    rows = [*result.sets.items(), ("total", result.total)]
    shares = {
        "false names": "false_names",
        "false unknown": "false_unknown",
        "exact names": "exact",
        "second names": "second_names",
        "outside, not named": "outside",
    }
    columns = [
        column
        for title, field in shares.items()
        for column in (
            (title, lambda row, field=field: _counts(getattr(row[1], field))),
            (f"{title}, 95 %", lambda row, field=field: _limits(getattr(row[1], field)), ".1f", "%"),
        )
    ]
    return table_of(
        "Sets of blind runs",
        rows,
        ("set", lambda row: row[0]),
        ("runs", lambda row: f"{row[1].runs} of {row[1].wanted}"),
        *columns,
        ("accepted names", lambda row: row[1].names, "d"),
        ("Brier score", lambda row: row[1].brier, ".3f"),
    )


def truth_sentence(result: TruthResult) -> str:
    """State what was judged, and by which program version."""
    return (
        f"{counted(result.total.runs, 'run')} of {result.total.wanted}, two arms each; {result.date}, {result.program},"
        f" source {result.source}, profile {result.profile}, seed {result.seed}. False names: of arms in which nothing"
        " is hidden; exact and second names: of runs whose effects are all larger than the noise."
    )


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Block:
    """Runs that are sealed together."""

    set: str
    number: int
    runs: int
    setup: Setup
    seed: int

    @property
    def name(self) -> str:
        """Its folder, relative to the folder of all sets."""
        return f"{self.set}/block-{self.number:02d}"


def _blocks(sizes: Mapping[str, int], seed: int) -> list[_Block]:
    """Return all blocks; those of each set are spread evenly."""
    found = []
    for place, (name, one) in enumerate(SETS.items()):
        count = -(-sizes.get(name, 0) // BLOCK)
        for number in range(count):
            few = {"stops": FEW_STOPS[number % len(FEW_STOPS)]} if name == "few" else {}
            drawn = int(np.random.default_rng([seed, place, number]).integers(2**31))
            runs = min(BLOCK, sizes[name] - number * BLOCK)
            found.append(((number + 0.5) / count, _Block(name, number, runs, one.setup.model_copy(update=few), drawn)))
    return [block for _, block in sorted(found, key=lambda pair: pair[0])]


def _counts(share: Share | None) -> str:
    return "" if share is None else f"{share.hits}/{share.n}"


def _limits(share: Share | None) -> Interval | None:
    return None if share is None else Interval(100.0 * share.low, 100.0 * share.high)
