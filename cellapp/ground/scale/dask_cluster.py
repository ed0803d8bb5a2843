"""Tasks on the workers of an existing Dask cluster.

Dask sends the function ``perform`` by reference and texts as its arguments, with pickle: whoever reaches a scheduler or
a worker may run what he likes there. A cluster belongs into a trusted network; TLS is set up in Dask's own
configuration (``distributed.comm.tls``) and used by addresses that begin with ``tls://``.
"""

from __future__ import annotations

import hashlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, field

from cellapp.ground.errors import CellappError, InputError
from cellapp.ground.progress import CancelToken
from cellapp.ground.scale.executor import ComputingLost
from cellapp.ground.scale.program import Program, program_text, this_program
from cellapp.ground.scale.task import Task
from cellapp.ground.scale.worker import Answer, perform

try:
    from distributed import Client, Future, KilledWorker
except ImportError as error:
    raise InputError(f"--scheduler needs Dask ({error}): python -m pip install 'cellapp[cluster]'") from None

_CONNECT_S = 10.0
"""How long a scheduler is waited for, and then its first worker."""
_POLL_S = 0.2
"""How often the scheduler and a cancel request are looked at."""
_COUNT_EVERY_S = 2.0
"""How often workers are counted: they come and go."""
_NO_WORKER_S = 60.0
"""How long the job waits when no worker is left: a nanny starts a killed one again within seconds."""
_RESULT_S = 120.0
"""How long the text of a finished task may take on its way here."""
_LOOK_AGAIN_S = 0.5
"""After which a result is asked for again whose worker was killed before it was fetched."""
_COMPUTED_AGAIN = ("lost", "pending")
"""States of a task that had ended, whose worker was killed while it kept the result."""
_AHEAD = 2
"""Tasks that each worker has at hand: it then never waits for the next one, and the scheduler never holds many."""


@contextmanager
def dask_cluster(address: str) -> Iterator[DaskCluster]:
    """Connect to a scheduler whose workers run this program.

    Raises
    ------
    InputError
        If no scheduler answers, it has no workers, or one of them runs another program.
    """
    _silence_dask()
    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False, name="cellapp")
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers ({str(error).splitlines()[0]}); start one with"
            " 'dask scheduler' and give its address, as tcp://127.0.0.1:8786"
        ) from None
    try:
        _check_workers(client, address)
        yield DaskCluster(client, address)
    finally:
        client.close(timeout=_POLL_S)


@dataclass
class DaskCluster:
    """The workers of a scheduler; make one with ``dask_cluster``."""

    client: Client
    address: str
    _ended: queue.SimpleQueue[Future] = field(default_factory=queue.SimpleQueue)
    _counted_s: float = -_COUNT_EVERY_S
    _seen_s: float = field(default_factory=time.monotonic)
    _workers: int = 0

    @property
    def workers(self) -> int:
        """Threads of all workers."""
        self._count()
        return self._workers

    def answers(
        self, common: str, program: str, tasks: Sequence[Task], cancel: CancelToken
    ) -> Iterator[tuple[Task, Answer]]:
        """As ``Executor.answers``.

        Dask begins a task again whose worker ends, ``distributed.scheduler.allowed-failures`` times; those that were
        at hand there count as well. Whatever ended too many workers is therefore tried once more, alone.
        """
        digest = hashlib.sha256(common.encode()).hexdigest()
        with self._lost_as_sentence():
            # a task of its own: the scheduler has the text once, and makes it again if its worker is killed
            shared = self.client.submit(str, common, key=f"cellapp-common-{digest}", pure=False)
            suspects: list[Task] = []
            for task, answer in self._several(shared, program, tasks, cancel):
                if answer is None:
                    suspects.append(task)
                else:
                    yield task, answer
            for suspect in suspects:
                # under another name: the scheduler may not have forgotten the one that failed
                for task, answer in self._several(shared, program, [suspect], cancel, name="alone"):
                    yield task, answer or Answer(failure="every worker that began it ended, perhaps for memory")

    def _several(
        self, shared: Future, program: str, tasks: Sequence[Task], cancel: CancelToken, name: str = "task"
    ) -> Iterator[tuple[Task, Answer | None]]:
        """Answers of tasks that are at hand at the same time; None for one that ended too many workers."""
        waiting, under_way = deque(tasks), dict[str, tuple[Future, Task]]()
        try:
            while waiting or under_way:
                cancel.check()
                while waiting and len(under_way) < _AHEAD * max(self.workers, 1):
                    task = waiting.popleft()
                    future = self.client.submit(
                        perform,
                        task.kind,
                        shared,
                        task.parameters,
                        program,
                        key=f"cellapp-{name}-{task.key}",
                        pure=False,
                    )
                    under_way[future.key] = future, task
                    future.add_done_callback(self._ended.put)
                ended = self._next_ended()
                if ended is None or ended.key not in under_way:
                    continue
                if ended.status in _COMPUTED_AGAIN:
                    # put a task back among those that ended, a little later: Dask does not report it a second time
                    timer = threading.Timer(_LOOK_AGAIN_S, self._ended.put, [ended])
                    timer.daemon = True
                    timer.start()
                    continue
                future, task = under_way.pop(ended.key)
                yield task, _answer(future)
        finally:
            if under_way and self.client.status == "running":
                self.client.cancel([future for future, _ in under_way.values()])

    def _next_ended(self) -> Future | None:
        """A task that ended, None after a while.

        Raises
        ------
        ComputingLost
            If the scheduler is gone, or has had no worker for long.
        """
        try:
            ended = self._ended.get(timeout=_POLL_S)
        except queue.Empty:
            ended = None
        if self.client.status != "running":
            raise self._lost("ended, or its connection broke")
        if time.monotonic() - self._seen_s > _NO_WORKER_S:
            raise self._lost(f"has had no worker for {_NO_WORKER_S:.0f} s")
        if ended is None:
            self._count()
        return ended

    def _count(self) -> None:
        now_s = time.monotonic()
        if now_s - self._counted_s >= _COUNT_EVERY_S:
            with self._lost_as_sentence():
                self._workers = sum(self.client.nthreads().values())
            self._counted_s = now_s
        if self._workers:
            self._seen_s = now_s

    @contextmanager
    def _lost_as_sentence(self) -> Iterator[None]:
        try:
            yield
        except (OSError, CancelledError) as error:  # errors of distributed's communication are OSErrors
            raise self._lost(f"cannot be reached ({type(error).__name__})") from None

    def _lost(self, what: str) -> CellappError:
        return ComputingLost(
            f"--scheduler {self.address}: the scheduler {what}; start it and its workers again, and repeat this"
            " command: with --store it continues where it was"
        )


# -- inside -----------------------------------------------------------------------------------------------------------


def _silence_dask() -> None:
    """Dask reports on standard error, many times, what the job says once: a killed worker, a lost scheduler."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _answer(future: Future) -> Answer | None:
    """The answer of a task that ended; None if it ended too many workers."""
    if future.status == "finished":
        return Answer.model_validate_json(future.result(timeout=_RESULT_S))
    if future.status != "error":
        return Answer(failure="it was cancelled by another client of the scheduler")
    error = future.exception()
    if isinstance(error, KilledWorker):
        return None
    return Answer(failure=f"{type(error).__name__}: {error}")


def _check_workers(client: Client, address: str) -> None:
    """Refuse a cluster without workers, and workers of another program. Raises ``InputError``."""
    try:
        client.wait_for_workers(1, timeout=_CONNECT_S)
    except TimeoutError:
        raise InputError(
            f"--scheduler {address}: the scheduler has no worker; start some, as 'dask worker {address} --nthreads 1'"
        ) from None
    for worker, answer in client.run(program_text, on_error="return").items():
        if not isinstance(answer, str):
            raise InputError(
                f"--scheduler {address}: the worker {worker} does not know this program ({answer}); start 'dask worker'"
                f" in an environment with {this_program().words}"
            )
        its = Program.model_validate_json(answer)
        if its != this_program():
            raise InputError(
                f"--scheduler {address}: the worker {worker} runs {its.words}; this program is {this_program().words};"
                " install the same on both"
            )
