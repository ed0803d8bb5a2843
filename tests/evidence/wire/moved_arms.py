"""Arms that something moves while a job measures them, on emulated controllers and with a tracker that notices nothing.

The run file then shows what was stored, the controllers' journals what was stopped, and when.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import Cell, open_cell
from cellapp.cell.run import RunFile
from cellapp.ground.profile import Profile
from drivers.emulators.ur_controller import Control
from drivers.trackers.protocol import Point
from tests.evidence.wire.storm_cell import StormCell
from tests.verbs import collect_by

STEP = 1e3
"""Speed of a push that shows no speed: the arm is elsewhere in the next state."""
Attack = Callable[[Control], None]
_pause = threading.Event().wait


def pushed(by: float, speed: float, arm: str = "left", after_s: float = 0.0, back_after_s: float = 0.0) -> Attack:
    """Return a push of a joint by ``by`` [rad] at ``speed`` [rad/s], ``after_s`` into the averaging, and one back."""

    def attack(control: Control) -> None:
        _pause(after_s)
        control(arm, "push", by, speed)
        if back_after_s:
            _pause(back_after_s)
            control(arm, "push", -by, speed)

    return attack


def collected(cell: StormCell, run: RunFile, attacks: list[Attack]) -> None:
    """Collect with a tracker that notices no motion; an attack begins with each of its first averagings.

    Raises as ``collect_run``.
    """

    @contextmanager
    def opened(profile: Profile, **options: Any) -> Iterator[Cell]:
        with open_cell(profile, **options) as opened:

            def measure(expected_M: np.ndarray, averaging_s: float) -> Point:
                began_s = time.monotonic()
                if attacks:
                    attacks.pop(0)(cell.control)
                _pause(max(began_s + averaging_s - time.monotonic(), 0.0))
                return Point(expected_M, 1e-10 * np.eye(3), time.monotonic() - 0.5 * averaging_s, averaging_s, None)

            opened.tracker.measure = measure  # type: ignore[method-assign]
            yield opened

    collect_by(opened, run)
