"""Dominant cycles a turn of periodic joint errors, from the power of their Fourier coefficients."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from cellapp.kinematics.transforms import Array

WAVE = re.compile(r"(cos|sin)(\d+)q(\d+)")
"""Name of a Fourier coefficient: function, cycles a turn, joint from 1."""
_BAND = (0.1, 0.9)
"""Shares of the cumulated power between which the dominant cycles lie: the middle 80 %."""


def dominant_cycles(names: Sequence[str], values: Array) -> dict[str, dict[str, float]]:
    """Dominant cycles a turn of each joint (key: its number) from coefficients named as ``cos12q3`` [rad].

    ``from`` and ``to`` enclose the middle 80 % of the power, ``peak`` has most of it; ``rms_urad`` is over a whole
    turn.
    """
    power: dict[str, dict[int, float]] = {}
    for name, value in zip(names, values.tolist(), strict=True):
        parsed = WAVE.fullmatch(name)
        if parsed is not None:
            of_joint = power.setdefault(parsed[3], {})
            count = int(parsed[2])
            of_joint[count] = of_joint.get(count, 0.0) + 0.5 * value**2
    return {joint: _band(power[joint]) for joint in sorted(power, key=int) if any(power[joint].values())}


def _band(power: dict[int, float]) -> dict[str, float]:
    counts = sorted(power)
    each = np.array([power[count] for count in counts])
    share = np.cumsum(each) / each.sum()
    first, last = (counts[min(int(np.searchsorted(share, at)), len(counts) - 1)] for at in _BAND)
    rms = float(np.sqrt(each.sum()))
    return {"from": first, "to": last, "peak": counts[int(np.argmax(each))], "rms_urad": rms * 1e6}
