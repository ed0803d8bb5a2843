"""Rows of several nests on a flange: checked against each other and the profile, and merged to one reading per stop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from cellapp.estimation.nests import NestShape, NestStops, StopGroups, by_stop, fit_shape
from cellapp.estimation.nests.shape import UnseenPair, better_names, outlying
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Smr
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import Array, mean_rotation, register, rotation_vectors, rotations_of
from cellapp.robot.model.nominal import nominal_arm

_SAME_STOP_RAD = 1e-3
"""Largest difference of joint positions within one stop: encoders read 0.04 mrad more or less."""
_OFFSET_M, _DISTANCE_M = 0.01, 0.0005
"""Errors of distances between nests, by offsets and by stated distances, above which the profile is wrong [m]."""
_SIGMAS = 5.0
_TURNED_RAD = 0.35
"""Rotation of the nests relative to the nominal flange above which they are mirrored or exchanged: 20 degrees."""


def has_nests(readings: Readings) -> bool:
    """Return whether rows name several nests."""
    return readings.smr is not None and len(set(readings.smr)) > 1


def nest_offsets(smr: Smr) -> Array:
    """Return the offsets (K, 3) in F [m] of a flange's SMRs, NaN where unknown; the profile's main SMR first."""
    offsets = [smr.offset, *(nest.offset for nest in smr.nests.values())]
    return np.array([(np.nan,) * 3 if one == "unknown" else one for one in offsets])


def nest_stops(profile: Profile, arm: str, rows: Readings) -> NestStops:
    """Group rows of nests of one arm by stop. Raise ``InputError`` for a nest that the profile lacks."""
    smr = profile.arms[arm].smr
    unknown = sorted({word for word in rows.smr or () if word is not None} - set(smr.names))
    if unknown:
        raise InputError(f"arm {arm}: readings of nest {', '.join(unknown)}; its smr has {', '.join(smr.names)}")
    return by_stop(rows, smr.names, nest_offsets(smr))


def one_a_stop(profile: Profile, arm: str, rows: Readings) -> Readings:
    """Return the rows of one arm; those of several nests merged to one reading per stop."""
    return nest_stops(profile, arm, rows).readings if has_nests(rows) else rows


def nest_faults(profile: Profile, arm: str, rows: Readings) -> Iterator[tuple[int, str, str]]:
    """Yield row, column and text of each contradiction to rows being of the nests of an arm."""
    if rows.smr is None or (not has_nests(rows) and not profile.arms[arm].smr.nests):
        return
    names = profile.arms[arm].smr.names
    for row, word in enumerate(rows.smr):
        if word is not None and word not in names:
            known = f"smr has {', '.join(names)}; add it to arms.{arm}.smr.nests of the profile"
            yield row, "smr", f"'{word}' is no nest of arm {arm}: its {known}"
            return
    groups = StopGroups.of(rows, names)
    wrong = list(_not_one_stop(rows, groups))
    yield from wrong
    if wrong:
        return
    try:
        shape, misfit = fit_shape(groups)
    except UnseenPair:
        return
    for stop in np.flatnonzero(outlying(misfit)).tolist():
        others = better_names(shape, groups.p_M[stop])
        seen = [name for name, row in zip(names, groups.row[stop].tolist(), strict=True) if row >= 0]
        text = f"the nests do not stand as at other stops, by {misfit[stop] * 1e3:.2f} mm"
        if others is not None:
            text += f"; read {', '.join(others)} in place of {', '.join(seen)}: their names are exchanged"
        yield int(groups.first_rows[stop]), "smr", text
    if not outlying(misfit).any():
        yield from ((0, "smr", text) for text in _against_the_profile(profile, arm, rows, shape))


def _not_one_stop(rows: Readings, groups: StopGroups) -> Iterator[tuple[int, str, str]]:
    first = np.empty(len(rows), dtype=np.intp)
    for own in groups.row:
        first[own[own >= 0]] = own[own >= 0].min()
    apart = np.abs(rows.q - rows.q[first])
    for row in np.flatnonzero(apart.max(axis=1) > _SAME_STOP_RAD)[:1].tolist():
        joint = int(np.argmax(apart[row]))
        text = (
            f"{apart[row, joint]:.4f} rad from another row of the same stop; the arm must rest until all are measured"
        )
        yield row, f"q{joint + 1}", text
    if rows.split is not None:
        for row in [row for row, word in enumerate(rows.split) if word != rows.split[first[row]]][:1]:
            yield row, "split", f"{rows.split[row]}, but {rows.split[first[row]]} in another row of the same stop"


def _against_the_profile(profile: Profile, arm: str, rows: Readings, shape: NestShape) -> Iterator[str]:
    """Yield the contradictions between the readings and the profile about the nests."""
    smr, place = profile.arms[arm].smr, {name: number for number, name in enumerate(shape.names)}
    offsets, where = nest_offsets(smr), f"arms.{arm}.smr"
    stated: dict[tuple[str, str], tuple[float, float, str]] = {}
    for a, b in combinations(shape.names, 2):
        length = float(np.linalg.norm(offsets[place[a]] - offsets[place[b]]))
        if np.isfinite(length):
            stated[a, b] = length, _OFFSET_M, f"the offsets of {where}"
    for one in smr.distances:
        stated[one.between] = one.distance, max(_SIGMAS * one.sigma, _DISTANCE_M), f"{where}.distances"
    wrong = False
    for (a, b), (length, tolerance, who) in stated.items():
        found = float(np.linalg.norm(shape.points_S[place[a]] - shape.points_S[place[b]]))
        if abs(found - length) > tolerance:
            wrong = True
            yield (
                f"nests {a} and {b} are {found * 1e3:.2f} mm apart, {length * 1e3:.2f} mm by {who}; are names"
                " exchanged, or is the profile's value wrong?"
            )
    stations = len(set(rows.station or ("",)))
    if not wrong and stations == 1 and np.isfinite(offsets).all(axis=1).sum() >= 3 and shape.spans:
        yield from _mirrored(profile, arm, one_a_stop(profile, arm, rows))


def _mirrored(profile: Profile, arm: str, one: Readings) -> Iterator[str]:
    """Check by the nominal arm whether nests are rotated in the flange: exchanged in all rows, or offsets mirrored."""
    if one.quaternion_M is None:
        return
    nominal = nominal_arm(profile.arms[arm]).with_T_M_B(np.eye(4))
    T_M_B = register(one.p_M, smr_positions(nominal, one.q))
    rotations, _ = flange_poses(nominal.with_T_M_B(T_M_B), one.q)
    measured = np.isfinite(one.quaternion_M[:, 0])
    R_F_S = mean_rotation(rotations[measured].swapaxes(1, 2) @ rotations_of(one.quaternion_M[measured]))
    turned = float(np.linalg.norm(rotation_vectors(R_F_S[None])))
    if turned > _TURNED_RAD:
        yield (
            f"by the published arm the nests are turned by {np.degrees(turned):.0f} degrees on the flange of arm {arm};"
            " two names are exchanged in all rows, or the offsets in the profile are mirrored"
        )


def all_one_a_stop(profile: Profile, rows: Mapping[str, Readings]) -> dict[str, Readings]:
    """Return the rows of every arm, merged as by ``one_a_stop``."""
    return {arm: one_a_stop(profile, arm, its) for arm, its in rows.items()}
