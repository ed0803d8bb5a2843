"""Judge blind trials: calibrate and search every run without its truth, then open the truth and score.

The findings are stored in each run's file, so that judging can be resumed.
"""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib.resources import files
from pathlib import Path

from pydantic import ValidationError

from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import known_readings
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.stages import read_stages
from cellapp.commands.trials.scoring import ArmFindings, HiddenEffect, JudgeResult, Likeness, Outcome, ScoredRun, scores
from cellapp.commands.trials.sealed import DescribedTerm, GroundTruth, check_readings, check_seal, open_truth
from cellapp.commands.trials.sealed_setup import HARD, POSITION
from cellapp.estimation.calibration.quantities import ArmReadings
from cellapp.estimation.discovery.arm_data import UNKNOWN
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.records import ArmDiscoveryResult, BeforeAfter
from cellapp.ground.errors import InputError
from cellapp.ground.executors import PoolWork, gather
from cellapp.ground.progress import Listener, Progress
from cellapp.ground.results import CALIBRATE, Record
from cellapp.ground.version import __version__
from cellapp.robot.effects import EFFECTS
from cellapp.robot.model import CellModel

_POSITIONS: tuple[frozenset[str], ...] = (
    frozenset({POSITION}),
    frozenset({"x", "y", "z"}),
    frozenset({"range", "azimuth", "elevation"}),
)
"""Sets of variables that together state where the SMR is."""
_OF_SPACE = ("tracker", "base", "workspace", "field", "position")
"""First words of channels that may describe a field over the workspace."""


def score_run(truth: GroundTruth, arms: Mapping[str, ArmFindings]) -> ScoredRun:
    """Compare the findings in one run with what was hidden in it."""
    noise_um = truth.noise_um.get(truth.arm, 0.0)
    hidden = tuple(HiddenEffect.like(one, visible=one.visible_um > noise_um) for one in truth.effects)
    called = [_library_name(truth, effect.effect) for effect in hidden]
    names = frozenset(called)
    here = arms.get(truth.arm)
    return ScoredRun.like(
        truth,
        hidden=hidden,
        visible=None if here is None else all(effect.visible for effect in hidden),
        outcome=None if here is None else _outcome(names, frozenset(here.accepted)),
        in_answer_set=None if here is None else names <= {slug for answers in here.answer_sets for slug in answers},
        description="" if here is None or truth.expected is None else _description(truth.expected, here.described),
        second_names=() if here is None else _second_names(called, truth.expected, here),
        arms=arms,
    )


def _library_name(truth: GroundTruth, effect: str) -> str:
    """Return the name that a hidden effect should get: hard cases may also hide effects that the library lacks."""
    return UNKNOWN if truth.kind == HARD and effect not in EFFECTS else effect


def _outcome(hidden: frozenset[str], accepted: frozenset[str]) -> Outcome:
    if accepted == hidden:
        return "named"
    if not accepted:
        return "none"
    if accepted > hidden:
        return "extra"
    if accepted < hidden:
        return "part"
    return "unknown" if accepted == {UNKNOWN} else "wrong"


def _description(expected: DescribedTerm, described: Sequence[DescribedTerm]) -> Likeness:
    """Rate the best match of a data-driven term; a channel in one direction counts as that channel.

    A field over the workspace is right with at least two variables of position, or with the word itself.
    """
    best: Likeness = ""
    for term in described:
        variables = set(term.variables)
        if expected.variables == (POSITION,):
            here = term.channel.split(" ")[0] in _OF_SPACE
            part = any(variables and variables <= names for names in _POSITIONS)
            right = POSITION in term.sentence or (part and (len(variables) > 1 or POSITION in variables))
        else:
            here = term.channel == expected.channel or term.channel.startswith(f"{expected.channel} ")
            part, right = bool(variables & set(expected.variables)), variables == set(expected.variables)
        if here and right:
            return "right"
        if here and part:
            best = "part"
    return best


def _second_names(called: Sequence[str], expected: DescribedTerm | None, found: ArmFindings) -> tuple[str, ...]:
    """Return the names accepted beyond the number of hidden effects; a name that replaces a missing one is only wrong.

    ``called`` are the names that the hidden effects should get.
    """
    wanted = Counter([UNKNOWN] if expected is not None else called)
    terms = iter(found.described)
    beyond: list[str] = []
    for slug in found.accepted:
        term = next(terms, None) if slug == UNKNOWN else None
        if wanted[slug] > 0:
            wanted[slug] -= 1
        else:
            beyond.append(slug if term is None else f"{term.channel}: {', '.join(term.variables)}")
    return tuple(beyond[sum(wanted.values()) :])


TRIAL_RESULT = "sealed-trial"
"""Name of the document in a run's file that holds the findings."""
_SEARCHING = ("estimation/calibration", "estimation/design", "estimation/discovery", "estimation/motion", "robot")


class StoredFindings(Record):
    """What was found in one arm, as its run keeps it."""

    discovery: ArmDiscoveryResult
    seconds: float
    cpu_seconds: float


class StoredTrial(Record):
    """What was found in one run, by which state of the program (``source``)."""

    written: str
    program: str
    source: str
    arms: Mapping[str, StoredFindings]


def judge_trials(folder: Path, work: PoolWork, *, again: bool = False) -> JudgeResult:
    """Calibrate and search all runs of a folder that are not judged yet, then open the truth and compare.

    The findings are stored in the runs themselves; workers of a cluster must see the folder
    under the same path. ``again`` also repeats runs judged before. A run that fails is reported and does not stop the
    others.

    Raises
    ------
    InputError
        If the folder holds no sealed trials, or a run is missing or was changed since.
    CheckFailed
        If the seal is broken.
    Cancelled
        On request; what was judged so far is kept.
    """
    check_seal(folder)  # without parsing: report a broken seal before hours of work
    runs = sorted(path for path in folder.glob("run-*") if path.is_dir())
    if not runs:
        raise InputError(f"{folder} holds no runs; give a folder that 'cellapp trials seal PROFILE --out FOLDER' made")
    source = source_digest()
    pending = runs if again else [run for run in runs if _stored(run) is None]
    failures = _judge_all(pending, source, len(runs), work)
    opened = open_truth(folder)
    scored, sources, failed = _compare(folder, opened.trials, failures)
    return JudgeResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        source=source,
        judged_by_other_source=sum(other != source for other in sources),
        sealed=opened.sealed,
        failed=failed,
        **dict(scores(scored)),
    )


def judge_run(folder: Path, source: str) -> None:
    """Calibrate one run, search its arms, and store findings and times in the run's file.

    ``source`` identifies the state of the program; see ``source_digest``.
    """
    with RunFile.open(folder, write=True) as run:
        calibrate_run(run)
        calibrated = read_stages(run).current[CALIBRATE]
        model = CellModel.from_json(calibrated.model or "", str(folder))
        readings = {name: known_readings(run, name) for name in model.arms}
        arms = dict[str, StoredFindings]()
        for name, arm in ArmReadings.of_cell(run.profile, model.arms, readings).items():
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            found = discover_arm(arm)
            arms[name] = StoredFindings(
                seconds=time.perf_counter() - wall_s,
                cpu_seconds=time.process_time() - cpu_s,
                # without pictures: they are large, and 'discover' makes them again
                discovery=found.result.model_copy(update={"pictures": ()}),
            )
        stored = StoredTrial(
            written=datetime.now(UTC).isoformat(timespec="seconds"),
            program=f"cellapp {__version__}",
            source=source,
            arms=arms,
        )
        run.write_document(TRIAL_RESULT, stored.model_dump_json(by_alias=True))


def source_digest() -> str:
    """Return a short SHA-256 of the modules that calibrate and search, to tell results of program states apart."""
    root = Path(str(files("cellapp")))
    found = hashlib.sha256()
    for package in _SEARCHING:
        for path in sorted((root / package).rglob("*.py")):
            found.update(path.relative_to(root).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:12]


# -- inside -----------------------------------------------------------------------------------------------------------


def _stored(folder: Path) -> StoredTrial | None:
    """Read the findings in a run; None if there are none, or of a version that this one cannot read."""
    with RunFile.open(folder) as run:
        text = run.read_document(TRIAL_RESULT)
    try:
        return None if text is None else StoredTrial.model_validate_json(text)
    except ValidationError:
        return None


def _judge_all(runs: Sequence[Path], source: str, total: int, work: PoolWork) -> Mapping[str, str]:
    """Judge runs; return run -> error for those that failed."""
    before = total - len(runs)
    work.job.tell("judge", before, total, f"{before} judged before" if before else "")
    if not runs:
        return {}

    def of_all(event: Progress, listener: Listener) -> None:
        listener(replace(event, done=before + event.done, total=total))

    folders = {run.name: str(run.absolute()) for run in runs}
    unstored = replace(work, results=None)
    with work.job.heard_by(of_all):
        return gather(_judge, partial(str, source), folders, str, "judge", unstored, all_may_fail=True).failures


def _judge(source: str, folder: str) -> str:
    judge_run(Path(folder), source)
    return folder


def _compare(
    folder: Path, truths: Sequence[GroundTruth], failures: Mapping[str, str]
) -> tuple[list[ScoredRun], list[str], tuple[str, ...]]:
    """Score every judged run; also return the program states, and a sentence for each other run."""
    scored, sources, failed = [], [], []
    for truth in truths:
        check_readings(folder, truth)
        stored = _stored(folder / truth.run)
        if stored is None or truth.run in failures:
            failed.append(f"{truth.run}: {failures.get(truth.run, 'not judged')}")
            continue
        arms = {name: _findings(arm, truth.held_out_um[name]) for name, arm in stored.arms.items()}
        scored.append(score_run(truth, arms))
        sources.append(stored.source)
    return scored, sources, tuple(failed)


def _findings(stored: StoredFindings, drawn_um: float) -> ArmFindings:
    """Return the findings in an arm, with the rms length of the noise sampled at its held-out stops [µm]."""
    found = stored.discovery
    return ArmFindings(
        accepted=tuple(effect.effect for effect in found.accepted),
        answer_sets=tuple(effect.answer_set for effect in found.accepted),
        described=tuple(
            DescribedTerm(
                channel=effect.where.channel or "",
                variables=effect.where.variables or (),
                sentence="" if effect.description is None else effect.description.sentence,
            )
            for effect in found.accepted
            if effect.effect == UNKNOWN
        ),
        posteriors=_posteriors(found),
        invisible=tuple(effect.effect for effect in found.invisible),
        verdict=found.verdict,
        sentence=found.sentence,
        heldout_um=BeforeAfter(before=found.heldout_mm.before * 1e3, after=found.heldout_mm.after * 1e3),
        noise_um=drawn_um,
        seconds=stored.seconds,
        cpu_seconds=stored.cpu_seconds,
    )


def _posteriors(found: ArmDiscoveryResult) -> dict[str, float]:
    """Return the stated probability of each candidate and accepted effect; empty if none is stated."""
    stated = dict(found.candidates)
    for effect in found.accepted:
        if effect.posterior is not None and effect.effect != UNKNOWN:
            stated[effect.effect] = max(effect.posterior, stated.get(effect.effect, 0.0))
    return stated
