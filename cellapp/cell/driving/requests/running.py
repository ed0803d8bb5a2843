"""Run a job in a run's folder: other processes can reach it, and the run records how each arm's halt ended."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial

from cellapp.cell.driving.requests.job_requests import taking_requests
from cellapp.cell.run import RunFile
from cellapp.cell.run.unseen_arms import note_halt
from cellapp.ground.control import JobControl
from cellapp.ground.progress import Listener, ignore


@contextlib.contextmanager
def running_job(run: RunFile, control: JobControl, name: str, listener: Listener = ignore) -> Iterator[Listener]:
    """While the context is open, take requests of other processes and record arms that were not seen at rest.

    Yield the listener to report to. Raise as ``taking_requests``.
    """
    recording = control.recording(partial(note_halt, run))
    with recording, taking_requests(run.folder, control, name, listener) as heard:
        yield heard
