"""Latency bounds on a busy computer: the least of a few attempts counts, because load only ever adds to a latency."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import TypeVar

PAUSES_S = (0.1, 0.3, 1.0, 3.0)
"""Before each further attempt: what keeps a computer busy lasts, and five attempts within it would be one."""
ATTEMPTS = 1 + len(PAUSES_S)
T = TypeVar("T")
E = TypeVar("E", bound=Exception)


def patiently(act: Callable[[int], T], error: type[E], is_stall: Callable[[E], bool]) -> T:
    """Do something, which is told how often it was tried before; again while it ends with an error that is a stall of
    this computer, which proves nothing, with the last of them in the end."""
    for attempt, pause_s in enumerate(PAUSES_S):
        try:
            return act(attempt)
        except error as one:
            if not is_stall(one):
                raise
        threading.Event().wait(pause_s)
    return act(len(PAUSES_S))


def attempts(**bounds_s: float) -> Iterator[dict[str, float]]:
    """Yield an empty dict per attempt, to be filled with its latencies [s]; end when the least of each keeps its bound.

    Raises ``AssertionError`` with all attempts if one latency never kept its bound. What the dict must hold:
    the names of ``bounds_s``. Each attempt prepares its devices anew.
    """
    made: list[dict[str, float]] = []
    for pause_s in (*PAUSES_S, 0.0):
        made.append({})
        yield made[-1]
        late = [name for name, bound_s in bounds_s.items() if min(one[name] for one in made) >= bound_s]
        if not late:
            return
        threading.Event().wait(pause_s)
    listed = "; ".join(f"{name} ({bounds_s[name]:g} s): {[round(one[name], 4) for one in made]}" for name in late)
    raise AssertionError(f"never within its bound in {ATTEMPTS} attempts [s]: {listed}")
