"""Many independent tasks on a ``concurrent.futures`` executor: processes of this computer, or a Dask cluster's.

A results file keeps what was computed, one line of JSON a task, so that the same call goes on where it was stopped.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import logging
import math
import multiprocessing
import os
import platform
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import resources
from importlib.metadata import version
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellapp.ground.errors import CellappError, CheckFailed, InputError
from cellapp.ground.progress import UNATTENDED, JobToken
from cellapp.ground.threads import one_blas_thread
from cellapp.ground.version import __version__

Prepared = TypeVar("Prepared")
Given = TypeVar("Given")
Found = TypeVar("Found")

_ATTEMPTS = 3
"""How often tasks are begun whose process ends."""
_POLL_S = 0.2
"""How often a cancel request, and whether a cluster is still there, are looked at."""
_CONNECT_S = 10.0
"""How long a scheduler is waited for, and then its first worker."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_ONE_AT_A_TIME = threading.RLock()
"""A Dask worker may have several threads; the limit of threads of linear algebra holds for the whole process."""

_PREPARED: dict[str, Any] = {}
"""What this process has prepared for its tasks."""


@dataclass(frozen=True)
class PoolWork:
    """Where tasks are computed and kept, and for which job.

    ``jobs``: processes, each of one thread; 1 computes in this process, None takes all cores. ``scheduler``: address of
    a Dask scheduler, whose workers compute instead. ``results``: file that keeps what was computed.
    """

    jobs: int | None = 1
    scheduler: str | None = None
    results: Path | None = None
    job: JobToken = UNATTENDED


@dataclass(frozen=True)
class Gathered(Generic[Found]):
    """Results in the order of the tasks (None: it failed), and the name of each that failed -> why."""

    results: tuple[Found | None, ...]
    failures: Mapping[str, str]

    @property
    def found(self) -> list[Found]:
        """The results without those that failed."""
        return [one for one in self.results if one is not None]

    @property
    def failed(self) -> tuple[str, ...]:
        """Which tasks failed and why, in words."""
        return tuple(f"{name}: {reason}" for name, reason in self.failures.items())


class ComputingLost(CellappError):
    """What computed is gone; what the results file holds stays, and the same command continues."""

    exit_code = 4


def gather(
    function: Callable[[Prepared, Given], Found],
    prepare: partial[Prepared],
    given: Mapping[str, Given],
    found: type[Found],
    job: str,
    work: PoolWork,
    *,
    all_may_fail: bool = False,
) -> Gathered[Found]:
    """Compute ``function(prepare(), one)`` for every named one, by seed the same wherever it is computed.

    A process calls ``prepare`` once. Arguments and results (of type ``found``) must be writable as JSON. A task that
    fails is named and does not stop the others. ``job`` names the work to the listener.

    Raises
    ------
    InputError
        If the results file or the scheduler cannot be used.
    CellappError
        If every task failed, unless ``all_may_fail``; the reason and the kind are those of the first.
    ComputingLost
        If the scheduler or its workers are gone, or processes end again and again.
    Cancelled
        On request; tasks under way end and are kept.
    """
    if work.scheduler is not None and work.jobs is not None:
        raise InputError("--jobs: the scheduler has workers of its own; leave out --jobs or --scheduler")
    program, adapter = _program(function), TypeAdapter(found)
    about = json.dumps([program, function.__qualname__, to_jsonable_python([prepare.args, prepare.keywords])])
    text = {name: about + json.dumps(to_jsonable_python(one)) for name, one in given.items()}
    keys = {name: hashlib.sha256(one.encode()).hexdigest() for name, one in text.items()}
    kept = kept_results(work.results)
    results = {name: adapter.validate_python(kept[key]) for name, key in keys.items() if key in kept}
    failures: dict[str, _Answer] = {}
    work.job.tell(job, len(results), len(given), f"{len(results)} computed before" if results else "")
    missing = {name: one for name, one in given.items() if name not in results}
    for name, answer in _answers(_Shared(program, about, function, prepare), missing, work):
        if answer.failure:
            failures[name] = answer
        else:
            results[name] = answer.found
            _keep(work.results, keys[name], adapter.dump_python(answer.found, by_alias=True))
        work.job.tell(job, len(results) + len(failures), len(given), name)
    if failures and not results and not all_may_fail:
        first = next(failures[name] for name in given)
        others = f" (and so on: all {len(failures)} failed)" if len(failures) > 1 else ""
        raise (CheckFailed if first.exit_code == CheckFailed.exit_code else InputError)(f"{first.failure}{others}")
    words = {name: failures[name].failure for name in given if name in failures}
    return Gathered(tuple(results.get(name) for name in given), words)


def local_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shared:
    """What all tasks share; ``about`` is the same text only where what is prepared is the same."""

    program: str
    about: str
    function: Callable[[Any, Any], Any]
    prepare: Callable[[], Any]


@dataclass(frozen=True)
class _Answer:
    """What became of a task: its result, or why it failed and the exit code of that."""

    found: Any = None
    failure: str = ""
    exit_code: int = CheckFailed.exit_code


def _answers(shared: _Shared, given: Mapping[str, Any], work: PoolWork) -> Iterator[tuple[str, _Answer]]:
    """Every task as it ends. Tasks whose process was ended are begun again, with those that waited behind them."""
    jobs = min(work.jobs or local_cores(), len(given))
    if jobs <= 1 and work.scheduler is None:
        for name, one in given.items():
            work.job.check()
            yield name, _perform(shared, one)
        return
    waiting, attempts = dict(given), 1 if work.scheduler else _ATTEMPTS
    for _ in range(attempts):
        if waiting:
            with _cluster(work.scheduler) if work.scheduler else _processes(jobs) as executor:
                with _ctrl_c_blocked():  # processes start as the first tasks are submitted
                    begun = {executor.submit(_perform, shared, one): name for name, one in waiting.items()}
                for future in _ended(begun, work.job):
                    if not future.cancelled() and not isinstance(future.exception(), BrokenProcessPool):
                        del waiting[begun[future]]
                        yield begun[future], _answer_of(future)
            work.job.check()
    if waiting:
        who = f"--scheduler {work.scheduler}: the scheduler is gone" if work.scheduler else "processes were ended"
        raise ComputingLost(
            f"{who} {attempts} times, perhaps for memory, at {', '.join([*waiting][:3])}; repeat this command: with a"
            " results file it goes on where it was"
        )


def _ended(begun: Mapping[Future[_Answer], str], job: JobToken) -> Iterator[Future[_Answer]]:
    """Every future as it ends; those not begun are given up on a cancel request."""
    under_way = set(begun)
    while under_way:
        ended, under_way = wait(under_way, timeout=_POLL_S, return_when=FIRST_COMPLETED)
        yield from ended
        if job.cancelled:
            under_way -= {future for future in under_way if future.cancel()}


def _answer_of(future: Future[_Answer]) -> _Answer:
    error = future.exception()
    return future.result() if error is None else _Answer(failure=f"{type(error).__name__}: {error}")


@contextmanager
def _processes(jobs: int) -> Iterator[Executor]:
    """Processes of one thread each, which end with this one, and at once if the block ends with an exception."""
    context = multiprocessing.get_context("spawn")  # not forked: BLAS reads the number of its threads when loaded
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    here, there = context.Pipe(duplex=False)
    try:
        with ProcessPoolExecutor(jobs, context, _begin, (here,)) as pool:
            try:
                yield pool
            except BaseException:
                there.close()
                raise
    finally:
        here.close()
        there.close()
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _begin(client: Connection) -> None:
    """In a new process: ignore Ctrl-C, which the client handles; end when the client closes its end, or is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_client() -> None:
        with suppress(EOFError, OSError):
            client.recv()
        os._exit(1)  # the task under way is of no use to anybody

    threading.Thread(target=end_with_client, name="client", daemon=True).start()


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Block Ctrl-C, which reaches the whole process group, for processes started inside; it is delivered afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows: see ``_begin``
        yield
        return
    resource_tracker.ensure_running()  # which would lift the mask when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask scheduler. Raises ``InputError`` if there is none, or it has no workers."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--scheduler needs Dask ({error}): python -m pip install 'cellapp[cluster]'") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it says many times what the command says once
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False, name="cellapp")
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers ({str(error).splitlines()[0]}); start one with"
            " 'dask scheduler' and give its address, as tcp://127.0.0.1:8786"
        ) from None
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
        yield client.get_executor(pure=False)
    except TimeoutError:
        raise InputError(
            f"--scheduler {address}: the scheduler has no worker; start some, as 'dask worker {address} --nthreads 1'"
        ) from None
    finally:
        with suppress(TimeoutError):  # on a busy computer: how the job ended is told, not this
            client.close(timeout=_POLL_S)


def _perform(shared: _Shared, one: Any) -> _Answer:
    """Compute one task; a worker of another program refuses."""
    with _ONE_AT_A_TIME, one_blas_thread():
        try:
            if (here := _program(shared.function)) != shared.program:
                raise InputError(f"{platform.node()} runs {here}, this is {shared.program}; install the same on both")
            if shared.about not in _PREPARED:
                _PREPARED.clear()
                _PREPARED[shared.about] = shared.prepare()
            return _Answer(shared.function(_PREPARED[shared.about], one))
        except CellappError as error:
            return _Answer(failure=str(error), exit_code=error.exit_code)
        except Exception as error:  # noqa: BLE001 - one task that fails, of many, is reported with its place
            place = traceback.extract_tb(error.__traceback__)[-1]
            return _Answer(failure=f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})")


@lru_cache(maxsize=8)
def _program(function: Callable[..., Any]) -> str:
    """What results depend on: version and sources (those beside a function from outside, too), and arithmetic."""
    package = function.__module__.partition(".")[0]
    folders = {name: Path(str(resources.files(name))) for name in ("cellapp", "drivers")}
    folders.setdefault(package, Path(inspect.getfile(function)).parent)
    found = hashlib.sha256()
    for name, folder in folders.items():
        for path in sorted(folder.rglob("*.py")):
            found.update(f"{name}/{path.relative_to(folder).as_posix()}\n".encode() + path.read_bytes())
    packages = " ".join(f"{name} {version(name)}" for name in ("numpy", "scipy"))
    python = ".".join(platform.python_version_tuple()[:2])
    return f"cellapp {__version__} (source {found.hexdigest()[:12]}), Python {python}, {packages}"


def kept_results(path: Path | None) -> dict[str, Any]:
    """Key -> result of a results file; a last line that was cut off while it was written is removed.

    Raises ``InputError`` if it is none.
    """
    if path is None or not path.exists():
        return {}
    try:
        data = path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        kept = {one["key"]: one["found"] for one in map(json.loads, whole.splitlines())}
        if data and not kept:
            raise ValueError("it begins otherwise")
        os.truncate(path, len(whole))
        return kept
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path} is no results file ({error}); choose another name") from None


def _keep(path: Path | None, key: str, found: Any) -> None:
    """Append one result. Raises ``InputError`` if it cannot be written."""
    if path is None:
        return
    try:
        with path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps({"key": key, "found": found}) + "\n")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; choose a file that can be written") from None


# -- How long a job may last ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TimeLimit:
    """``minutes`` from ``began_s`` by the clock ``now`` [s]; None: as long as it needs."""

    minutes: float | None = None
    began_s: float = 0.0
    now: Callable[[], float] = time.monotonic

    @classmethod
    def from_now(cls, minutes: float | None) -> TimeLimit:
        """That begins now."""
        return cls(minutes, time.monotonic())

    @property
    def remaining_s(self) -> float:
        """Time that is left [s]; infinite without a limit, negative beyond it."""
        return math.inf if self.minutes is None else 60.0 * self.minutes - (self.now() - self.began_s)

    def allowed(self, each_s: float, most: int) -> int:
        """How many further trials of a duration [s] fit, at most ``most``."""
        return int(max(min(self.remaining_s / max(each_s, 1e-6), most), 0.0))

    def words(self) -> str:
        """How long it takes, before it begins."""
        return "as long as all trials need" if self.minutes is None else f"at most {self.minutes:g} min"
