"""Latency bounds on a busy computer: the least of a few attempts counts, because load only ever adds to a latency."""

from __future__ import annotations

from collections.abc import Iterator

ATTEMPTS = 5


def attempts(**bounds_s: float) -> Iterator[dict[str, float]]:
    """Yield an empty dict per attempt, to be filled with its latencies [s]; end when the least of each keeps its bound.

    Raises ``AssertionError`` with all attempts if one latency never kept its bound. What the dict must hold:
    the names of ``bounds_s``. Each attempt prepares its devices anew.
    """
    made: list[dict[str, float]] = []
    for _ in range(ATTEMPTS):
        made.append({})
        yield made[-1]
        late = [name for name, bound_s in bounds_s.items() if min(one[name] for one in made) >= bound_s]
        if not late:
            return
    listed = "; ".join(f"{name} ({bounds_s[name]:g} s): {[round(one[name], 4) for one in made]}" for name in late)
    raise AssertionError(f"never within its bound in {ATTEMPTS} attempts [s]: {listed}")
