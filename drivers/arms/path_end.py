"""Early end of a stream of joint positions: the arm slows down along the path and comes to rest on it.

Loads no numpy: the worker process starts faster without it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

SLOWS_WITHIN_S = 1.0
"""Time in which the arm slows down. A path that uses at most half of its limits stays within them."""


def slowed(rows: Sequence[Sequence[float]], sent: int, period_s: float) -> tuple[list[list[float]], float]:
    """Return rows that end a path early, after ``sent`` rows, and the row (with a fraction) at which it ends.

    The rate at which the path is passed falls from 1 to 0 like a cosine; the arm never leaves the path.
    """
    last = len(rows) - 1
    steps = max(round(SLOWS_WITHIN_S / period_s), 1)
    at, tail = float(max(min(sent, len(rows)) - 1, 0)), []
    for step in range(1, steps + 1):
        at = min(at + 0.5 * (1.0 + math.cos(math.pi * step / steps)), float(last))
        first = min(int(at), max(last - 1, 0))
        share = at - first
        pairs = zip(rows[first], rows[min(first + 1, last)], strict=True)
        tail.append([(1.0 - share) * one + share * other for one, other in pairs])
    return tail, at
