"""Which test process takes which files: some compute, others mostly wait for emulated devices and terminals.

A file whose tests wait says so: ``pytestmark = pytest.mark.waits``. These come last. Of several processes one in four
takes files from the end of the queue, the others from its beginning, until they meet. What waits needs the processor
seldom but at once, so the processes that compute leave it to the others, and take no such file.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

PROCESSES = 4
"""Of all tests, for two cores: one that waits, and three that compute, as tests of screens wait half of their time."""
_LONG_FIRST = ("interfaces", "estimation", "drivers", "commands", "cell")
"""Folders, those with the longest files first: what is begun last shall not run on alone."""
_NICENESS = 7
"""Three that compute leave together as much to the others as two did with 5."""


@cache
def waits(file: Path) -> bool:
    """Whether the tests of a file wait most of the time."""
    text = file.read_text("utf-8")
    return "pytestmark" in text and "pytest.mark.waits" in text


def in_order(items: list[pytest.Item]) -> None:
    """Put the tests that wait behind those that compute, and where the two ends of the queue meet what is short."""

    def place(item: pytest.Item) -> tuple[bool, int]:
        folder = item.path.relative_to(Path(__file__).parent).parts[0]
        rank = _LONG_FIRST.index(folder) if folder in _LONG_FIRST else len(_LONG_FIRST)
        return waits(item.path), -rank if waits(item.path) else rank

    items.sort(key=place)


def leave_the_processor(config: pytest.Config) -> None:
    """In a process that computes, let those that wait run first."""
    given = getattr(config, "workerinput", None)
    if given and not _waits(given["workerid"], given["workercount"]) and hasattr(os, "nice"):
        os.nice(_NICENESS)


def _waits(worker: str, count: int) -> bool:
    """Whether a process (gw0, gw1, ...) of ``count`` takes files from the end."""
    return int(worker.removeprefix("gw")) >= count - max(1, (count + 2) // 4)


class FromBothEnds(LoadFileScheduling):
    """Whole files, for some of the processes from the end of the queue."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        if self._is_of_waits(node):
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        elif waits(self.config.rootpath / next(iter(self.workqueue))) and any(map(self._is_of_waits, self.nodes)):
            return
        super()._assign_work_unit(node)

    def _is_of_waits(self, node: WorkerController) -> bool:
        return _waits(node.gateway.id, self.numnodes)
