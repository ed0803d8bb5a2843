"""One job at a time, in a separate thread: it calls a verb; its events wait in a queue.

Keys and signals reach the brakes through ``control`` and bypass the queue.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.commands.record import Ask, Request, Verb, View
from cellapp.ground.control import JobControl
from cellapp.ground.progress import Progress

if TYPE_CHECKING:
    from cellapp.ground.results import Result

JobWork = Callable[[JobControl, Ask], "Result | None"]
"""A verb with its inputs bound; it runs in the job's thread."""

_MOST_WAITING = 2000
"""Length of the event queue; a faster job loses the oldest events here, the run file has all."""
_ANSWER_S = 0.1
"""Interval at which a job that waits for an answer checks whether it must end."""


@dataclass(frozen=True)
class Job:
    """A job to run.

    Attributes
    ----------
    name : str
        A word or two for people: "collect".
    work : callable
        Function that does the work.
    folder : Path or None
        The run that it reads or adds to; its error log is written there.
    moves : bool
        Whether it may move arms; a calculation does not.
    process : int or None
        Id of the other process that runs it and is only watched and commanded from here; None: this process.
    verb : Verb or None
        Its verb, whose view shows the result; None for a job without a command.
    request : Request or None
        Request for the verb.
    """

    name: str
    work: JobWork
    folder: Path | None = None
    moves: bool = False
    process: int | None = None
    verb: Verb | None = None
    request: Request | None = None

    def view(self, result: Result) -> View:
        """Return the view of its result; call it in the job's thread, as tables may take a while."""
        return View() if self.verb is None else self.verb.view(result, self.request)


class JobRunner:
    """Runs one job at a time.

    Parameters
    ----------
    asks : callable
        Receives the question before the first motion, and what takes the person's decision; in the job's thread.
    ends : callable
        Receives the job at its end, its result or its exception, and the view of its result; in the job's thread.

    Attributes
    ----------
    code : int
        Exit code of the last job.
    """

    def __init__(
        self,
        asks: Callable[[str, Callable[[bool], None]], object],
        ends: Callable[[Job, Result | BaseException | None, View], object],
    ) -> None:
        self._asks, self._ends = asks, ends
        self._events: deque[Progress] = deque(maxlen=_MOST_WAITING)
        self._thread: threading.Thread | None = None
        self.control = JobControl(holds=True)
        self.job: Job | None = None
        self.code = 0

    @property
    def running(self) -> bool:
        """Whether a job was started and has not reported its end yet."""
        return self.job is not None

    @property
    def moves(self) -> bool:
        """Whether the current job may move arms, here or in another process."""
        job = self.job
        return job is not None and (job.moves or job.process is not None or self.control.has_brakes)

    @property
    def watched(self) -> bool:
        """Whether the current job belongs to another process: leaving it does not stop it."""
        return self.job is not None and self.job.process is not None

    def start(self, job: Job, control: JobControl | None = None) -> None:
        """Start a job; the previous one must have reported its end. ``control`` is that of a job of another process."""
        if self.job is not None:
            raise RuntimeError(f"{self.job.name} is still running")
        self.control = control or JobControl(holds=True)  # first: whoever sees the job, in any thread, stops this one
        self.job = job
        self._events.clear()
        # a daemon thread: a device that never answers cannot keep the program from ending
        self._thread = threading.Thread(target=self._run, args=(job, self.control), name=job.name, daemon=True)
        self._thread.start()

    def ended(self) -> None:
        """Note the end that was reported."""
        self.job = None

    def events(self, most: int | None = None) -> list[Progress]:
        """Remove the oldest events from the queue, at most ``most``, and return them."""
        count = len(self._events) if most is None else min(len(self._events), most)
        return [self._events.popleft() for _ in range(count)]

    def possible(self, verb: str) -> bool:
        """Return whether ``stop``, ``pause``, ``resume`` or ``abort`` can be requested from the current job."""
        request = self.control.request
        return self.running and {
            "stop": True,  # again and again: braking twice does no harm
            "pause": request != "abort",
            "resume": request in ("pause", "stop"),
            "abort": request != "abort",
        }.get(verb, False)

    def wait(self, timeout_s: float) -> None:
        """Wait, with a time limit, until an abandoned job has brought its arms to rest."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    # -- in the thread of the job --------------------------------------------------------------------------------------

    def _run(self, job: Job, control: JobControl) -> None:
        def ask(words: str) -> bool:
            answers: queue.SimpleQueue[bool] = queue.SimpleQueue()
            self._asks(words, answers.put)
            while control.request in ("none", "pause"):
                with contextlib.suppress(queue.Empty):
                    return answers.get(timeout=_ANSWER_S)
            return False

        ending: Result | BaseException | None
        view = View()
        try:
            with control.heard_by(lambda event, before: self._events.append(event)):
                ending = job.work(control, ask)
                view = view if ending is None else job.view(ending)
        except BaseException as error:  # noqa: BLE001 - the screens are told whatever ends the job
            ending = error
        self._ends(job, ending, view)
