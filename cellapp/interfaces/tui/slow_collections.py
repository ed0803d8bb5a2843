"""Mitigation of slow garbage collections, which would delay a stop.

Once a run is loaded, a full collection holds the interpreter for 0.1 to 0.4 s, in which no thread can read a key or
stop arms. Objects that survived a slow collection are frozen, so that later ones skip them; after the end of a job they
are collected once more.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping

_SLOW_S = 0.02
_MOST = 100
"""Limit of freezes per job: frozen objects that become garbage, like a closed dialog, keep their memory."""
_FULL = 2
"""The oldest generation of the garbage collector."""


class SlowCollections:
    """Freezes objects (``gc.freeze``) after a slow full garbage collection; called in any thread."""

    def __init__(self) -> None:
        self._began_s = 0.0
        self._set_aside = 0

    def watch(self) -> None:
        """Start watching, for the rest of the process."""
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
        """Collect frozen objects that have become garbage. It holds the interpreter: call it while nothing moves."""
        if self._set_aside:
            self._set_aside = 0
            gc.unfreeze()
            gc.collect()
            gc.freeze()
