"""Actions at given times of a simulation."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from itertools import count


class Schedule:
    """Queue of actions, ordered by their times; at equal times, by the order in which they were added."""

    def __init__(self) -> None:
        self._actions: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()
        self._next_s = math.inf

    @property
    def next_s(self) -> float:
        """Time of the next action [s]; infinite if there is none."""
        return self._next_s

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Add an action. If its time is past, it runs as soon as time advances."""
        heapq.heappush(self._actions, (time_s, next(self._numbers), action))
        self._next_s = self._actions[0][0]

    def run_next(self) -> None:
        """Remove the next action and call it; it may add others."""
        _, _, action = heapq.heappop(self._actions)
        self._next_s = self._actions[0][0] if self._actions else math.inf
        action()
