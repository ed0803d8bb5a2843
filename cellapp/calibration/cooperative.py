"""Cooperative accuracy: the pair by every method, all on the same held-out stops.

    nominal    published chains; bases registered to the tracker
    method_1   identified geometry alone
    method_2   geometry and a network trained in the tracker frame, its output wrongly added in the base frame
    proposed   geometry and a network in the base frame (Bai et al. 2023)
    effects    geometry and the named effects

Each method identifies the inter-base transform from its own positions: from distances alone, and from the common
tracker frame as well (both bases registered to the tracker on the same stops), so that the two can be compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cellapp.calibration.circumstances import circumstances
from cellapp.calibration.evaluation import Summary, position_errors, summarise
from cellapp.calibration.pair import PAIR_NAMES, PairIdentification, distances, identify_pair
from cellapp.effects import Circumstances
from cellapp.kinematics.chain import smr_positions
from cellapp.kinematics.transforms import Array, apply, invert, register, zyx_angles
from cellapp.model import ArmModel, ResidualNetwork
from cellapp.profile import Profile
from cellapp.run import Readings


class CalibratedArm(Protocol):
    """What the pair needs to know of an arm."""

    @property
    def model(self) -> ArmModel:
        """With its network, if it has one."""

    @property
    def tracker_trained(self) -> ResidualNetwork | None:
        """The network trained in the tracker frame."""


@dataclass(frozen=True)
class PairMethod:
    """One method on the held-out stops, with either transform.

    ``errors`` are those of each held-out stop (n,) [m] by transform, signed, measured less computed;
    ``position_errors`` (n,) [m] by arm are the absolute ones of the same stops, with the bases where the arms'
    calibration put them.
    """

    by_distances: Summary
    by_tracker: Summary
    identification: PairIdentification
    T_R_L_tracker: Array
    errors: Mapping[str, Array]
    position_errors: Mapping[str, Array]


@dataclass(frozen=True)
class PairCalibration:
    """The pair by method; ``chosen`` is the transform that the profile asked for: ``distances`` or ``tracker``.

    ``stops`` are the numbers of the held-out configurations, in the order of each method's errors.
    """

    methods: Mapping[str, PairMethod]
    chosen: str
    counts: Mapping[str, int]
    stops: NDArray[np.int64]

    @property
    def T_R_L(self) -> Array:
        """The chosen transform of the best method at hand, shape (4, 4)."""
        best = next(name for name in ("effects", "proposed", "method_1") if name in self.methods)
        method = self.methods[best]
        return method.identification.T_R_L if self.chosen == "distances" else method.T_R_L_tracker

    def as_dict(self) -> dict[str, Any]:
        """For JSON: ``METHOD.cooperative_mm`` is by the chosen transform."""
        return {name: _method_dict(method, self) for name, method in self.methods.items()}


def common_stops(first: Readings, second: Readings) -> tuple[Readings, Readings]:
    """The readings of two arms at their common stops, in the same order."""
    _, i, k = np.intersect1d(first.configuration, second.configuration, return_indices=True)
    return first.take(i), second.take(k)


def pair_stops(profile: Profile, left: Readings) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the common stops that identify and that validate the pair, drawn by the profile's seed.

    Those that validate come from the arms' own validate split, so that nothing leaks.
    """
    held_out = left.in_split("validate")
    learn = np.setdiff1d(np.arange(len(left)), held_out)
    draw = np.random.default_rng([profile.seed, 0xBA5E])
    learn = np.sort(draw.permutation(learn)[: profile.splits.pair_identify])
    return learn, np.sort(draw.permutation(held_out)[: profile.splits.pair_validate])


def calibrate_pair(
    profile: Profile, readings: Mapping[str, Readings], arms: Mapping[str, CalibratedArm]
) -> tuple[PairCalibration | None, list[str]]:
    """All methods that the arms allow, or None and the reason."""
    if len(readings) != 2:
        return None, [f"pair: skipped, the profile has {len(readings)} arm(s)"]
    left, right = common_stops(*readings.values())
    learn, held_out = pair_stops(profile, left)
    if len(learn) < 7 or len(held_out) < 1:
        return None, [
            f"pair: skipped, {len(left)} common stops leave {len(learn)} to identify and {len(held_out)} to"
            " validate; 7 and 1 are needed"
        ]
    notes = []
    if len(learn) < profile.splits.pair_identify or len(held_out) < profile.splits.pair_validate:
        notes.append(f"pair: {len(learn)} stops to identify and {len(held_out)} to validate are fewer than asked for")
    both = (left, right)
    measured = np.linalg.norm(left.p_M - right.p_M, axis=1)
    models = [arm.model for arm in arms.values()]
    start = np.asarray(invert(models[1].geometry.T_M_B()) @ models[0].geometry.T_M_B())
    methods = {}
    for name, positions in _positions(both, list(arms.values())).items():
        found = identify_pair(start, positions[0][learn], positions[1][learn], measured[learn])
        T_M = [register(r.p_M[learn], p[learn]) for r, p in zip(both, positions, strict=True)]
        tracker = np.asarray(invert(T_M[1]) @ T_M[0])
        p_L, p_R = positions[0][held_out], positions[1][held_out]
        errors = {
            "distances": measured[held_out] - distances(found.T_R_L, p_L, p_R),
            "tracker": measured[held_out] - distances(tracker, p_L, p_R),
        }
        bases = [(model.nominal if name == "nominal" else model.geometry).T_M_B() for model in models]
        methods[name] = PairMethod(
            by_distances=summarise(errors["distances"]),
            by_tracker=summarise(errors["tracker"]),
            identification=found,
            T_R_L_tracker=tracker,
            errors=errors,
            position_errors={
                arm: position_errors(r.p_M[held_out], apply(T_M_B, p[held_out]))
                for arm, r, T_M_B, p in zip(readings, both, bases, positions, strict=True)
            },
        )
        if not found.converged:
            notes.append(f"pair: {name}: the inter-base transform did not converge; do not use it")
    counts = {"identify": len(learn), "validate": len(held_out)}
    return PairCalibration(methods, profile.pair.transform, counts, left.configuration[held_out]), notes


def _positions(both: tuple[Readings, Readings], arms: list[CalibratedArm]) -> dict[str, tuple[Array, Array]]:
    """SMR positions (n, 3) of both arms in their own base frames, by method."""
    left, right = both
    known = (circumstances(left, (arms[1].model, right)), circumstances(right, (arms[0].model, left)))

    def geometry_only(arm: CalibratedArm, r: Readings, known: Circumstances) -> Array:
        return smr_positions(arm.model.geometry.with_T_M_B(np.eye(4)), r.q)

    def nominal(arm: CalibratedArm, r: Readings, known: Circumstances) -> Array:
        return smr_positions(arm.model.nominal.with_T_M_B(np.eye(4)), r.q)

    def full(arm: CalibratedArm, r: Readings, known: Circumstances) -> Array:
        p_M = arm.model.predict(r.q, known=known)
        return apply(np.asarray(invert(arm.model.geometry.T_M_B())), p_M)

    def wrong_frame(arm: CalibratedArm, r: Readings, known: Circumstances) -> Array:
        network = arm.tracker_trained
        p_B = geometry_only(arm, r, known)
        return p_B if network is None else np.asarray(p_B + network.correct(r.q))

    ways = {"nominal": nominal}
    if any(arm.model.effects for arm in arms):
        ways["effects"] = full
    else:
        ways["method_1"] = geometry_only
        if any(arm.model.network is not None for arm in arms):
            ways |= {"method_2": wrong_frame, "proposed": full}
    return {name: (way(arms[0], left, known[0]), way(arms[1], right, known[1])) for name, way in ways.items()}


def _method_dict(method: PairMethod, pair: PairCalibration) -> dict[str, Any]:
    found = method.identification
    values, errors = found.values.tolist(), found.standard_errors.tolist()
    tracker = method.T_R_L_tracker
    by_tracker = [*tracker[:3, 3].tolist(), *zyx_angles(tracker[:3, :3])]
    summaries = {"distances": method.by_distances, "tracker": method.by_tracker}
    return {
        "cooperative_mm": summaries[pair.chosen].as_dict(),
        "transform": pair.chosen,
        "by_transform_mm": {name: summary.as_dict() for name, summary in summaries.items()},
        "identified": {
            name: {
                "value": value,
                "standard_error": error,
                "unit": "m" if name in "xyz" else "rad",
                "by_tracker": other,
            }
            for name, value, error, other in zip(PAIR_NAMES, values, errors, by_tracker, strict=True)
        },
        "iterations": found.iterations,
        "converged": found.converged,
        "splits": dict(pair.counts),
        "held_out": {
            "configuration": pair.stops.tolist(),
            "cooperative_mm": (np.abs(method.errors[pair.chosen]) * 1e3).tolist(),
            "position_mm": {arm: (errors * 1e3).tolist() for arm, errors in method.position_errors.items()},
        },
    }
