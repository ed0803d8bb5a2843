"""Passes of Python's collector that would hold up a stop.

A full pass holds the interpreter for 0.1 to 0.4 s once a run is loaded: no thread reads a key or stops arms meanwhile.
What survived a slow pass is set aside, so that no later pass goes over it again; when a job has ended, it is looked at
once more.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping

_SLOW_S = 0.02
_MOST = 100
"""Of a job: some of what is set aside, as a dialog that is closed later, becomes garbage and keeps its memory."""
_FULL = 2
"""The oldest generation of the collector."""


class SlowPasses:
    """Takes objects out of garbage collection (``gc.freeze``) after a slow full pass; called in any thread."""

    def __init__(self) -> None:
        self._began_s = 0.0
        self._set_aside = 0

    def watch(self) -> None:
        """Begin, for the rest of the process."""
        gc.callbacks.append(self._passed)

    def _passed(self, phase: str, info: Mapping[str, int]) -> None:
        if info["generation"] < _FULL:
            return
        if phase == "start":
            self._began_s = time.monotonic()
        elif self._set_aside < _MOST and time.monotonic() - self._began_s > _SLOW_S:
            gc.freeze()
            self._set_aside += 1

    def look_again(self) -> None:
        """Collect what was set aside and is garbage now. It holds the interpreter: call it while nothing moves."""
        if self._set_aside:
            self._set_aside = 0
            gc.unfreeze()
            gc.collect()
            gc.freeze()
