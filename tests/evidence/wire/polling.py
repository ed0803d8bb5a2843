"""Waiting for another process, which cannot be awaited, within a limit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

_POLL_S = 0.002
"""A quarter of a controller's cycle."""


def can_move(status: Mapping[str, Any]) -> bool:
    """Whether an emulated controller that reports ``status`` would accept a motion."""
    return bool(status["robot_mode"] == "RUNNING" and status["safety_mode"] == "NORMAL")


def comes_about(condition: Callable[[], object], deadline_s: float, poll_s: float = _POLL_S) -> bool:
    """Ask again and again until ``condition`` holds; False if it does not by ``deadline_s`` (``time.monotonic``)."""
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(poll_s)
    return True
