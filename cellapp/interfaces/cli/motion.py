"""Permission of a person to move real arms: ``--allow-motion``, or the profile's name typed at the terminal."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable

from cellapp.interfaces.cli.job import Job

_LOOK_S = 0.1
"""Interval at which a waiting question checks whether the job must end."""


def asking(job: Job, profile_name: str, *, allowed: bool) -> Callable[[str], bool] | None:
    """Return a function that shows the first motion and returns whether it is allowed; None if nobody can be asked."""
    if allowed:

        def show(words: str) -> bool:
            job.warn(words)
            return True

        return show
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def ask(words: str) -> bool:
        job.warn(words)
        question = f"Type '{profile_name}' and Enter to let the arms move; anything else ends this."
        return typed_line(job, question) == profile_name

    return ask


def typed_line(job: Job, question: str) -> str | None:
    """Return the next line of standard input, stripped; None at its end. Ctrl-C also ends the question."""
    job.warn(question)
    answers: queue.Queue[str] = queue.Queue()
    threading.Thread(target=lambda: answers.put(sys.stdin.readline()), name="answer", daemon=True).start()
    while True:
        job.control.check()
        try:
            line = answers.get(timeout=_LOOK_S)
        except queue.Empty:
            continue
        return line.strip() if line else None
