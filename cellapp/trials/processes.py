"""Independent tasks in processes of their own, a thread each; a cancelled job ends with the tasks under way."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import TypeVar

from threadpoolctl import threadpool_limits

from cellapp.errors import CellappError
from cellapp.progress import CancelToken

_POLL_S = 0.2
"""How often a cancel request is looked at."""

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


def in_processes(
    function: Callable[[Task], Outcome], tasks: Iterable[Task], jobs: int, cancel: CancelToken
) -> Iterator[Outcome]:
    """Outcomes of ``function`` in the order in which tasks end, ``jobs`` at a time; one job works in this process.

    Raises
    ------
    CellappError
        If a process was ended from outside.
    Cancelled
        On request, after the tasks under way.
    """
    if jobs == 1:
        for task in tasks:
            cancel.check()
            with threadpool_limits(1):
                outcome = function(task)
            yield outcome
        return
    waiting = iter(tasks)
    context = multiprocessing.get_context("spawn")  # not forked: BLAS has threads of its own
    ignore_ctrl_c = (signal.SIGINT, signal.SIG_IGN)  # it reaches the whole group, and this process ends the others
    with ProcessPoolExecutor(jobs, context, initializer=signal.signal, initargs=ignore_ctrl_c) as pool:
        under_way: set[Future[Outcome]] = {pool.submit(_alone, function, task) for task in islice(waiting, jobs)}
        while under_way:
            ended, under_way = wait(under_way, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in ended:
                try:
                    yield future.result()
                except BrokenProcessPool:
                    raise CellappError(
                        "a process of the trial was ended from outside, perhaps for lack of memory; use fewer --jobs"
                    ) from None
                for task in islice(waiting, 0 if cancel.cancelled else 1):
                    under_way.add(pool.submit(_alone, function, task))
    cancel.check()


def _alone(function: Callable[[Task], Outcome], task: Task) -> Outcome:
    with threadpool_limits(1):
        return function(task)
