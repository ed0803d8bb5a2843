"""Describe a cell's tracker as the instrument of the tests, and judge beforehand which tolerances it can verify."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from cellapp.cell.driving.iso9283.findings import IsoFindings
from cellapp.cell.driving.iso9283.programme import wanted_cycles
from cellapp.estimation.discovery.plan_forecast import tracker_covariance
from cellapp.estimation.iso9283.ability import Instrument, ability
from cellapp.estimation.iso9283.norm import IsoTest
from cellapp.estimation.iso9283.places import ArmProgramme
from cellapp.estimation.iso9283.records import IsoAbility
from cellapp.estimation.uncertainty.records import Characteristic
from cellapp.ground.profile import Profile
from cellapp.ground.profile.acceptance import MPE_SHARE
from cellapp.robot.kinematics.transforms import Array

_TESTED_BY: Mapping[Characteristic, IsoTest] = {
    "pose_accuracy": "pose",
    "pose_repeatability": "pose",
    "multidirectional": "multidirectional",
    "distance_accuracy": "distance",
    "distance_repeatability": "distance",
    "drift": "drift",
}


def mpe_factor(profile: Profile) -> float:
    """Return the factor for a tracker's covariance: drivers take half of the maximum permissible error as sigma."""
    return (MPE_SHARE[profile.tolerances.mpe] / MPE_SHARE["half"]) ** 2


def abilities(profile: Profile, found: IsoFindings, tests: tuple[IsoTest, ...], cycles: int) -> list[IsoAbility]:
    """Compare each tolerance of the requested tests with the tracker's uncertainty at the arms' cubes.

    Empty if the decision rule compares only values: then every tolerance can be decided.
    """
    if profile.tolerances.decision == "simple":
        return []
    judged = {name: programme for (name, _), programme in found.programmes.items()}  # the last commands win
    compared = [one for name, own in judged.items() for one in _of_arm(profile, f"arm {name}", own, tests, cycles)]
    tolerance_m = profile.tolerances.cooperative
    if "cooperative" in tests and tolerance_m is not None:
        for pair, poses in found.pairs.items():
            both = [judged[name] for name in pair if name in judged]
            if poses and len(both) == len(pair):
                frame = np.mean([_frame(one) for one in both], axis=0)
                far_m = max(_farthest_m(one) for one in both)
                where = " and ".join(pair)
                compared.append(
                    ability("cooperative", where, _instrument(profile, frame), far_m, cycles, tolerance_m * 1e3)
                )
    return compared


# -- inside -----------------------------------------------------------------------------------------------------------


def _of_arm(
    profile: Profile, where: str, programme: ArmProgramme, tests: tuple[IsoTest, ...], cycles: int
) -> Iterator[IsoAbility]:
    instrument = _instrument(profile, _frame(programme))
    for characteristic, test in _TESTED_BY.items():
        tolerance_m = getattr(profile.tolerances, characteristic)
        if test in tests and tolerance_m is not None:
            n = wanted_cycles(test, cycles)
            yield ability(characteristic, where, instrument, _farthest_m(programme), n, tolerance_m * 1e3)


def _instrument(profile: Profile, frame: Array) -> Instrument:
    def covariance(distance_m: float) -> Array:
        along_x = np.array([[distance_m, 0.0, 0.0]])
        return np.asarray(mpe_factor(profile) * tracker_covariance(profile.tracker, along_x)[0])

    return Instrument(covariance, profile.tracker.distance[0], frame)


def _farthest_m(programme: ArmProgramme) -> float:
    return float(max(np.linalg.norm(p_M) for p_M in programme.position_M.values()))


def _frame(programme: ArmProgramme) -> Array:
    """Return the mean covariance (3, 3) [m^2] of the commanded positions, made isotropic."""
    variance = float(np.mean([np.trace(one) / 3.0 for one in programme.frame.values()]))
    return np.asarray(variance * np.eye(3))
