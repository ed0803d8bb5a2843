"""Ticks of logarithmic axes, the same on the page and in the terminal."""

from __future__ import annotations

import math

_MULTIPLES = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
"""Multiples of each decade that are ticks, from sparse to dense."""
_ENOUGH = 3
_SAME = 1e-12
"""Relative tolerance for a tick at an end of the axis."""


def log_ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most ``most`` round values from ``low`` to ``high``, ascending; empty if the range has too few of them.

    Use the sparsest series with at least three values, if there is one: whole decades, else 1 and 3 of each, 1, 2 and
    5, and so on. Of many decades take every second or third one.
    """
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ends = low * (1.0 - _SAME), high * (1.0 + _SAME)
    options = [
        [tick for power in powers for factor in multiples if ends[0] <= (tick := float(f"{factor}e{power}")) <= ends[1]]
        for multiples in _MULTIPLES
    ]
    if len(options[0]) > most:
        return options[0][:: math.ceil(len(options[0]) / most)]
    fitting = [ticks for ticks in options if 2 <= len(ticks) <= most]
    fitting = fitting or [ticks[:: math.ceil(len(ticks) / most)] for ticks in options if len(ticks) > most][:1]
    return next((ticks for ticks in fitting if len(ticks) >= _ENOUGH), fitting[-1] if fitting else [])
