"""Compute a batch: take from the store what it holds, compute the rest, keep every result as it comes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic

from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.ground.scale.executor import Executor, Resources, local_cores
from cellapp.ground.scale.local import InProcess, LocalProcesses
from cellapp.ground.scale.program import program_text
from cellapp.ground.scale.store import ResultStore
from cellapp.ground.scale.task import Batch, Common, Found, Parameters, Prepared, Task
from cellapp.ground.scale.worker import Answer


@dataclass(frozen=True)
class Gathered(Generic[Found]):
    """What became of the tasks of a batch.

    Attributes
    ----------
    results : tuple
        In the order of the tasks; None for one that failed.
    failures : mapping
        Name of each task that failed -> why.
    workers : int
        Tasks that were computed at the same time.
    """

    results: tuple[Found | None, ...]
    failures: Mapping[str, str]
    workers: int

    @property
    def found(self) -> tuple[Found, ...]:
        """The results without those that failed."""
        return tuple(one for one in self.results if one is not None)

    @property
    def failed(self) -> tuple[str, ...]:
        """Which tasks failed and why, in words."""
        return tuple(f"{name}: {reason}" for name, reason in self.failures.items())


def gather(
    batch: Batch[Common, Prepared, Parameters, Found],
    job: str,
    resources: Resources,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    *,
    all_may_fail: bool = False,
) -> Gathered[Found]:
    """Results of all tasks of a batch, by seed the same wherever they are computed.

    A task that fails is named and does not stop the others. ``job`` names the work to the listener.

    Raises
    ------
    InputError
        If the store or the scheduler cannot be used.
    CellappError
        If every task failed, unless ``all_may_fail``; the reason and the exit code are those of the first.
    ComputingLost
        If the scheduler or all its workers are gone.
    Cancelled
        On request.
    """
    program = program_text()
    tasks, digest = batch.tasks(program), batch.digest(program)
    with _opened(resources) as store:
        answers = {} if store is None else store.answers(digest)
        missing = [task for task in tasks if task.key not in answers]
        before = len(tasks) - len(missing)
        listener(Progress(job, before, len(tasks), _said_before(store, batch.kind.reference, digest, before)))
        workers = 1
        if missing:
            if store is not None:
                store.begin(digest, job, batch.kind.reference, program, batch.shared)
            with executor_of(resources, missing=len(missing), tasks=len(tasks)) as executor:
                workers = executor.workers
                came = executor.answers(batch.shared, program, missing, cancel or CancelToken())
                for done, (task, answer) in enumerate(came, start=before + 1):
                    if answer.refused:
                        raise InputError(answer.failure)
                    answers[task.key] = answer
                    if store is not None:
                        store.write(digest, task, answer)
                    listener(Progress(job, done, len(tasks), task.name))
    if not all_may_fail:
        _refuse_failure_of_all([answers[task.key] for task in tasks])
    return _gathered(batch, tasks, answers, workers)


def check_resources(resources: Resources) -> None:
    """Refuse what does not fit together. Raises ``InputError``."""
    if resources.scheduler is not None and resources.jobs is not None:
        raise InputError("--jobs: the scheduler has workers of its own; leave out --jobs or --scheduler")


@contextmanager
def executor_of(resources: Resources, *, missing: int, tasks: int) -> Iterator[Executor]:
    """Where the missing tasks of a batch are computed. Raises ``InputError`` if it cannot be reached.

    The only task of a batch is computed in this process; the only one that is missing is not, as it may be missing
    because it ends its process.
    """
    check_resources(resources)
    if resources.scheduler is not None:
        from cellapp.ground.scale.dask_cluster import dask_cluster

        with dask_cluster(resources.scheduler) as cluster:
            yield cluster
    elif min(jobs := resources.jobs or local_cores(), tasks) == 1:
        yield InProcess()
    else:
        yield LocalProcesses(min(jobs, missing))


# -- inside -----------------------------------------------------------------------------------------------------------


@contextmanager
def _opened(resources: Resources) -> Iterator[ResultStore | None]:
    if resources.store is None:
        yield None
        return
    with ResultStore.open(resources.store) as store:
        yield store


def _said_before(store: ResultStore | None, kind: str, digest: str, before: int) -> str:
    """What of the store is used, and what is not."""
    if store is None:
        return ""
    others = store.others(kind, digest)
    said = [f"{before} in the store"] if before else []
    said += [f"{others} there of another program or other data are not used"] if others else []
    return ", ".join(said)


def _gathered(
    batch: Batch[Common, Prepared, Parameters, Found], tasks: list[Task], answers: dict[str, Answer], workers: int
) -> Gathered[Found]:
    results: list[Found | None] = []
    failures = {}
    for task in tasks:
        answer = answers[task.key]
        if answer.found is None:
            failures[task.name] = answer.failure
        results.append(None if answer.found is None else batch.kind.found.model_validate_json(answer.found))
    return Gathered(tuple(results), failures, workers)


def _refuse_failure_of_all(answers: Sequence[Answer]) -> None:
    """Raise the first error if there is nothing else."""
    if not answers or any(answer.found is not None for answer in answers):
        return
    others = f" (and so on: all {len(answers)} failed)" if len(answers) > 1 else ""
    kind = CheckFailed if answers[0].exit_code == CheckFailed.exit_code else InputError
    raise kind(f"{answers[0].failure}{others}")
