"""What moved between two calibrations of one arm: differences of its geometric parameters and their uncertainty.

The covariance of an estimate includes what its priors leave open, so that single parameters of a redundant chain have
large standard errors. Compared are the combinations that the data of the first calibration determine: each kept
parameter with the shares of those that are merged into it.

The geometry of a run is that at its mean temperatures. Between runs at different ones links grow, which is no change of
the arm: lengths have an uncertainty for it. The zero of a joint that drifts within a run is of the day and not tested,
nor are base and tool, which a person may move.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import scipy

from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import BASE_NAMES, PROBE_NAMES, TOOL_NAMES, JointAngles, jacobian, parameter_unit
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.model import ArmModel

MODEL_CHOICE = 1.25
"""Factor on standard errors of differences. They hold for the effects that were named; a weak effect that one run names
and another does not moves the geometry a little. Over unchanged twins with other plans the differences scatter 0.8 to
1.25 times as widely as the standard errors say."""
EXPANSION = 23e-6
"""Standard uncertainty of how much a length grows from run to run [1/K]: the expansion of aluminium, the largest of the
usual materials of arms."""
HOUSING_M = 0.1
"""Least length that grows with a length of the chain [m]: the housing of a joint, where the chain's own is nearly 0."""
_CONFIGURATIONS = 64
"""Number of configurations to average the displacement by a parameter: its rms is known to a tenth."""


@dataclass(frozen=True)
class CalibratedArm:
    """One arm as one run identified it.

    Attributes
    ----------
    model : ArmModel
        With a covariance.
    determined : tuple of str
        Parameters of the geometry that the data determine.
    merged : mapping
        Parameter that they do not determine -> those that take its place, and their shares.
    degrees_of_freedom : int
    temperatures_c : mapping
        Mean temperatures over the readings: of the "air", and of "joint 1" and so on, where known.
    """

    model: ArmModel
    determined: tuple[str, ...]
    merged: Mapping[str, Mapping[str, float]]
    degrees_of_freedom: int
    temperatures_c: Mapping[str, float]

    @property
    def identified(self) -> list[str]:
        """Identified parameters of the geometry, in the order of the covariance."""
        names = set(self.model.geometry.names)
        return list(takewhile(names.__contains__, self.model.identified))


@dataclass(frozen=True)
class Determined:
    """A parameter that the data determine: its estimate, and the length [m] that grows with it, 0 for an angle."""

    value: float
    standard_error: float
    length_m: float = 0.0


@dataclass(frozen=True)
class Difference:
    """A parameter in two calibrations [m, rad].

    ``difference`` is the later less the first; ``chance`` that of a difference as large without a change, None where
    it is not tested. ``moved_m`` is the rms displacement of the SMR by the difference.
    """

    name: str
    first: Determined
    later: Determined
    difference: float
    standard_uncertainty: float
    chance: float | None
    moved_m: float

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return parameter_unit(self.name)


def differences(first: CalibratedArm, later: CalibratedArm) -> list[Difference]:
    """Differences of two independent calibrations of one arm (JCGM 100:2008, 5.1.2), of all parameters that both have.

    ``u^2 = MODEL_CHOICE^2 (u_first^2 + u_later^2) + (EXPANSION length dT)^2``, chances by Student's t.
    """
    before, after = determined_values(first, first), determined_values(later, first)
    warmer_K, freedom = _warmer_K(first, later), max(1, min(first.degrees_of_freedom, later.degrees_of_freedom))
    untested = {*BASE_NAMES, *TOOL_NAMES, *PROBE_NAMES, *_drifting_zeros(first), *_drifting_zeros(later)}
    levers = _levers(first, list(after))
    found = []
    for name, own in after.items():
        difference = own.value - before[name].value
        if parameter_unit(name) == "rad":
            difference = math.remainder(difference, math.tau)  # an angle near half a turn may have either sign
        estimated = MODEL_CHOICE * math.hypot(own.standard_error, before[name].standard_error)
        uncertainty = math.hypot(estimated, EXPANSION * own.length_m * warmer_K)
        tested = name not in untested and 0.0 < uncertainty < math.inf
        chance = 2.0 * float(scipy.special.stdtr(freedom, -abs(difference / uncertainty))) if tested else None
        moved_m = levers[name] * abs(difference)
        found.append(Difference(name, before[name], own, difference, uncertainty, chance, moved_m))
    return found


def combinations(arm: CalibratedArm, first: CalibratedArm) -> tuple[list[str], Array, Array, Array]:
    """Compute the combinations that the data of the ``first`` calibration determine, in another one.

    Return their k names, the shares (k, K) in them of the other's parameters, values (k,) and covariance (k, k).
    Parameters that the other did not estimate are left out.
    """
    names = arm.identified
    place = {name: k for k, name in enumerate(names)}
    kept = [name for name in first.determined if name in place]
    shares = np.zeros((len(kept), len(names)))
    for row, name in enumerate(kept):
        shares[row, place[name]] = 1.0
        for dropped, takers in first.merged.items():
            if dropped in place:
                shares[row, place[dropped]] = takers.get(name, 0.0)
    in_chain = [arm.model.geometry.names.index(name) for name in names]
    value, nominal = arm.model.geometry.vector()[in_chain], arm.model.nominal.vector()[in_chain]
    values = shares @ (value - nominal) + nominal[[place[name] for name in kept]]
    assert arm.model.covariance is not None
    return kept, shares, values, shares @ arm.model.covariance[: len(names), : len(names)] @ shares.T


def determined_values(arm: CalibratedArm, first: CalibratedArm) -> dict[str, Determined]:
    """Compute the ``combinations`` by name, with their standard errors and the lengths that grow with them."""
    kept, shares, values, covariance = combinations(arm, first)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    nominal = dict(zip(arm.model.nominal.names, arm.model.nominal.vector().tolist(), strict=True))
    grows = [0.0 if parameter_unit(one) == "rad" else max(abs(nominal[one]), HOUSING_M) for one in arm.identified]
    lengths = np.abs(shares) @ grows * [parameter_unit(name) == "m" for name in kept]
    found = zip(kept, values.tolist(), errors.tolist(), lengths.tolist(), strict=True)
    return {name: Determined(value, error, length) for name, value, error, length in found}


def _warmer_K(a: CalibratedArm, b: CalibratedArm) -> float:
    """Largest difference of the mean temperatures of two runs [K], of the air or of a joint; 0 where none is known."""
    common = a.temperatures_c.keys() & b.temperatures_c.keys()
    return max((abs(a.temperatures_c[where] - b.temperatures_c[where]) for where in common), default=0.0)


def _drifting_zeros(arm: CalibratedArm) -> set[str]:
    """Zeros of joints that drift within a run: of joint 3 by ``drift3``, or where it wanders ``drift3_1``."""
    return {
        f"theta{joint}"
        for term in arm.model.effects
        if EFFECTS[term.slug].shifts_zero
        for name in term.names
        for joint in re.findall(r"^\D+(\d+)", name)
    }


def _levers(arm: CalibratedArm, names: list[str]) -> dict[str, float]:
    """Rms displacement of the SMR [m] by one unit of each parameter of the nominal arm, over all joint angles."""
    geometry = arm.model.nominal
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_CONFIGURATIONS, geometry.joints))
    columns = tuple(geometry.names.index(name) for name in names)
    _, J = jacobian(geometry, JointAngles.of(q), columns)
    return dict(zip(names, np.sqrt(np.mean(np.sum(J**2, axis=0), axis=1)).tolist(), strict=True))
