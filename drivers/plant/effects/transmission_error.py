"""Transmission error of strain-wave drives: a few spectral lines from couplings, or a broadband periodic curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import JOINTS, NUMBERS, Factory, Offset, Parameters, PlantEffect, Situation, made, on_joints
from drivers.plant.mechanism import Deflection


def cardan(angle: Array, slant: Array) -> Array:
    """Return the angle error of a universal joint at shaft ``angle`` with its output inclined by ``slant`` [rad].

    ``tan(out) = tan(angle) / cos(slant)``: two cycles per revolution, amplitude ``tan^2(slant / 2)``.
    """
    out: Array = np.arctan2(np.sin(angle), np.cos(angle) * np.cos(slant))
    return (out - angle + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True, eq=False)
class StrainWaveGear(PlantEffect):
    """Motor, coupling, wave generator, gear of ratio N and output flange, each with a periodic error.

    The motor is at N times the reported angle. The coupling to the wave generator is eccentric by a fraction of its
    radius (N cycles per revolution of the joint, amplitude ``eccentric / N``) and inclined (2 N cycles); behind the
    gear the output is inclined (2 cycles). Published spectra have lines at these frequencies [secondary]; sizes are
    estimates, 20 to 60 urad.
    """

    joints: np.ndarray
    ratio: Array
    eccentric: Array
    eccentric_phase: Array
    coupling_slant: Array
    coupling_phase: Array
    output_slant: Array
    output_phase: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        joint = situation.q[:, self.joints]
        motor = self.ratio * joint
        pin = motor + self.eccentric_phase
        generator = motor + np.arctan2(self.eccentric * np.sin(pin), 1.0 + self.eccentric * np.cos(pin))
        generator = generator + cardan(generator + self.coupling_phase, self.coupling_slant)
        behind = generator / self.ratio
        behind = behind + cardan(behind + self.output_phase, self.output_slant)
        return on_joints(situation, self.joints, behind - joint)


def _error_curve(situation: Situation, joints: np.ndarray, curves: Array) -> Deflection:
    """A smooth periodic error of each joint, like those measured with an autocollimator.

    The curve interpolates knots of a random process that contains only the configured range of cycles.
    """
    offsets = np.zeros_like(situation.q)
    knots = curves.shape[1]
    for row, joint in zip(curves, joints, strict=True):
        place = (situation.q[:, joint] / (2.0 * np.pi)) % 1.0 * knots
        first = np.floor(place).astype(int)
        f = place - first
        before, left, right, after = (row[(first + k) % knots] for k in (-1, 0, 1, 2))
        # Catmull-Rom spline through the knots
        square = 2.0 * before - 5.0 * left + 4.0 * right - after
        cube = 3.0 * (left - right) + after - before
        offsets[:, joint] = left + 0.5 * f * (right - before + f * (square + f * cube))
    return Deflection(joints=offsets)


@dataclass(frozen=True, eq=False)
class MeshingGears(PlantEffect):
    """Lines of two gear stages; the output's run-out modulates the amplitude of the first.

    The generator's line of ``ratio`` cycles per revolution has the amplitude ``line (1 + depth cos(q + depth_phase))``,
    which is a line with a sideband on either side. The second stage has a line of ``second_cycles`` per revolution,
    which need not be an integer, and one of twice that with half the amplitude.
    """

    joints: np.ndarray
    ratio: Array
    line: Array
    line_phase: Array
    depth: Array
    depth_phase: Array
    second_cycles: Array
    second: Array
    second_phase: Array

    def offset(self, situation: Situation, memory: Array | None) -> Deflection:
        joint = situation.q[:, self.joints]
        swell = 1.0 + self.depth * np.cos(joint + self.depth_phase)
        mesh = self.second_cycles * joint + self.second_phase
        first = self.line * swell * np.sin(self.ratio * joint + self.line_phase)
        return on_joints(situation, self.joints, first + self.second * (np.sin(mesh) + 0.5 * np.sin(2.0 * mesh)))


_KNOTS = 1440
"""Knots per revolution: at least ten per cycle of the highest frequency allowed."""


def _random_curve(rng: np.random.Generator, rms: float, lowest: int, highest: int) -> Array:
    spectrum = np.zeros(_KNOTS // 2 + 1, dtype=np.complex128)
    cycles = np.arange(lowest, highest + 1)
    samples = rng.standard_normal((2, len(cycles)))
    spectrum[cycles] = (samples[0] + 1j * samples[1]) / np.sqrt(cycles)
    curve = np.fft.irfft(spectrum, _KNOTS)
    scaled: Array = curve * (rms / np.sqrt((curve**2).mean()))
    return scaled


def _below_one(parameters: Parameters, key: str) -> Array:
    values = parameters.numbers(key, least=0.0)
    if (values >= 1.0).any():
        raise parameters.error(key, f"must be less than 1, not {values.max():g}")
    return values


def _curve(parameters: Parameters) -> PlantEffect:
    parameters.require("joints", "rms", "seed", "lowest", "highest")
    joints = parameters.joint_numbers("joints")
    lowest, highest = parameters.integer("lowest", least=2), parameters.integer("highest", least=2)
    if not lowest <= highest <= _KNOTS // 10:
        raise parameters.error("highest", f"must be from lowest, {lowest}, to {_KNOTS // 10}, not {highest}")
    sizes, rng = parameters.numbers("rms", least=0.0), np.random.default_rng(parameters.integer("seed", least=0))
    curves = np.array([_random_curve(rng, size, lowest, highest) for size in sizes])
    return Offset(_error_curve, {"joints": joints, "curves": curves})


_GEARS = ("ratio", "line", "line_phase", "depth", "depth_phase", "second_cycles", "second", "second_phase")
_MODES: Mapping[str, Factory] = {
    "lines": made(
        StrainWaveGear,
        joints=JOINTS,
        ratio=partial(NUMBERS, least=1.0),
        **dict.fromkeys(("eccentric", "coupling_slant", "output_slant"), _below_one),
        **dict.fromkeys(("eccentric_phase", "coupling_phase", "output_phase"), NUMBERS),
    ),
    "curve": _curve,
    "meshing": made(MeshingGears, joints=JOINTS, **dict.fromkeys(_GEARS, NUMBERS)),
}


def transmission_error(parameters: Parameters) -> PlantEffect:
    """Build transmission error. ``mode`` lines, curve or meshing, ``joints``: numbers from 1.

    lines: for each joint ``ratio``; ``eccentric`` [m/m] and ``coupling_slant`` [rad] of the wave generator's coupling,
    ``output_slant`` [rad], each with its phase (``eccentric_phase``, ``coupling_phase``, ``output_phase``) [rad].
    curve: ``rms`` [rad] of each joint, ``seed``, ``lowest`` and ``highest`` cycles per revolution.
    meshing: for each joint ``ratio``, ``line`` [rad], ``line_phase``; ``depth`` (0 to 1) and ``depth_phase`` of its
    modulation; ``second_cycles``, ``second`` [rad] and ``second_phase`` of another stage.
    """
    mode = parameters.choice("mode", *_MODES)
    return _MODES[mode](parameters.without("mode"))
