"""A verb is done where nobody looks on."""

from __future__ import annotations

from collections.abc import Callable

from cellapp.commands.record import Work
from cellapp.ground.control import JobControl
from cellapp.ground.outputs import NEW_ONLY
from cellapp.ground.progress import ignore, ignore_words


def quiet_work(say: Callable[[str], None] = ignore_words) -> Work:
    """What a job has whose progress nobody follows: nobody can be asked, no file is replaced."""
    return Work(ignore, JobControl(), lambda _: None, NEW_ONLY, say=say)
