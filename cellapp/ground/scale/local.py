"""Tasks on the cores of this computer: in this process, or in processes of their own with one thread each."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import wait as wait_for_end

from cellapp.ground.progress import CancelToken
from cellapp.ground.scale.executor import MOST_ATTEMPTS
from cellapp.ground.scale.task import Task
from cellapp.ground.scale.worker import Answer, perform

_POLL_S = 0.2
"""How often a cancel request is looked at."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_CONTEXT = multiprocessing.get_context("spawn")  # not forked: BLAS reads the number of its threads when it is loaded


class InProcess:
    """One task after the other, in this process."""

    workers = 1

    def answers(
        self, common: str, program: str, tasks: Sequence[Task], cancel: CancelToken
    ) -> Iterator[tuple[Task, Answer]]:
        """As ``Executor.answers``; a task that ends its process ends this one."""
        for task in tasks:
            cancel.check()
            yield task, Answer.model_validate_json(perform(task.kind, common, task.parameters, program))


class LocalProcesses:
    """``workers`` processes. Each is a pool of one, so that a process that ends says which task it was at."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def answers(
        self, common: str, program: str, tasks: Sequence[Task], cancel: CancelToken
    ) -> Iterator[tuple[Task, Answer]]:
        """As ``Executor.answers``; a cancelled job ends with the tasks under way."""
        waiting, ends = deque(tasks), Counter[str]()
        idle = [_new_process() for _ in range(min(self.workers, len(tasks)))]
        under_way: dict[Future[str], tuple[Task, ProcessPoolExecutor]] = {}
        with _terminated_on_error(), _environment(_ONE_THREAD):
            while True:
                while idle and waiting and not cancel.cancelled:
                    task, process = waiting.popleft(), idle.pop()
                    under_way[_begun(process, task, common, program)] = task, process
                if not under_way:
                    break
                ended, _ = wait(under_way, timeout=_POLL_S, return_when=FIRST_COMPLETED)
                for future in ended:
                    task, process = under_way.pop(future)
                    if not isinstance(future.exception(), BrokenProcessPool):
                        idle.append(process)
                        yield task, Answer.model_validate_json(future.result())
                        continue
                    process.shutdown()
                    idle.append(_new_process())
                    ends[task.key] += 1
                    if ends[task.key] < MOST_ATTEMPTS:
                        waiting.appendleft(task)
                    else:
                        yield task, Answer(failure=f"its process was ended {MOST_ATTEMPTS} times, perhaps for memory")
            for process in idle:
                process.shutdown()
        cancel.check()


# -- inside -----------------------------------------------------------------------------------------------------------


def _begun(process: ProcessPoolExecutor, task: Task, common: str, program: str) -> Future[str]:
    """The future of a task in a process; it has failed where the process is dead already."""
    try:
        with _ctrl_c_blocked():  # the first task starts the process
            return process.submit(perform, task.kind, common, task.parameters, program)
    except BrokenProcessPool as error:
        failed = Future[str]()
        failed.set_exception(error)
        return failed


def _new_process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, _CONTEXT, initializer=_begin)


def _begin() -> None:
    """Ignore Ctrl-C, which the client handles; end when the client ends, even if it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_client, name="client", daemon=True).start()


def _end_with_client() -> None:
    client = multiprocessing.parent_process()
    if client is not None:
        wait_for_end([client.sentinel])
        os._exit(1)  # the task under way is of no use to anybody


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
def _terminated_on_error() -> Iterator[None]:
    """Terminate the processes started inside if the block ends with an exception: also by a second Ctrl-C."""
    before = set(multiprocessing.active_children())
    try:
        yield
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for processes that are started inside."""
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
