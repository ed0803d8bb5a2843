"""Where tasks are computed: what a caller asks for, and what every place must do."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cellapp.ground.errors import CellappError
from cellapp.ground.progress import CancelToken
from cellapp.ground.scale.task import Task
from cellapp.ground.scale.worker import Answer

MOST_ATTEMPTS = 3
"""How often a task is begun whose worker ends: one worker may be killed by chance, three by the same task hardly."""
_CGROUP = Path("/sys/fs/cgroup/cpu.max")
"""Quota and period of the processor time of this container [us], where Linux has control groups of version 2."""


@dataclass(frozen=True)
class Resources:
    """Where tasks are computed, and where their results are kept.

    Attributes
    ----------
    jobs : int, optional
        Processes of this computer, each of one thread; 1 computes in this process, None takes all cores.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers compute instead.
    store : Path, optional
        File of results: what it holds is not computed again.
    """

    jobs: int | None = None
    scheduler: str | None = None
    store: Path | None = None


IN_PROCESS = Resources(jobs=1)


class ComputingLost(CellappError):
    """What computed is gone; what was stored stays, and the same command continues."""

    exit_code = 4


class Executor(Protocol):
    """A place where tasks are computed."""

    @property
    def workers(self) -> int:
        """Tasks that are computed at the same time."""
        ...

    def answers(
        self, common: str, program: str, tasks: Sequence[Task], cancel: CancelToken
    ) -> Iterator[tuple[Task, Answer]]:
        """Compute tasks that share ``common``; the answers come in the order in which tasks end.

        A task whose worker ends is begun again, at most ``MOST_ATTEMPTS`` times in all; its answer is a failure then.

        Raises
        ------
        ComputingLost
            If nothing is left that computes.
        Cancelled
            On request.
        """
        ...


def local_cores() -> int:
    """Cores that this process may use: its affinity, and the quota of its control group."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    cores = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
    return max(1, min(cores, _quota(_CGROUP)))


def _quota(path: Path) -> int:
    """Whole cores that a control group grants; a very large number if there is no limit."""
    try:
        quota, period = path.read_text(encoding="ascii").split()
        return math.ceil(int(quota) / int(period))
    except (OSError, ValueError):  # no such file, or "max 100000": no limit
        return 2**31
