"""Errors that are periodic in the joint angle: one cycle a turn, or more."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

import numpy as np

from cellapp.effects.effect import PLAIN, EffectColumn, EffectContext, Law, joint_column, unknown_law
from cellapp.kinematics.transforms import Array

LINES_MAX = 210
"""The largest cycle count that is searched: twice the ratio of a 1:100 strain-wave gear, and a little beyond."""
_LARGEST = 5e-3


class EncoderEccentricity:
    """One cycle a turn: ``dq_j = (e / r) sin(q_j + phi) = A cos q_j + B sin q_j``, A and B in rad.

    A graduated disc of radius r whose centre lies e off the axis, read by one head; 2 um on 25 mm is 80 urad, 50 to
    110 um at a UR10's flange (estimate, not sourced). A gear's first-order error has exactly this shape and is not told
    apart, except by a second encoder. Visible with most of a turn of the joint; geometry takes some 40 % of it.
    Look-alikes: joint compliance, two cycles a turn over a small range.
    """

    slug = "encoder_eccentricity"
    title = "encoder eccentricity (one cycle a turn)"
    look_alikes: tuple[str, ...] = ("joint_compliance", "transmission_error")
    variables = frozenset({"q"})

    def untestable(self, context: EffectContext) -> str:
        """Joint positions are always there."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """One."""
        return [PLAIN]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each joint."""
        return _waves(context, {j: (1,) for j in range(context.joints)})


class TransmissionError:
    """Periodic error of a gear, two cycles a turn and up: ``dq_j = sum_n A_n cos n q_j + B_n sin n q_j`` [rad].

    Laws
    ----
    two
        Two cycles a turn: ovality of gear or encoder disc.
    lines
        Any cycle counts from 2 to 210, each a block of its own: a strain-wave gear of ratio N has them at N and 2 N
        cycles a turn of its output and at the beats of its flexspline.
    gear
        2, N and 2 N cycles of any joint, N being the gear ratio in ``ratio``: proposed once a line was found, as drives
        of one arm are alike.
    curve
        All counts from 2 to ``cycles`` under a prior that prefers smooth curves, for an error with too
        many components to name each. Not scanned: whoever finds that lines do not suffice proposes it.

    Size: 20 to 80 urad, 13 to 80 um at a UR10's flange (estimate; the spectrum with its components at flexspline, wave
    generator and tooth frequency is published). Two cycles: 79 % visible; many cycles: 99 %, once the cycle count is
    right, else it passes for noise. Look-alikes: eccentricity for two cycles over a small range, else nothing smooth.
    """

    slug = "transmission_error"
    title = "transmission error (two cycles a turn and up)"
    look_alikes: tuple[str, ...] = ("encoder_eccentricity", "joint_axis_wobble")
    variables = frozenset({"q"})

    def untestable(self, context: EffectContext) -> str:
        """Joint positions are always there."""
        return ""

    def laws(self, context: EffectContext) -> list[Law]:
        """Two cycles; any lines."""
        return [Law("two"), Law("lines", tried=LINES_MAX - 1)]

    def refinements(self, context: EffectContext, law: Law, names: Collection[str]) -> list[Law]:
        """Gears that the lines found so far belong to."""
        lines = {_parsed(name)[0] for name in names} - {2}
        ratios = {n for line in lines for n in (line, line // 2 if line % 2 == 0 else 0) if n > 2}
        return [Law("gear", {"ratio": float(ratio)}, LINES_MAX - 1) for ratio in sorted(ratios)]

    def columns(self, context: EffectContext, law: Law, wanted: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each cycle count of each joint; of a curve those of joints that have a ``length``."""
        joints: Collection[int] = range(context.joints)
        if law.name in ("", "two"):
            return _waves(context, {j: (2,) for j in joints})
        if law.name == "lines":
            counts = range(2, LINES_MAX + 1)
            return _waves(context, dict.fromkeys(joints, counts) if wanted is None else _parsed_all(wanted), True)
        if law.name == "gear":
            ratio = round(law.constants["ratio"])
            of_gear = sorted({2, ratio, 2 * ratio})
            return _waves(context, dict.fromkeys(joints, of_gear) if wanted is None else _parsed_all(wanted), True)
        if law.name == "curve":
            counts = range(2, round(law.constants["cycles"]) + 1)
            curved = [j for j in joints if f"length{j + 1}" in law.constants] or joints
            return _waves(context, dict.fromkeys(curved, counts) if wanted is None else _parsed_all(wanted))
        raise unknown_law(self.slug, law)


def _parsed(name: str) -> tuple[int, int]:
    """Cycle count and joint (from 0) of a name such as ``cos12q3``."""
    cycles, joint = name[3:].split("q")
    return int(cycles), int(joint) - 1


def _parsed_all(names: Collection[str]) -> dict[int, Sequence[int]]:
    """Joint (from 0) -> cycle counts of names such as ``cos12q3``."""
    found: dict[int, set[int]] = {}
    for name in names:
        cycles, joint = _parsed(name)
        found.setdefault(joint, set()).add(cycles)
    return {joint: sorted(found[joint]) for joint in sorted(found)}


@lru_cache(maxsize=8192)
def _labels(joint: int, cycles: int) -> tuple[str, str, str]:
    """Names of cosine and sine, and of the line."""
    return f"cos{cycles}q{joint + 1}", f"sin{cycles}q{joint + 1}", f"joint {joint + 1} line {cycles}"


def _waves(context: EffectContext, cycles: Mapping[int, Sequence[int]], by_line: bool = False) -> list[EffectColumn]:
    """Cosine and sine of each joint's cycle counts, a block a joint or a block a line."""
    columns = []
    for joint, counts in cycles.items():
        harmonics = _harmonics(context.q[:, joint], counts)
        for count, wave in zip(counts, harmonics, strict=True):
            cos_name, sin_name, line = _labels(joint, count)
            block = line if by_line else None
            columns.append(joint_column(cos_name, "rad", joint, wave[0], -_LARGEST, _LARGEST, block))
            columns.append(joint_column(sin_name, "rad", joint, wave[1], -_LARGEST, _LARGEST, block))
    return columns


def _harmonics(angle: Array, counts: Sequence[int]) -> Array:
    """Cosines and sines (len(counts), 2, n) of multiples of an angle (n,) [rad].

    Many of them come from powers of exp(i angle), each twice as many from those before: a product costs a tenth of a
    cosine, and rounding grows with the logarithm of the count only.
    """
    if len(counts) < 8:
        phases = np.multiply.outer(np.asarray(counts, dtype=np.float64), angle)
        return np.stack([np.cos(phases), np.sin(phases)], axis=1)
    most = max(counts)
    powers = np.empty((most, len(angle)), dtype=np.complex128)
    powers[0] = np.cos(angle) + 1j * np.sin(angle)
    have = 1
    while have < most:
        more = min(have, most - have)
        np.multiply(powers[:more], powers[have - 1], out=powers[have : have + more])
        have += more
    chosen = powers[np.asarray(counts) - 1]
    return np.stack([chosen.real, chosen.imag], axis=1)
