"""Actions at given times of a simulation."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from itertools import count


class Schedule:
    """Actions in the order of their times; those of one time in the order in which they were entered."""

    def __init__(self) -> None:
        self._actions: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()
        self._next_s = math.inf

    @property
    def next_s(self) -> float:
        """Time of the next action [s]; infinite without one."""
        return self._next_s

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Enter an action. A time that has passed means as soon as time passes."""
        heapq.heappush(self._actions, (time_s, next(self._numbers), action))
        self._next_s = self._actions[0][0]

    def run_next(self) -> None:
        """Remove the next action and call it; it may enter others."""
        _, _, action = heapq.heappop(self._actions)
        self._next_s = self._actions[0][0] if self._actions else math.inf
        action()
