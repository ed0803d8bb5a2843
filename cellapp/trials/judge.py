"""Judging sealed trials: every run is calibrated and searched without its truth, which is opened when all are done.

What was found stays in each run's file, so that judging goes on where it was interrupted.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import cellapp
from cellapp import __version__
from cellapp.calibration.calibrate import calibrate_run
from cellapp.calibration.circumstances import circumstances_of_arms
from cellapp.discovery.discover import discover_arm
from cellapp.discovery.terms import UNKNOWN
from cellapp.errors import CellappError, CheckFailed, InputError
from cellapp.progress import CancelToken, Listener, Progress, ignore
from cellapp.run import RunFile
from cellapp.trials.sealed import Truth, check_seal, digest_of, open_truth
from cellapp.trials.verdicts import Found, Judged, judged_summary

TRIAL_RESULT = "sealed-trial"
_POLL_S = 0.2
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_SEARCHING = ("calibration", "design", "discovery", "effects", "kinematics", "model")


@dataclass(frozen=True)
class Judgement:
    """The outcome: the object that ``--json`` writes, and the runs that could not be judged, with the reason."""

    result: Mapping[str, Any]
    failed: tuple[str, ...]


def judge_trials(
    folder: Path,
    *,
    jobs: int = 2,
    again: bool = False,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
) -> Judgement:
    """Calibrate and search all runs of a folder that were not yet, then open the truth and compare.

    ``jobs`` processes work, each with one thread; ``again`` also repeats what was judged before. A run that fails is
    told and keeps the others from nothing.

    Raises
    ------
    InputError
        If the folder holds no sealed trials, or a run is missing or was changed since.
    CheckFailed
        If the seal is broken.
    Cancelled
        On request; what was judged so far is kept.
    """
    cancel = cancel or CancelToken()
    check_seal(folder)  # unread: a broken seal is told before hours of work
    runs = sorted(path for path in folder.glob("run-*") if path.is_dir())
    if not runs:
        raise InputError(f"{folder} holds no runs; give a folder that 'cellapp trials seal' made")
    source = source_digest()
    pending = runs if again else [run for run in runs if _stored(run) is None]
    failures = _judge_all(pending, source, jobs, len(runs), listener, cancel)
    opened = open_truth(folder)
    judged, failed = _compare(folder, opened.trials, failures)
    earlier = sum(one.source != source for one in judged)
    result = {
        "schema": "cellapp-trials-judge",
        "version": 1,
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "program": f"cellapp {__version__}",
        "source": source,
        "judged_by_other_source": earlier,
        "jobs": jobs,
        "sealed": dict(opened.sealed),
        "failed": list(failed),
        **judged_summary(judged),
    }
    return Judgement(result, failed)


def judge_run(folder: Path, source: str) -> None:
    """Calibrate one run and search its arms; what was found and how long it took is stored in the run's file.

    ``source`` says which state of the program does it; see ``source_digest``.
    """
    with RunFile.open(folder, write=True) as run:
        calibration = calibrate_run(run)
        readings = {name: run.readings(name) for name in calibration.model.arms}
        known = circumstances_of_arms(calibration.model.arms, readings)
        arms = {}
        for name, model in calibration.model.arms.items():
            wall_s, cpu_s = time.perf_counter(), time.process_time()
            found = discover_arm(run.profile, name, model, readings[name], known=known[name])
            spent = {"seconds": time.perf_counter() - wall_s, "cpu_seconds": time.process_time() - cpu_s}
            content = found.as_dict()
            content.pop("pictures", None)  # large, and drawn anew by 'discover'
            arms[name] = {**content, **spent}
        stored = {
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "program": f"cellapp {__version__}",
            "source": source,
            "arms": arms,
        }
        run.write_result(TRIAL_RESULT, json.dumps(stored))


def source_digest() -> str:
    """Short SHA-256 of the modules that calibrate and search, so that results of different states are told apart."""
    root = Path(cellapp.__file__).parent
    found = hashlib.sha256()
    for package in _SEARCHING:
        for path in sorted((root / package).rglob("*.py")):
            found.update(path.relative_to(root).as_posix().encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:12]


# -- inside -----------------------------------------------------------------------------------------------------------


def _stored(folder: Path) -> dict[str, Any] | None:
    """What was found in a run, or None."""
    with RunFile.open(folder) as run:
        text = run.read_result(TRIAL_RESULT)
    found: dict[str, Any] | None = None if text is None else json.loads(text)
    return found


def _judge_all(
    runs: Sequence[Path], source: str, jobs: int, total: int, listener: Listener, cancel: CancelToken
) -> dict[str, str]:
    """Judge runs in processes of their own. Returns run -> what went wrong, for those that failed."""
    failures: dict[str, str] = {}
    done = total - len(runs)
    listener(Progress("judge", done, total, f"{done} judged before" if done else ""))
    if not runs:
        return failures
    waiting = iter(runs)
    under_way: dict[Future[None], Path] = {}
    # not forked: BLAS reads the number of its threads when it is loaded
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=_ignore_ctrl_c)
    with _environment(_ONE_THREAD), pool, _ended_with_us():
        with _deaf_to_ctrl_c():  # the first task starts all processes
            for run in islice(waiting, jobs):
                under_way[pool.submit(judge_run, run, source)] = run
        while under_way:
            ended, _ = wait(under_way, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in ended:
                run, done = under_way.pop(future), done + 1
                error = future.exception()
                if isinstance(error, BrokenProcessPool):
                    cancel.check()
                    raise CellappError(
                        f"{run}: the process that judged it ended by itself, perhaps for lack of memory;"
                        " what was judged is kept: judge again with fewer --jobs"
                    )
                if error is not None:
                    text = str(error) if isinstance(error, CellappError) else f"{type(error).__name__}: {error}"
                    failures[run.name] = text
                listener(Progress("judge", done, total, run.name))
                if not cancel.cancelled:
                    for further in islice(waiting, 1):
                        under_way[pool.submit(judge_run, further, source)] = further
    cancel.check()
    return failures


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Processes started in here leave Ctrl-C, which reaches the whole group, to this one; it hears it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows: see the pool's initializer
        yield
        return
    resource_tracker.ensure_running()  # which would lift the mask when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _ended_with_us() -> Iterator[None]:
    """Whatever ends this block early also ends the processes started in it; a run's file survives that."""
    before = set(multiprocessing.active_children())
    try:
        yield
    except BaseException:  # also a second Ctrl-C
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _compare(
    folder: Path, truths: Sequence[Truth], failures: Mapping[str, str]
) -> tuple[list[Judged], tuple[str, ...]]:
    """Truth and finding of every run that was judged, and a sentence for each that was not."""
    judged, failed = [], []
    for truth in truths:
        path = folder / truth.run
        if not path.is_dir():
            raise InputError(f"{path} is missing, but was sealed; put it back, or seal new trials")
        with RunFile.open(path) as run:
            digest = digest_of({name: run.readings(name) for name in run.arms()})
        if digest != truth.readings:
            raise CheckFailed(f"{path}: its readings are not those that were sealed; seal new trials")
        stored = _stored(path)
        if stored is None or truth.run in failures:
            failed.append(f"{truth.run}: {failures.get(truth.run, 'not judged')}")
            continue
        arms = {name: _found(arm) for name, arm in stored["arms"].items()}
        judged.append(Judged(truth, arms, stored["source"]))
    return judged, tuple(failed)


def _found(arm: Mapping[str, Any]) -> Found:
    """What was found in an arm, from what its run holds."""
    said = [
        (str(entry["where"].get("channel", "")), tuple(entry["where"].get("variables", ())))
        for entry in arm["accepted"]
        if entry["effect"] == UNKNOWN
    ]
    return Found(
        accepted=tuple(entry["effect"] for entry in arm["accepted"]),
        answer_sets=tuple(tuple(entry["answer_set"]) for entry in arm["accepted"]),
        described=tuple(said),
        verdict=arm["verdict"],
        before_um=arm["heldout_mm"]["before"] * 1e3,
        after_um=arm["heldout_mm"]["after"] * 1e3,
        floor_um=arm["noise_floor_mm"] * 1e3,
        seconds=arm["seconds"],
        cpu_seconds=arm["cpu_seconds"],
    )
