"""Errors that are periodic in the joint angle: one cycle per revolution, or more."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.effects.context import EffectColumn, EffectContext, Wave, joint_column
from cellapp.robot.effects.data_driven import Quantity
from cellapp.robot.effects.effect import Effect, Meaning
from cellapp.robot.effects.law import (
    AMPLITUDE,
    AMPLITUDE_NAME,
    CYCLES,
    FIXED,
    Constant,
    InputVariable,
    Law,
    LawForm,
    SmoothLaw,
    circle_variances,
    with_prior_sd,
)
from cellapp.robot.effects.modulation import TermInput
from cellapp.robot.kinematics.transforms import Array

LINES_MAX = 210
"""Largest cycle count to search: twice the ratio of a 1:100 strain-wave gear, and a margin."""
_LARGEST = 5e-3
"""Bound of each amplitude [rad]: sixty times what a graduated disc 2 µm off its axis gives."""
_MANY = 8
"""Cycle counts from which powers of exp(i angle) are faster than a cosine each."""

LINES_BESIDE_MAX = 2 * LINES_MAX
"""Largest cycle count of a line beside free curves: four for each turn of a motor."""
GEAR_RATIO = Constant("ratio", "", FIXED, "ratio {}")
CURVE_LENGTH = Constant("length", "rad", FIXED, per_joint=True)
"""Correlation length of a joint's curve; its amplitude is the next constant. The search sets both by the evidence."""
CURVE_AMPLITUDE = Constant(AMPLITUDE_NAME, "rad", FIXED, per_joint=True)
LINE_AMPLITUDE = Constant("lines", "rad", FIXED, optional=True)
"""Standard deviation of the prior of the lines beside curves."""
ENCODER_LINES = (128, 256)
"""Cycle counts of these lines: absolute encoders have a power of two of periods a turn, and their interpolation error
repeats in each period."""

TWO = LawForm("two", "two cycles per revolution")
LINES = LawForm("lines", "single lines of the spectrum")
GEAR = LawForm("gear", "two cycles per revolution and the lines of a gear", (GEAR_RATIO,))
CURVE = LawForm("curve", "a free curve for each joint", (CYCLES, CURVE_LENGTH, CURVE_AMPLITUDE, LINE_AMPLITUDE))


ONE = LawForm("", "one cycle per revolution")
ONE_SMOOTH = LawForm("smooth", "one cycle per revolution, small by prior", (AMPLITUDE,))
TILTED = LawForm("tilted", "one cycle per revolution, and fewer than a third as much of two")


class EncoderEccentricity(Effect):
    """One cycle per revolution: ``dq_j = (e / r) sin(q_j + phi) = A cos q_j + B sin q_j``, A and B in rad.

    A graduated disc of radius r whose centre is e off the axis, read by one head; 2 µm on 25 mm is 80 µrad, 50 to
    110 µm at a UR10's flange (estimate, not sourced). A gear's first-order error has exactly this shape; only a second
    encoder distinguishes them. Visible with most of a turn of the joint; geometry takes some 40 % of it. A disc that is
    tilted by t, too, looks elliptic to its head: two cycles of ``tan^2(t / 2)`` beside (``tilted``, of recordings).
    Confounded: joint compliance, two cycles per revolution over a small range.
    """

    slug = "encoder_eccentricity"
    wears = True
    title = "encoder eccentricity (one cycle per revolution)"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The disc or magnet ring of the encoder of {place} is off the axis; a first-order error of the gear has
          the same shape.
        size (estimate): 2 µm on a radius of 25 mm are 80 µrad, 50 to 110 µm at the flange of a UR10
        check: After a repair of {place}, check how the encoder disc is centred. A stable error needs no repair.
        settle: Move {place} alone through a whole revolution in steps of 10 degrees.
        settle: Log both encoders of {place}: an eccentric disc shows in one only."""
    )
    confounded = ("joint_compliance", "transmission_error")
    variables = frozenset({InputVariable.JOINT_ANGLE})
    forms = (ONE, ONE_SMOOTH, TILTED)

    def smooth_laws(self, context: EffectContext) -> list[SmoothLaw]:
        """One cycle per revolution, at any amplitude."""
        return [SmoothLaw("smooth", 5e-5)]

    def laws(self, context: EffectContext) -> list[Law]:
        """Free amplitudes."""
        return [ONE.law()]

    discrepancy_inputs = (TermInput(Quantity.JOINT_ANGLE),)

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each joint; of a tilted disc those of both cycle counts."""
        if law.form == TILTED:
            both = dict.fromkeys(range(context.joints), (1, 2))
            return _waves(context, both if names is None else _counts_of(names, context.joints))
        columns = _waves(context, {j: (1,) for j in range(context.joints)})
        if law.form == ONE_SMOOTH:
            return [with_prior_sd(column, law.constants[AMPLITUDE.name]) for column in columns]
        return columns


class TransmissionError(Effect):
    """Periodic error of a gear, two cycles per revolution and up: ``dq_j = sum_n A_n cos n q_j + B_n sin n q_j`` [rad].

    Laws
    ----
    two
        Two cycles per revolution: ovality of gear or encoder disc.
    lines
        Any cycle counts from 2 to 210, each a block of its own: a strain-wave gear of ratio N has them at N and 2 N
        cycles per revolution of its output and at the beats of its flexspline.
    gear
        2, N and 2 N cycles of any joint, N being the gear ratio in ``ratio``: proposed once a line was found, as drives
        of one arm are alike.
    curve
        All counts from 2 to ``cycles`` under a prior that prefers smooth curves, for an error with too many components
        to name each. Not scanned: the search proposes it where lines are not sufficient.

    Size: 20 to 80 µrad, 13 to 80 µm at a UR10's flange (estimate; the spectrum with its components at flexspline, wave
    generator and tooth frequency is published). Two cycles: 79 % visible; many cycles: 99 %, once the cycle count is
    right, else it passes for noise. Confounded: eccentricity for two cycles over a small range, else nothing smooth.
    """

    slug = "transmission_error"
    title = "transmission error (two cycles per revolution and up)"
    arm_bound = True
    meaning = Meaning.of(
        """cause: The gear of {place} runs unevenly: an oval flexspline gives two cycles per revolution, the wave
          generator one or two of the motor, the teeth more.
        size (estimate): 20 to 80 µrad, 13 to 80 µm at the flange of a UR10
        check: Compare with earlier runs: a line that grew is wear; plan an exchange of the gear of {place}. A stable
          error needs no repair.
        check: Check the oil or grease interval of {place}.
        settle: Move {place} alone in steps of 0.1 degrees over 10 degrees.
        settle: Add stops over a whole revolution of {place}.
        settle: Read the encoders with all their digits."""
    )
    confounded = ("encoder_eccentricity", "joint_axis_wobble", "joint_axis_runout")
    variables = frozenset({InputVariable.JOINT_ANGLE})
    forms = (TWO, LINES, GEAR, CURVE)
    discrepancy_inputs = (TermInput(Quantity.JOINT_ANGLE),)

    def laws(self, context: EffectContext) -> list[Law]:
        """Two cycles; any lines."""
        return [TWO.law(), LINES.law(tried=LINES_MAX - 1)]

    def refinements(self, context: EffectContext, law: Law, names: Collection[str]) -> list[Law]:
        """Gears that the lines found so far may belong to: a line is at the ratio or at twice that."""
        lines = {count for counts in _counts_of(names, context.joints).values() for count in counts} - {2}
        ratios = {n for line in lines for n in (line, line // 2 if line % 2 == 0 else 0) if n > 2}
        return [GEAR.law({GEAR_RATIO.name: float(ratio)}, LINES_MAX - 1) for ratio in sorted(ratios)]

    def columns(self, context: EffectContext, law: Law, names: Collection[str] | None = None) -> list[EffectColumn]:
        """Cosine and sine of each cycle count of each joint; of a curve those of joints that have a length."""
        joints = range(context.joints)
        if law.form == TWO:
            return _waves(context, {j: (2,) for j in joints})
        if law.form == CURVE:
            return _curves(context, law, names)
        if names is not None:
            return _waves(context, _counts_of(names, context.joints), by_line=True)
        if law.form == LINES:
            return _waves(context, dict.fromkeys(joints, range(2, LINES_MAX + 1)), by_line=True)
        ratio = round(law.constants[GEAR_RATIO.name])
        return _waves(context, dict.fromkeys(joints, sorted({2, ratio, 2 * ratio})), by_line=True)


def curve_prior(law: Law, joints: int) -> dict[int, tuple[float, float]]:
    """Length and amplitude [rad] of each joint's prior (joints from 0) of a law of free curves; else empty."""
    return {
        j: (law.constants[CURVE_LENGTH.key(j)], law.constants[CURVE_AMPLITUDE.key(j)])
        for j in range(joints)
        if law.form == CURVE and CURVE_LENGTH.key(j) in law.constants
    }


def _curves(context: EffectContext, law: Law, names: Collection[str] | None) -> list[EffectColumn]:
    """Waves of the joints' curves with their priors; lines beyond the curves' cycles have none."""
    cycles, prior = round(law.constants[CYCLES.name]), curve_prior(law, context.joints)
    lines = ENCODER_LINES if LINE_AMPLITUDE.name in law.constants else ()
    every = (*range(2, cycles + 1), *lines)
    counts = dict.fromkeys(prior, every) if names is None else _counts_of(names, context.joints)
    sd = {j: amplitude * np.sqrt(circle_variances(length, cycles)) for j, (length, amplitude) in prior.items()}
    beside = law.constants.get(LINE_AMPLITUDE.name, math.inf)
    return _waves(context, counts, sd={joint: values.tolist() for joint, values in sd.items()}, beside=beside)


@lru_cache(maxsize=8192)
def _line(joint: int, cycles: int) -> tuple[str, tuple[tuple[str, Wave], ...]]:
    """Name of a line, and names and waves of its cosine and sine; cached, as a scan makes thousands of them."""
    waves = (
        (f"cos{cycles}q{joint + 1}", Wave(cycles, sine=False)),
        (f"sin{cycles}q{joint + 1}", Wave(cycles, sine=True)),
    )
    return f"joint {joint + 1} line {cycles}", waves


@lru_cache(maxsize=8)
def _by_name(joints: int) -> Mapping[str, tuple[int, int]]:
    """Joint (from 0) and cycle count of every column name; twice the search range, as gears reach that far."""
    return {
        name: (joint, count)
        for joint in range(joints)
        for count in range(1, LINES_BESIDE_MAX + 1)
        for name, _ in _line(joint, count)[1]
    }


def _counts_of(names: Collection[str], joints: int) -> dict[int, Sequence[int]]:
    """Joint (from 0) -> cycle counts of some column names."""
    known = _by_name(joints)
    found: dict[int, set[int]] = {}
    for name in names:
        if name not in known:
            raise ValueError(f"'{name}' is not a periodic error of one of {joints} joints")
        joint, count = known[name]
        found.setdefault(joint, set()).add(count)
    return {joint: sorted(found[joint]) for joint in sorted(found)}


def _waves(
    context: EffectContext,
    cycles: Mapping[int, Sequence[int]],
    by_line: bool = False,
    sd: Mapping[int, Sequence[float]] | None = None,
    beside: float = math.inf,
) -> list[EffectColumn]:
    """Cosine and sine of each joint's cycle counts, a block per joint or a block per line.

    ``sd`` are the standard deviations of the priors of each joint's counts from 1, ``beside`` that of counts beyond.
    """
    columns = []
    for joint, counts in cycles.items():
        harmonics = _harmonics(context.q[:, joint], counts)
        priors = () if sd is None else sd.get(joint, ())
        for count, values in zip(counts, harmonics, strict=True):
            line, waves = _line(joint, count)
            prior = priors[count - 1] if count <= len(priors) else beside
            block = line if by_line else None
            for (name, wave), offset in zip(waves, values, strict=True):
                columns.append(
                    joint_column(name, "rad", joint, offset, -_LARGEST, _LARGEST, block, wave=wave, prior_sd=prior)
                )
    return columns


def _harmonics(angle: Array, counts: Sequence[int]) -> Array:
    """Cosines and sines (len(counts), 2, n) of multiples of an angle (n,) [rad].

    Many of them come from powers of exp(i angle).
    """
    if len(counts) < _MANY:
        phases = np.multiply.outer(np.asarray(counts, dtype=np.float64), angle)
        return np.stack([np.cos(phases), np.sin(phases)], axis=1)
    chosen = angle_powers(angle, max(counts))[np.asarray(counts)]
    return np.stack([chosen.real, chosen.imag], axis=1)


def angle_powers(angle: Array, most: int) -> NDArray[np.complex128]:
    """Powers (most + 1, n) of exp(i angle) from 0, doubled in number at each step.

    A product costs a tenth of a cosine, and rounding grows only with the logarithm of the count.
    """
    powers = np.empty((most + 1, len(angle)), dtype=np.complex128)
    powers[0], powers[1] = 1.0, np.cos(angle) + 1j * np.sin(angle)
    have = 1
    while have < most:
        more = min(have, most - have)
        np.multiply(powers[1 : more + 1], powers[have], out=powers[have + 1 : have + more + 1])
        have += more
    return powers
