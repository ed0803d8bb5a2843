"""Programme of the tests: the commands of an arm, and which positions the arms visit in which order.

Fit base and SMR of an arm in the tracker frame to a few measured positions, with the published geometry.

Without a calibration the position of the arm's base frame is unknown, so that accuracy relative to it cannot be stated.
The six parameters of the base and the three of the SMR's offset are fitted to positions that are not poses of the test.
Errors of the published geometry remain in the residuals, from which the covariance of the fit is estimated.

Cube, plane and poses of one arm: the largest cube whose poses, and motions between them, the gate accepts.

Find the largest test cube of an arm: reachable with one orientation, free of collisions, visible to the tracker.

Seeds are admissible, visible configurations, each rotated so that its SMR faces the tracker. From each seed the joint
positions are continued over a lattice of positions along the axes of the arm's base, with the seed's orientation, as
far as all constraints hold: so all poses are on one branch of the inverse kinematics, whatever the chain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.safety.cell_bodies import clear_with_others, visible_with_others
from cellapp.cell.safety.gate import CellBodies, refuse_motion, visible_stops, with_margin_for_ways
from cellapp.cell.targets.branches import LARGEST_CORRECTION, admissible_configurations
from cellapp.estimation.calibration.identification import identify, start_from_nominal
from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.estimation.calibration.quantities import with_probe
from cellapp.estimation.discovery.plan_forecast import nominal_model
from cellapp.estimation.iso9283.characteristics import (
    CYCLE,
    DIRECTIONAL_POSES,
    DIRECTIONS,
    PLANES,
    POSES,
    lattice_cube,
    pose_positions,
)
from cellapp.estimation.iso9283.evaluate import ArmProgramme, IsoPlace
from cellapp.estimation.iso9283.norm import IsoCommands
from cellapp.estimation.iso9283.records import IsoCube, IsoPose
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.chain import Geometry, JointAngles, flange_poses, frame_poses, jacobian, parameter_names
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    rms_length,
    rotation_from_vector,
    rotations_of,
    rpy_of,
    xyz_of,
)
from cellapp.robot.kinematics.transforms import invert as inverse_transform
from cellapp.robot.model import ArmModel, CellModel
from cellapp.robot.model.inverse import invert, with_approach
from cellapp.robot.model.nominal import nominal_arm
from drivers.trackers.protocol import Point

ALIGNMENT_POSITIONS = 20
"""Number of measured positions: sixty coordinates for nine parameters."""
FEWEST_POSITIONS = 6
_KNOWN_BEFORE = 1e-4
"""Prior information relative to the best of one position: it keeps the criterion finite before the first one."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of the fit for one arm.

    Attributes
    ----------
    arm : ArmModel
        The published chain with the fitted base and SMR offset; it has no other model.
    columns : tuple of int
        Indices of the fitted parameters in ``parameter_names``.
    covariance : array, shape (9, 9)
    rms_m : float
        Root mean square distance of the measured from the fitted positions [m].
    n : int
        Number of positions.
    """

    arm: ArmModel
    columns: tuple[int, ...]
    covariance: Array
    rms_m: float
    n: int

    def position_covariance(self, q: Array) -> Array:
        """Return the fit's covariance (n, 3, 3) [m^2] of positions commanded with ``q`` (n, N) [rad]."""
        _, J = jacobian(self.arm.geometry, JointAngles.of(q), self.columns)
        return np.asarray(np.einsum("akn,kl,bln->nab", J, self.covariance, J))


def published_cell(profile: Profile, found: Mapping[str, Alignment]) -> CellModel:
    """Return the published chains, with fitted bases and SMRs if ``found``, else as the profile states them.

    Raise ``InputError`` if the profile does not state where arms and tracker are, or an arm has no home position.
    """
    return CellModel(
        {name: found[name].arm if name in found else nominal_model(profile, name) for name in profile.arms}
    )


def base_and_tool(joints: int) -> tuple[int, ...]:
    """Return the indices of the fitted parameters, rotations of the base first."""
    count = len(parameter_names(joints))
    return (*range(3, 6), *range(3), *range(count - 3, count))


def alignment_configurations(
    cell: CellBodies, homes: Mapping[str, Array], name: str, geometry: Geometry, seed: int
) -> Array:
    """Choose configurations (n, N) [rad] with most information about base and SMR, the other arms at home.

    Candidates are clear and visible. Selection is greedy by the determinant of the information matrix (D-optimal).
    """
    liked = admissible_configurations(cell, homes, name, seed)
    if not len(liked):
        return liked
    _, J = jacobian(geometry, JointAngles.of(liked), base_and_tool(geometry.joints))
    J = J.transpose(2, 0, 1)
    scale = np.sqrt(np.einsum("nak,nak->k", J, J) / len(J))
    J = J / np.where(scale > 0.0, scale, 1.0)
    information = _KNOWN_BEFORE * np.eye(J.shape[2])
    remaining = np.ones(len(liked), dtype=bool)
    chosen: list[int] = []
    while len(chosen) < min(ALIGNMENT_POSITIONS, len(liked)):
        gain = np.linalg.slogdet(np.eye(3) + J @ np.linalg.solve(information, J.transpose(0, 2, 1)))[1]
        best = int(np.argmax(np.where(remaining, gain, -np.inf)))
        chosen.append(best)
        remaining[best] = False
        information = information + J[best].T @ J[best]
    return np.asarray(liked[chosen])


def align(profile: Profile, name: str, q: Array, points: Sequence[Point]) -> Alignment:
    """Fit base and SMR offset of an arm to points measured at ``q`` (n, N) [rad].

    The rotation of a probe on the flange is the mean of the orientations, where measured, relative to the fit. Raise
    ``InputError`` for fewer than six positions.
    """
    if len(q) < FEWEST_POSITIONS:
        raise InputError(
            f"iso9283: arm {name}: {counted(len(q), 'position was', 'positions were')} measured to find its base"
            f" and SMR, at least {FEWEST_POSITIONS} are needed; look for a covered SMR, or calibrate the cell first"
        )
    arm, p_M, R_M_S = profile.arms[name], np.array([one.p_M for one in points]), None
    if any(one.quaternion_M is not None for one in points):
        R_M_S = rotations_of([np.full(4, np.nan) if one.quaternion_M is None else one.quaternion_M for one in points])
    start = start_from_nominal(nominal_arm(arm), q, p_M, tool_unknown=arm.smr.offset == "unknown")
    columns = base_and_tool(start.joints)
    found = identify(start, q, p_M, parameter_set=ParameterSet("base and SMR", start.joints, columns))
    found = found.settled(f"fit of the base and SMR of arm {name}")
    geometry = with_probe(found.geometry, q, R_M_S)
    model = replace(nominal_model(profile, name), geometry=geometry, nominal=geometry)
    rms_m = rms_length(found.residuals)
    return Alignment(model, columns, found.estimated_covariance, rms_m, len(q))


_SEEDS = 16
"""Number of orientations and branches to try."""
_STEPS_ALONG = 12
"""Lattice steps over the length of the stretched arm: steps of some 100 mm for the arms of a calibration cell."""
_LARGEST_STEP_RAD = 0.6
"""Largest joint motion between lattice neighbours [rad]; more means that a singularity is near."""
_LIMIT_MARGIN_RAD = 0.05
"""Distance from joint limits [rad]: calibrated commands differ from nominal ones by up to some 20 mrad."""
_FACING_SHARE = 0.2
"""Fraction of the visible configurations from which seeds are taken: those that face the tracker best."""
_FINER = 4
"""The chosen cube is grown in steps of the lattice step divided by this."""
_WITHIN = np.linspace(-0.5, 0.5, 3)
"""Positions along each edge at which a grown cube is checked [edge lengths]."""
REACH, LIMITS, BODIES, VIEW = "out of reach", "joint limits", "clearance", "not seen by the tracker"


Key = tuple[int, int, int]
"""Position on a lattice."""
_NEIGHBOURS = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))


@dataclass(frozen=True, eq=False)
class Region:
    """Positions that an arm reaches with one orientation.

    Attributes
    ----------
    nominal : ArmModel
        The published chain, with its base in M.
    rotation_M : array, shape (3, 3)
        Rotation of the flange; NaN for arms with fewer than six joints, where it follows from the position.
    origin_B : array, shape (3,)
        SMR of the seed in the base frame [m].
    step : float
        Lattice step [m].
    q : dict
        Lattice position -> joint positions (N,) [rad], for positions where all constraints hold.
    refused : dict
        Adjacent lattice position -> constraint that is violated there.
    """

    nominal: ArmModel
    rotation_M: Array
    origin_B: Array
    step: float
    q: dict[Key, Array] = field(default_factory=dict)
    refused: dict[Key, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FoundCube:
    """Largest cube: edge [m], centre (3,) [m] in B, joint positions there, constraints that a larger one violates."""

    region: Region
    edge: float
    centre_B: Array
    q: Array
    limited_by: str

    def configurations(self, position_B: Array) -> Array:
        """Return joint positions (n, N) [rad] at positions (n, 3) [m], continued from the centre; NaN if impossible."""
        n = len(position_B)
        at = np.tile(self.q, (n, 1))
        for share in (0.25, 0.5, 0.75, 1.0):
            places = self.centre_B + share * (position_B - self.centre_B)
            at, reached = _solve(self.region, places, at)
            at[~reached] = np.nan
        return at


@dataclass(frozen=True, eq=False)
class CubeSearch:
    """Search for the test cube of one arm of a cell, with the others at home.

    ``arm`` is the model whose published chain is driven; ``cell`` has the bodies for the gate.
    """

    cell: CellBodies
    homes: Mapping[str, Array]
    name: str
    arm: ArmModel
    seed: int

    def cubes(self) -> list[FoundCube]:
        """Return the largest cube of each orientation, largest first; empty if no configuration is admissible."""
        found = []
        for q, rotation_M in self._seeds():
            region = self._region(q, rotation_M)
            if region is not None:
                found.append(self._on_lattice(region))
        largest = max((one.edge for one in found), default=0.0)
        grown = [self._enlarged(one) if one.edge > largest - one.region.step else one for one in found]
        return sorted(grown, key=lambda one: -round(one.edge, 6))

    def holds(self, q: Array) -> list[str]:
        """Return the first violated constraint of configurations (n, N) [rad]; empty text if all hold."""
        low, high = self.cell.arms[self.name].limits.T
        n = len(q)
        words = np.full(n, LIMITS, dtype=object)
        rows = np.flatnonzero(np.all((q >= low + _LIMIT_MARGIN_RAD) & (q <= high - _LIMIT_MARGIN_RAD), axis=1))
        words[rows] = BODIES
        if len(rows):
            rows = rows[clear_with_others(with_margin_for_ways(self.cell), self.homes, {self.name: q[rows]})]
        words[rows] = VIEW
        if len(rows):
            words[rows[visible_with_others(self.cell, self.homes, self.name, {self.name: q[rows]})]] = ""
        return [str(word) for word in words]

    @property
    def nominal(self) -> ArmModel:
        """The published chain alone, with its base in M."""
        return replace(self.arm, geometry=self.arm.nominal, effects=(), network=None, posterior=None)

    def _seeds(self) -> list[tuple[Array, Array]]:
        """Choose configurations (N,) far apart; return each with a rotation (3, 3) where its SMR faces the tracker."""
        liked = admissible_configurations(self.cell, self.homes, self.name, self.seed)
        if not len(liked):
            return []
        rotations, origins = flange_poses(self.nominal.geometry, liked)
        normal = rotations @ self.cell.arms[self.name].normal_F
        to_tracker = -(origins + rotations @ self.nominal.geometry.tool)
        to_tracker /= np.linalg.norm(to_tracker, axis=1, keepdims=True)
        facing = np.argsort(-np.einsum("na,na->n", normal, to_tracker), kind="stable")
        best = facing[: max(_SEEDS, int(_FACING_SHARE * len(liked)))]
        chosen = [int(best[0])]
        away = np.full(len(best), np.inf)
        while len(chosen) < min(_SEEDS, len(best)):
            away = np.minimum(away, np.abs(liked[best] - liked[chosen[-1]]).max(axis=1))
            chosen.append(int(best[np.argmax(away)]))
        return [(liked[k], _rotated(normal[k], to_tracker[k]) @ rotations[k]) for k in chosen]

    def _region(self, q: Array, rotation_M: Array) -> Region | None:
        """Return what is reached from a seed with its rotation; None if the seed itself violates a constraint."""
        nominal = self.nominal
        geometry = nominal.geometry
        rotations, origins = flange_poses(geometry, q[None])
        origin_B = apply(inverse_transform(geometry.T_M_B()), origins + rotations @ geometry.tool)[0]
        if geometry.joints < 6:
            rotation_M = np.full((3, 3), np.nan)
        step = _arm_length(nominal) / _STEPS_ALONG
        region = Region(nominal, rotation_M, origin_B, step)
        start, reached = _solve(region, origin_B[None], q[None])
        if not reached[0] or self.holds(start)[0]:
            return None
        region.q[0, 0, 0] = start[0]
        frontier: list[Key] = [(0, 0, 0)]
        while frontier:
            frontier = self._step(region, frontier)
        return region

    def _step(self, region: Region, frontier: list[Key]) -> list[Key]:
        """Continue to the lattice neighbours of ``frontier``; return those where all constraints hold."""
        new: dict[Key, Array] = {}
        for (i, j, k), (di, dj, dk) in product(frontier, _NEIGHBOURS):
            key = (i + di, j + dj, k + dk)
            if key not in region.q and key not in region.refused:
                new.setdefault(key, region.q[i, j, k])
        if not new:
            return []
        starts = np.array(list(new.values()))
        q, reached = _solve(region, region.origin_B + region.step * np.array(list(new), dtype=np.float64), starts)
        reached &= np.abs(q - starts).max(axis=1) <= _LARGEST_STEP_RAD
        words = self.holds(np.where(reached[:, None], q, 0.0))
        for key, at, ok, word in zip(new, q, reached.tolist(), words, strict=True):
            if ok and not word:
                region.q[key] = at
            else:
                region.refused[key] = word if ok else REACH
        return [key for key in new if key in region.q]

    def _on_lattice(self, region: Region) -> FoundCube:
        """Return the largest cube of the lattice."""
        keys = np.array(list(region.q))
        low = keys.min(axis=0)
        held: NDArray[np.bool_] = np.zeros(keys.max(axis=0) - low + 1, dtype=np.bool_)
        held[tuple((keys - low).T)] = True
        found = lattice_cube(held)
        assert found is not None
        steps, first = found
        corner = np.array(first) + low
        centre = region.origin_B + region.step * (corner + 0.5 * steps)
        middle = int(np.abs(keys - corner - 0.5 * steps).max(axis=1).argmin())
        near = list(region.q.values())[middle]
        q, reached = _solve(region, centre[None], near[None])
        at = q[0] if reached[0] else near
        return FoundCube(region, steps * region.step, centre, at, _limits_beside(region, corner, steps))

    def _enlarged(self, cube: FoundCube) -> FoundCube:
        """Return the cube grown and shifted by fractions of a lattice step, as far as all constraints hold."""
        if cube.edge == 0.0:
            return cube
        part = cube.region.step / _FINER
        shifts = part * np.array(list(product((0.0, 1.0, -1.0), repeat=3)))
        for grown in range(_FINER - 1, 0, -1):
            edge = cube.edge + grown * part
            within = edge * np.array(list(product(_WITHIN, repeat=3)))
            places = cube.centre_B + shifts[:, None] + within
            q = cube.configurations(places.reshape(-1, 3))
            words = self.holds(np.nan_to_num(q))
            held = np.array([not word for word in words]) & ~np.isnan(q).any(axis=1)
            fits = np.flatnonzero(held.reshape(len(shifts), -1).all(axis=1))
            if len(fits):
                centre = cube.centre_B + shifts[fits[0]]
                return replace(cube, edge=edge, centre_B=centre, q=cube.configurations(centre[None])[0])
        return cube


def _solve(region: Region, position_B: Array, start: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joint positions (n, N) [rad] at positions (n, 3) [m] in B, with the region's rotation; and success."""
    n = len(position_B)
    position_M = apply(region.nominal.geometry.T_M_B(), position_B)
    rotation_M = np.broadcast_to(region.rotation_M, (n, 3, 3))
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(start).all(axis=1))
    found = invert(region.nominal, position_M, rotation_M, np.where(usable[:, None], start, 0.0))
    return found.q, found.reached & usable


def _rotated(direction: Array, to: Array) -> Array:
    """Return the smallest rotation (3, 3) from one unit vector to another."""
    axis = np.cross(direction, to)
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, direction @ to))
    return rotation_from_vector(axis * (angle / sine if sine > 0.0 else 0.0))


def _arm_length(arm: ArmModel) -> float:
    """Return the length of the stretched arm [m]: distances along the chain, which do not depend on the joints."""
    origins = frame_poses(arm.geometry, np.zeros((1, arm.geometry.joints)))[1][:, 0]
    return float(np.linalg.norm(np.diff(origins, axis=0), axis=1).sum() + np.linalg.norm(arm.geometry.tool))


def _limits_beside(region: Region, corner: NDArray[np.intp], steps: int) -> str:
    """Return the constraints that are violated one lattice step around the cube, the most frequent first."""
    counted = Counter(
        word
        for key, word in region.refused.items()
        if all(c - 1 <= k <= c + steps + 1 for c, k in zip(corner.tolist(), key, strict=True))
    )
    return ", ".join(word for word, _ in counted.most_common())


LEAST_EDGE_M = 0.05
"""Smallest useful edge [m]: a smaller cube does not represent an arm's working space."""
_APPROACH_SHARE = 0.1
"""Length of the approach relative to the cube's edge; it stays inside the cube."""
_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4)
"""Sizes to try, relative to the found cube, if the gate refuses its motions."""
_MOST_TRIES = 40
WAYS = "ways between its poses"


@dataclass(frozen=True, eq=False)
class ChosenCube:
    """The test cube of one arm.

    Attributes
    ----------
    edge : float
        [m]
    centre_B : array, shape (3,)
        [m] in the arm's base.
    plane : str
    rotation_B : array, shape (3, 3)
        Flange in the base; NaN where it is free.
    position_B, q : mappings
        Pose, or pose and direction of approach as "P2 x", -> SMR (3,) [m] and nominal joint positions (N,) [rad].
    limited_by : str
    """

    edge: float
    centre_B: Array
    plane: str
    rotation_B: Array
    position_B: dict[str, Array]
    q: dict[str, Array]
    limited_by: str

    def record(self) -> IsoCube:
        """Return the cube as a result record."""
        rpy = rpy_of(self.rotation_B) if np.isfinite(self.rotation_B).all() else None
        return IsoCube.like(
            self,
            edge_mm=self.edge * 1e3,
            centre_B=xyz_of(self.centre_B),
            rpy=rpy,
            poses=tuple(
                IsoPose(name=name, position_B=xyz_of(self.position_B[name]), q=tuple(self.q[name].tolist()))
                for name in self.q
                if " " not in name
            ),
        )


def choose_cube(search: CubeSearch) -> ChosenCube | str:
    """Return the largest cube with a plane of the standard whose poses and motions the gate accepts; else why not."""
    found = search.cubes()
    if not found:
        return "no configuration is clear and seen by the tracker"
    sized = [(cube.edge * share, share, cube) for cube in found for share in _SHARES]
    sized = sorted((one for one in sized if one[0] >= LEAST_EDGE_M), key=lambda one: -round(one[0], 6))
    reason = f"the largest cube has an edge of {found[0].edge * 1e3:.0f} mm ({found[0].limited_by})"
    for edge, share, cube in sized[:_MOST_TRIES]:
        limited = cube.limited_by if share == 1.0 else f"{WAYS}, {cube.limited_by}"
        for plane in PLANES:
            chosen = _in_plane(search, replace(cube, edge=edge, limited_by=limited), plane)
            if isinstance(chosen, ChosenCube):
                return chosen
            reason = chosen
    return f"no cube of {LEAST_EDGE_M * 1e3:.0f} mm or more fits: {reason}"


def approach_name(pose: str, direction: str) -> str:
    """Return the name of the position from which a pose is approached along an axis."""
    return f"{pose} {direction}"


# -- inside -----------------------------------------------------------------------------------------------------------


def _in_plane(search: CubeSearch, cube: FoundCube, plane: tuple[str, str, str, str]) -> ChosenCube | str:
    """Return the cube with the poses in one plane, or what the gate does not accept."""
    positions = pose_positions(cube.centre_B, cube.edge, plane)
    positions |= _approaches(positions, cube.edge)
    q = cube.configurations(np.array(list(positions.values())))
    if not np.isfinite(q).all():
        return "the poses are not all reached on one branch"
    for name, word in zip(positions, search.holds(q), strict=True):
        if word:
            return f"pose {name}: {word}"
    at = dict(zip(positions, q, strict=True))
    for start, end in _ways(search, at):
        if refusal := refuse_motion(search.cell, start, end):
            return refusal
    rotation_B = search.nominal.geometry.T_M_B()[:3, :3].T @ cube.region.rotation_M
    return ChosenCube(cube.edge, cube.centre_B, "-".join(plane), rotation_B, positions, at, cube.limited_by)


def _approaches(positions: dict[str, Array], edge: float) -> dict[str, Array]:
    """Return the start of the approach to each pose along each axis: towards the centre; for P1 in + direction."""
    found = {}
    for pose in DIRECTIONAL_POSES:
        for axis, direction in enumerate(DIRECTIONS):
            inwards = 1.0 if positions["P1"][axis] >= positions[pose][axis] else -1.0
            start = positions[pose].copy()
            start[axis] += inwards * _APPROACH_SHARE * edge
            found[approach_name(pose, direction)] = start
    return found


def _ways(search: CubeSearch, q: dict[str, Array]) -> Iterator[tuple[dict[str, Array], dict[str, Array]]]:
    """Yield all straight motions of the tests, the other arms at home, and those from every position home."""
    homes = dict(search.homes)
    for position, before in legs():
        yield {**homes, search.name: q[before]}, {**homes, search.name: q[position]}
    for at in q.values():
        yield {**homes, search.name: at}, homes


# -- Commands of one arm, and the motions of each test ----------------------------------------------------------------


def arm_programme(
    model: CellModel,
    name: str,
    cube: ChosenCube,
    commands: IsoCommands,
    homes: Mapping[str, Array],
    *,
    rested_s: float,
    payload_kg: float,
    alignment: Alignment | None = None,
) -> ArmProgramme | str:
    """Return the commands of one arm for all positions of the tests, or why the model cannot command them.

    Calibrated commands assume that the arm has rested for ``rested_s`` [s] and came from the position before, with the
    other arm of a pair at home.
    """
    arm, names = model.arms[name], list(cube.q)
    position_B, q = np.array([cube.position_B[one] for one in names]), np.array([cube.q[one] for one in names])
    if commands == "nominal":
        wanted_M = apply(arm.nominal.T_M_B(), position_B)
        at = dict(zip(names, q, strict=True))
        sent = {(position, before): at[position] for position, before in legs()}
    else:
        T_M_B = arm.geometry.T_M_B()
        wanted_M = apply(T_M_B, position_B)
        rotation_M = np.broadcast_to(T_M_B[:3, :3] @ cube.rotation_B, (len(names), 3, 3))
        conditions = _conditions(model, name, homes, len(names), rested_s, payload_kg)
        found = invert(arm, wanted_M, rotation_M, q, conditions)
        if not (found.reached & (np.abs(found.q - q).max(axis=1) <= LARGEST_CORRECTION)).all():
            missed = int(np.argmin(found.reached))
            return f"the calibrated model does not reach {names[missed]} near the nominal joint positions"
        at = dict(zip(names, found.q, strict=True))
        row = conditions.take(np.array([0]))
        sent = {(position, before): with_approach(arm, at[position], at[before], row) for position, before in legs()}
    frame = np.zeros((len(names), 3, 3)) if alignment is None else alignment.position_covariance(q)
    return ArmProgramme(
        name=name,
        commands=commands,
        position_M=dict(zip(names, wanted_M, strict=True)),
        frame=dict(zip(names, frame, strict=True)),
        q=sent,
        rotation_M=_wanted_orientations(arm.nominal if commands == "nominal" else arm.geometry, cube, names),
    )


@dataclass(frozen=True, eq=False)
class Visit:
    """One motion: arm -> joint positions (N,) [rad]. ``place`` is None if nothing is measured."""

    targets: Mapping[str, Array]
    place: IsoPlace | None
    cycle: int


_DISTANCE = ("P2", "P4")
_DIRECTIONAL = tuple(
    name
    for pose, direction in product(DIRECTIONAL_POSES, DIRECTIONS)
    for name in (approach_name(pose, direction), pose)
)
"""Positions of a cycle of the distance test, and of the multi-directional one: before each pose where its approach
starts."""


def legs() -> list[tuple[str, str]]:
    """Return all positions that the tests of one arm drive to, each with the position before it."""
    return list(dict.fromkeys(chain(_closed(CYCLE), _closed(_DISTANCE), _closed(_DIRECTIONAL))))


def _closed(cycle: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield each position of a cycle with the position before it."""
    return zip(cycle, [cycle[-1], *cycle], strict=False)


def pose_visits(arm: ArmProgramme, cycles: int, speed: float = 0.0) -> Iterator[Visit]:
    """Yield the pose test: to P1, then cycles P5, P4, P3, P2, P1; ``speed`` as in ``IsoPlace``."""
    yield Visit({arm.name: arm.q["P1", "P2"]}, None, 0)
    yield from _visits(arm, CYCLE, cycles, lambda position, before: arm.place("pose", position, speed=speed))


def distance_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield the distance test: P2 and P4 alternately, once without measuring."""
    yield from _visits(arm, _DISTANCE, 1, lambda position, before: None)
    yield from _visits(arm, _DISTANCE, cycles, lambda position, before: arm.place("distance", position))


def directional_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield the multi-directional test: P1, P2 and P4, each approached along x, y and z."""

    def place(position: str, before: str) -> IsoPlace | None:
        return arm.place("multidirectional", position, before.split()[1]) if position in POSES else None

    yield from _visits(arm, _DIRECTIONAL, cycles, place)


def drift_visits(arm: ArmProgramme, cycles: int) -> Iterator[Visit]:
    """Yield one group of the drift test: cycles P5 to P1, measured only at P1."""
    at_end = arm.place("drift", "P1")
    yield from _visits(arm, CYCLE, cycles, lambda position, before: at_end if position == "P1" else None)


def exercise_visits(arm: ArmProgramme) -> Iterator[Visit]:
    """Yield one cycle without measuring, as between two groups of the drift test."""
    yield from _visits(arm, CYCLE, 1, lambda position, before: None)


def _visits(
    arm: ArmProgramme, positions: Sequence[str], cycles: int, place: Callable[[str, str], IsoPlace | None]
) -> Iterator[Visit]:
    """Yield cycles of positions; ``place`` says what is measured at one, given with the position before it."""
    for cycle, (position, before) in product(range(cycles), [*_closed(positions)]):
        yield Visit({arm.name: arm.q[position, before]}, place(position, before), cycle)


def paired_visits(
    first: ArmProgramme, second: ArmProgramme, pairs: Sequence[tuple[str, str]], cycles: int
) -> Iterator[Visit]:
    """Yield the cooperative test: both arms to each pair of poses together, always in the same order."""
    before = dict(_closed(CYCLE))
    for cycle, (a, b) in product(range(cycles), pairs):
        place = IsoPlace("cooperative", first.commands, (first.name, second.name), (a, b))
        targets = {first.name: first.q[a, before[a]], second.name: second.q[b, before[b]]}
        yield Visit(targets, place, cycle)


def pose_pairs(
    cell: CellBodies, homes: Mapping[str, Array], q: Mapping[str, Mapping[str, Array]]
) -> list[tuple[str, str]]:
    """Pair poses that two arms can take together, clear and both visible; each at most once, in the standard's order.

    ``q`` maps both arms to their nominal joint positions by pose. Find as many pairs as possible, equal names first.
    """
    first, second = q
    both = [(a, b) for a in CYCLE for b in CYCLE]
    stops = {name: np.array([q[name][pair[place]] for pair in both]) for place, name in enumerate((first, second))}
    holds = (clear_with_others(cell, homes, stops) & visible_stops(cell, stops)).reshape(len(CYCLE), len(CYCLE))
    other = 1.0 - np.eye(len(CYCLE))
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(holds, other, 10.0 * len(POSES)))
    return [(CYCLE[i], CYCLE[k]) for i, k in zip(rows, columns, strict=True) if holds[i, k]]


# -- inside -----------------------------------------------------------------------------------------------------------


def _wanted_orientations(geometry: Geometry, cube: ChosenCube, names: Sequence[str]) -> dict[str, Array]:
    """Return the wanted orientation (3, 3) of the probe at each position, the same at all; empty without a probe."""
    if geometry.probe is None:
        return {}
    R_M_S = geometry.T_M_B()[:3, :3] @ cube.rotation_B @ rotation_from_vector(geometry.probe)
    return dict.fromkeys(names, R_M_S)


def _conditions(
    model: CellModel, name: str, homes: Mapping[str, Array], n: int, rested_s: float, payload_kg: float
) -> MeasurementConditions:
    """Return conditions of n commands: payload, rest until mid-measurement, the other arm of a pair at home."""
    stated = MeasurementConditions(payload_kg=np.full(n, payload_kg), dwell_s=np.full(n, rested_s))
    others = [other for other in model.arms if other != name]
    if len(others) != 1:
        return stated
    return model.arms[others[0]].beside(stated, np.tile(homes[others[0]], (n, 1)))
