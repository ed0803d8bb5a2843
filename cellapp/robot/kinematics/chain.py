"""Forward kinematics of a serial arm with revolute joints, and its analytic derivatives by all parameters.

The model is that of Bai et al., ROBOT 45(3) 2023, 276-286: D-H parameters with Hayati's angle beta,

    T_M_S = T_M_B A_1 ... A_N trans(t_x, t_y, t_z) rot(r_x, r_y, r_z)
    T_M_B = R_ref trans(x0, y0, 0) rot_x(alpha0) rot_y(beta0) trans(0, 0, z0) rot_z(theta0)
    A_i   = rot_z(q_i + theta_i) trans(a_i, 0, d_i) rot_x(alpha_i) rot_y(beta_i)

M is the tracker frame, B the base, S the SMR centre or the frame of a 6-D probe. The probe is rotated in the last frame
by the rotation vector r; an SMR has no rotation. ``R_ref`` is the identity unless the first joint axis is more than 60
degrees off the tracker's z axis (an arm on a wall). The parameters x0, y0, z0 become singular there, so ``R_ref``
permutes the tracker's axes such that its z axis is the one nearest to the first joint axis.

Jacobian: a rotation parameter about axis u through point c moves the SMR at P by u x (P - c) per radian; a translation
parameter along u moves it by u per metre. The output at a configuration is the position of S or, if an orientation was
measured there, the rotation vector from the measured to the computed orientation. A rotation about u changes that
vector by u, to first order in it; a translation does not change it.

Internal arrays have the shape (m, 3, n), vector first and configurations last: every operation runs along the
configurations, and the components of all m vectors times a matrix are one product.

A D-H row places both of its frames on the common normal of two joint axes. Between axes that are nearly parallel this
normal lies far from the arm: at a tilt of 1 mrad, hundreds of metres. The rows then hold large d of opposite signs,
which cancel along the chain. The controller of Universal Robots keeps its calibration in this form: the documentation
of ``ur_calibration`` (docs.ros.org, "Calibration correction algorithm") shows an arm with d2 = 439 m and d3 = -446 m.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from cellapp.robot.kinematics.transforms import (
    Array,
    angular_rows,
    apply,
    left_jacobian,
    rotation_from_vector,
    rotation_vectors,
    rotation_x,
    rotation_y,
    rotation_z,
    transform,
)

# -- Constant matrices and vectors of a chain's parameters: the base in the tracker frame, and the D-H rows -----------
#
# Angles and lengths are those of ``robot.kinematics.chain``.


AT_BOUND = 1e-8
"""Distance from a bound [m, rad] within which a value is at it: below what any reading tells."""
IN_TRACKER_AXES: Array = np.eye(3)
"""``R_ref`` of an arm whose first axis is near the tracker's z axis."""


def base_frame(base: Array, reference: Array) -> Array:
    """Vectors of the base in the tracker frame, shape (8, 3), from its parameters (6,) and ``R_ref`` (3, 3).

    x, y, z axes and origin of the base; then what does not rotate with theta0: x and y axes of the reference frame, the
    y axis after rot_x(alpha0), and the point (x0, y0, 0).
    """
    x0, y0, z0, alpha0, beta0, theta0 = base.tolist()
    ca, sa, cb, sb = math.cos(alpha0), math.sin(alpha0), math.cos(beta0), math.sin(beta0)
    ct, st = math.cos(theta0), math.sin(theta0)
    x, y, z = (cb, sa * sb, -ca * sb), (0.0, ca, sa), (sb, -sa * cb, ca * cb)
    vectors = np.array(
        [
            [ct * u + st * v for u, v in zip(x, y, strict=True)],
            [ct * v - st * u for u, v in zip(x, y, strict=True)],
            z,
            (x0 + z0 * z[0], y0 + z0 * z[1], z0 * z[2]),
            (1.0, 0.0, 0.0),
            (0.0, 1.0, 0.0),
            y,
            (x0, y0, 0.0),
        ]
    )
    return vectors if reference is IN_TRACKER_AXES else vectors @ reference.T


def row_matrices(rows: Array) -> Array:
    """Matrices (N, 4, 4) of D-H rows (N, 5) that map (x, y, z axis, origin) after rot_z(q_i) to those after A_i."""
    _, d, a, _, _ = rows.T
    angles = rows.T[[0, 3, 4]]  # theta, alpha, beta
    (ct, ca, cb), (st, sa, sb) = np.cos(angles), np.sin(angles)
    M = np.zeros((len(rows), 4, 4))
    M[:, 0, 0], M[:, 0, 1], M[:, 0, 2] = cb * ct - sb * sa * st, cb * st + sb * sa * ct, -sb * ca
    M[:, 1, 0], M[:, 1, 1], M[:, 1, 2] = -ca * st, ca * ct, sa
    M[:, 2, 0], M[:, 2, 1], M[:, 2, 2] = sb * ct + cb * sa * st, sb * st - cb * sa * ct, cb * ca
    M[:, 3, 0], M[:, 3, 1], M[:, 3, 2], M[:, 3, 3] = a * ct, a * st, d, 1.0
    return M


BASE_NAMES = ("x0", "y0", "z0", "alpha0", "beta0", "theta0")
ROW_NAMES = ("theta", "d", "a", "alpha", "beta")
TOOL_NAMES = ("tx", "ty", "tz")
PROBE_NAMES = ("rx", "ry", "rz")
"""Rotation vector of a probe whose orientation is measured; these names follow those of ``parameter_names``."""
_REFERENCES = (
    np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    IN_TRACKER_AXES,
)
"""``R_ref`` by reference axis: rotations that map z to x, to y and to z."""
_AT_ONCE = 8192
"""Most configurations whose frames are in memory at once if only positions are computed: some 6 MB."""
_NEARLY_PARALLEL = math.sin(math.radians(5.0))
"""Sine of 5 degrees. Joint axes closer to parallel than that make D-H parameters nearly singular."""


@dataclass(frozen=True)
class Geometry:
    """Kinematic parameters of one arm.

    Attributes
    ----------
    base : array, shape (6,)
        x0, y0, z0 [m], alpha0, beta0, theta0 [rad] of ``T_M_B``.
    rows : array, shape (N, 5)
        theta [rad], d [m], a [m], alpha [rad], beta [rad] of each joint.
    tool : array, shape (3,)
        SMR centre in the last joint's frame [m].
    reference_axis : int
        Tracker axis (0 x, 1 y, 2 z) that ``base`` uses as z: 2 unless the arm is mounted on a wall.
    probe : array, shape (3,), or None
        Rotation vector of a 6-D probe in the last joint's frame [rad]; None for an SMR, which has no orientation.
    tied : tuple of tuples of str
        Groups of parameters that an identification corrects by the same amount; the first stands for the group.
    bounds : mapping
        Parameter -> least and largest value [m, rad] that an identification may give it.
    """

    base: Array
    rows: Array
    tool: Array
    reference_axis: int = 2
    probe: Array | None = None
    tied: tuple[tuple[str, ...], ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def base_vectors(self) -> Array:
        """Vectors of the base in the tracker frame, (8, 3): see ``base_frame``."""
        return base_frame(self.base, self.reference())

    @cached_property
    def row_matrices(self) -> Array:
        """Matrices (N, 4, 4) of the rows: see ``row_matrices``."""
        return row_matrices(self.rows)

    @property
    def joints(self) -> int:
        """Number of joints N."""
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters in the order of ``vector``: ``parameter_names``, then the probe's if it has one."""
        return parameter_names(self.joints) + (() if self.probe is None else PROBE_NAMES)

    @property
    def tied_to(self) -> dict[str, str]:
        """Map each tied parameter, but the first of its group, to that first one."""
        return {name: first for first, *others in self.tied for name in others}

    @property
    def at_bound(self) -> set[str]:
        """Parameters at one of their bounds, and those that are tied to them."""
        value = dict(zip(self.names, self.vector().tolist(), strict=True)) if self.bounds else {}
        held = {name for name, pair in self.bounds.items() if min(abs(value[name] - one) for one in pair) < AT_BOUND}
        return held.union(*(group for group in self.tied if held & {*group}))

    def vector(self) -> Array:
        """All 6 + 5 N + 3 parameters, and the 3 of a probe, in the order of ``names`` [rad, m]."""
        of_probe = () if self.probe is None else (self.probe,)
        return np.concatenate([self.base, self.rows.ravel(), self.tool, *of_probe])

    def with_vector(self, vector: Array) -> Geometry:
        """The same arm with other parameters, in the order of ``names``."""
        tool = 6 + 5 * self.joints
        return replace(
            self,
            base=vector[:6].copy(),
            rows=vector[6:tool].reshape(-1, 5).copy(),
            tool=vector[tool : tool + 3].copy(),
            probe=None if self.probe is None else vector[tool + 3 :].copy(),
        )

    def reference(self) -> Array:
        """``R_ref``, shape (3, 3)."""
        return _REFERENCES[self.reference_axis]

    def T_M_B(self) -> Array:
        """Pose of the base in the tracker frame, shape (4, 4)."""
        axes = self.base_vectors
        return transform(axes[:3].T, axes[3])

    def with_T_M_B(self, T_M_B: Array) -> Geometry:
        """The same arm with its base at ``T_M_B`` (4, 4)."""
        axis = T_M_B[:3, 2]
        reference_axis = 2 if abs(axis[2]) > 0.5 else int(np.argmax(np.abs(axis)))
        geometry = replace(self, reference_axis=reference_axis)
        inverse_reference = geometry.reference().T
        rotation, position = inverse_reference @ T_M_B[:3, :3], inverse_reference @ T_M_B[:3, 3]
        alpha0 = math.atan2(-rotation[1, 2], rotation[2, 2])
        beta0 = math.atan2(rotation[0, 2], math.hypot(rotation[1, 2], rotation[2, 2]))
        tilt = rotation_x(alpha0) @ rotation_y(beta0)
        about_axis = tilt.T @ rotation
        theta0 = math.atan2(about_axis[1, 0], about_axis[0, 0])
        # z0 is measured along the first joint axis from its intersection with the plane z = 0 of the reference frame
        z0 = position[2] / tilt[2, 2]
        x0, y0 = (position - tilt[:, 2] * z0)[:2]
        return replace(geometry, base=np.array([x0, y0, z0, alpha0, beta0, theta0]))


def nominal_geometry(rows: Array, tool: Array, T_M_B: Array | None = None) -> Geometry:
    """Geometry from D-H rows (N, 4): theta, d, a, alpha [rad, m], tool (3,) [m] and base (4, 4); all beta are zero."""
    geometry = Geometry(
        base=np.zeros(6), rows=np.column_stack([rows, np.zeros(len(rows))]), tool=np.asarray(tool, dtype=np.float64)
    )
    return geometry if T_M_B is None else geometry.with_T_M_B(T_M_B)


@lru_cache(maxsize=32)
def parameter_names(joints: int) -> tuple[str, ...]:
    """Names of all 6 + 5 N + 3 parameters: x0, ..., theta0, theta1, d1, a1, alpha1, beta1, theta2, ..., tx, ty, tz."""
    rows = tuple(f"{name}{i}" for i in range(1, joints + 1) for name in ROW_NAMES)
    return BASE_NAMES + rows + TOOL_NAMES


@lru_cache(maxsize=32)
def all_names(joints: int) -> tuple[str, ...]:
    """Names of all parameters that a chain can have: those of ``parameter_names``, and of a probe's rotation."""
    return parameter_names(joints) + PROBE_NAMES


def parameter_unit(name: str) -> str:
    """Unit of a parameter: ``rad`` or ``m``."""
    return "rad" if name.startswith(("theta", "alpha", "beta", "r")) else "m"


def parallel_rows(geometry: Geometry) -> tuple[int, ...]:
    """Indices of joints whose next axis is parallel: D-H is singular there and Hayati's beta is needed.

    Source: Hayati, Mirmirani, J. Robotic Systems 2 (1985) 397.
    """
    return tuple(i for i, alpha in enumerate(geometry.rows[:-1, 3].tolist()) if abs(math.sin(alpha)) < _NEARLY_PARALLEL)


@dataclass(frozen=True)
class JointAngles:
    """Cosines and sines (N, n) of joint positions, computed once and used for several geometries.

    ``R_M_S`` (n, 3, 3) are measured orientations: at these configurations the kinematics compute orientation, at NaN
    they compute position. None if position is computed at all.
    """

    cosines: Array
    sines: Array
    R_M_S: Array | None = None

    @classmethod
    def of(cls, q: Array, R_M_S: Array | None = None) -> JointAngles:
        """Compute cosines and sines of joint positions ``q`` (n, N) [rad]."""
        angles = np.ascontiguousarray(q.T)
        return cls(np.cos(angles), np.sin(angles), R_M_S)

    @cached_property
    def angular(self) -> NDArray[np.bool_] | None:
        """Mask (n,) of configurations at which orientation is computed; None if there are none."""
        return angular_rows(self.R_M_S)

    @cached_property
    def signed_sines(self) -> Array:
        """Sines and negative sines (N, 2, 1, n): coefficients by which a rotation mixes the x and y axes."""
        signed: Array = np.empty((len(self.sines), 2, 1, self.count))
        signed[:, 0, 0] = self.sines
        np.negative(self.sines, out=signed[:, 1, 0])
        return signed

    def part(self, first: int, last: int) -> JointAngles:
        """Select the configurations ``first`` to ``last - 1``."""
        if last - first == self.count:
            return self
        R_M_S = None if self.R_M_S is None else self.R_M_S[first:last]
        return JointAngles(self.cosines[:, first:last], self.sines[:, first:last], R_M_S)

    @property
    def count(self) -> int:
        """Number of configurations n."""
        return int(self.cosines.shape[1])


def smr_positions(geometry: Geometry, q: Array, R_M_S: Array | None = None) -> Array:
    """Compute SMR positions in the tracker frame, shape (n, 3) [m], at configurations ``q`` (n, N) [rad].

    If an orientation ``R_M_S`` (n, 3, 3) was measured, a row is the rotation vector from it to the computed one [rad].
    """
    return np.ascontiguousarray(smr_positions_of(geometry, JointAngles.of(q, R_M_S)).T)


def smr_positions_of(geometry: Geometry, angles: JointAngles) -> Array:
    """Compute SMR positions in the tracker frame, shape (3, n) [m], or rotation vectors [rad]: component first."""
    if angles.count <= _AT_ONCE:
        return _computed(geometry, angles, _frames(geometry, angles))
    P: Array = np.empty((3, angles.count))
    for first in range(0, angles.count, _AT_ONCE):
        part = angles.part(first, min(first + _AT_ONCE, angles.count))
        P[:, first : first + part.count] = _computed(geometry, part, _frames(geometry, part))
    return P


def probe_rotations(geometry: Geometry, q: Array) -> Array:
    """Compute rotations (n, 3, 3) of the probe frame in the tracker frame; of the flange if there is no probe."""
    rotations, _ = flange_poses(geometry, q)
    return rotations if geometry.probe is None else np.asarray(rotations @ rotation_from_vector(geometry.probe))


def frame_vectors(geometry: Geometry, q: Array) -> Array:
    """Compute x, y, z axes and origins [m] of all D-H frames, base first, in the tracker frame: (3, N + 1, 4, n).

    ``q`` (n, N) are joint positions [rad]. Components come first, configurations last.
    """
    frames = _frames(geometry, JointAngles.of(q))[:-4]
    return frames.reshape(geometry.joints + 1, 4, 3, len(q)).transpose(2, 0, 1, 3)


def frame_poses(geometry: Geometry, q: Array) -> tuple[Array, Array]:
    """Compute all D-H frames, base first: rotations (N + 1, n, 3, 3) and origins (N + 1, n, 3) [m] in tracker frame M.

    ``q`` (n, N) are joint positions [rad].
    """
    frames = frame_vectors(geometry, q)
    rotations = np.ascontiguousarray(frames[:, :, :3].transpose(1, 3, 0, 2))
    return rotations, np.ascontiguousarray(frames[:, :, 3].transpose(1, 2, 0))


def flange_poses(geometry: Geometry, q: Array) -> tuple[Array, Array]:
    """Compute flange rotations (n, 3, 3) and origins (n, 3) [m] in the tracker frame at ``q`` (n, N) [rad]."""
    rotations, origins = frame_poses(geometry, q)
    return rotations[-1], origins[-1]


def jacobian(geometry: Geometry, angles: JointAngles, columns: tuple[int, ...]) -> tuple[Array, Array]:
    """Compute SMR positions and their derivatives with respect to some of the parameters.

    Parameters
    ----------
    geometry : Geometry
    angles : JointAngles
        n configurations.
    columns : tuple of int, length k
        Indices into ``all_names``.

    Returns
    -------
    P : array, shape (3, n)
        SMR positions in the tracker frame [m]; where an orientation was measured, the rotation vector from it [rad].
    J : array, shape (3, k, n)
        Derivatives [m/rad or m/m; rad/rad].
    """
    axis_of, center_of, rotates = _sources(columns, geometry.joints)
    frames = _frames(geometry, angles)
    P = _computed(geometry, angles, frames)
    J, place = frames[axis_of], {column: number for number, column in enumerate(columns)}
    for joint in np.flatnonzero(geometry.rows[:, 4]).tolist():
        # a and alpha act before rot_y(beta): undo it to get their axis
        cb, sb = math.cos(geometry.rows[joint, 4]), math.sin(geometry.rows[joint, 4])
        for column in (6 + 5 * joint + 2, 6 + 5 * joint + 3):
            if column in place:
                J[place[column]] = cb * frames[4 * joint + 4] + sb * frames[4 * joint + 6]
    first = len(parameter_names(geometry.joints))
    of_probe = [place[column] for column in columns if column >= first]
    if of_probe:
        J[of_probe] = _probe_axes(geometry, frames)[[columns[k] - first for k in of_probe]]
    axes, lever = J[rotates], frames[center_of[rotates]]
    np.subtract(P if angles.R_M_S is None else _smr(geometry, frames), lever, out=lever)
    for x, y, z in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        J[rotates, x] = axes[:, y] * lever[:, z] - axes[:, z] * lever[:, y]
    J[of_probe] = 0.0  # a probe turns about its own origin
    angular = angles.angular
    if angular is not None:
        J[:, :, angular] = 0.0
        J[np.ix_(np.flatnonzero(rotates), np.arange(3), np.flatnonzero(angular))] = axes[:, :, angular]
    return P, J.swapaxes(0, 1)


def base_twists(geometry: Geometry) -> Array:
    """Compute the twist of the base frame per unit of each base parameter, (6, 6): one column per ``BASE_NAMES``.

    The first three components are the velocity of a point of the base that is at the tracker's origin, the last three
    the rotation, both in the tracker frame: a point at p moves by ``v + w x p``.
    """
    vectors = geometry.base_vectors
    first = 4 - 4 * (geometry.joints + 1)  # ``_source`` counts the fixed vectors after those of all D-H frames
    twists = np.zeros((6, 6))
    for k, name in enumerate(BASE_NAMES):
        axis, center = _source(k, geometry.joints)
        u = vectors[axis if axis < 4 else axis + first]
        if parameter_unit(name) == "m":
            twists[:3, k] = u
        else:
            c = vectors[center if center < 4 else center + first]
            twists[:3, k], twists[3:, k] = np.cross(c, u), u
    return twists


def joint_jacobian(geometry: Geometry, angles: JointAngles) -> tuple[Array, Array]:
    """Compute SMR positions (3, n) [m] and derivatives by joint angles (3, N, n) [m/rad], in the tracker frame."""
    return jacobian(geometry, angles, tuple(6 + 5 * i for i in range(geometry.joints)))


@lru_cache(maxsize=64)
def _sources(columns: tuple[int, ...], joints: int) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return ``_source`` of some parameters as two arrays (k,), and a mask (k,) of the rotations."""
    sources = np.array([_source(column, joints) for column in columns], dtype=np.intp).reshape(-1, 2)
    names = all_names(joints)
    is_rotation = [parameter_unit(names[column]) == "rad" for column in columns]
    return sources[:, 0], sources[:, 1], np.array(is_rotation, dtype=np.bool_)


def _source(column: int, joints: int) -> tuple[int, int]:
    """Return indices into ``_frames`` of a parameter's axis and of a point on it (not used for a translation)."""
    fixed = 4 * (joints + 1)  # the four fixed vectors of base_frame
    if column < 6:
        of_base = ((fixed, 0), (fixed + 1, 0), (2, 0), (fixed, fixed + 3), (fixed + 2, fixed + 3), (2, 3))
        return of_base[column]
    if column >= 6 + 5 * joints:  # those of a probe are replaced by ``_probe_axes``
        return 4 * joints + (column - 6 - 5 * joints) % 3, 0
    joint, which = divmod(column - 6, 5)
    previous, own = 4 * joint, 4 * joint + 4  # the D-H frames before and after A_i
    axis = (previous + 2, previous + 2, own, own, own + 1)[which]  # theta, d, a, alpha, beta
    return axis, (previous if which == 0 else own) + 3


def _smr(geometry: Geometry, frames: Array) -> Array:
    """SMR positions (3, n) [m] from the vectors of ``_frames``."""
    last = 4 * geometry.joints
    tx, ty, tz = geometry.tool.tolist()
    P: Array = tx * frames[last] + frames[last + 3]
    P += ty * frames[last + 1]
    P += tz * frames[last + 2]
    return P


def _computed(geometry: Geometry, angles: JointAngles, frames: Array) -> Array:
    """Compute SMR positions (3, n) [m] or, if an orientation was measured, the rotation vector from it [rad]."""
    P = _smr(geometry, frames)
    if angles.R_M_S is not None:
        angular, last = angles.angular, 4 * geometry.joints
        flange = frames[last : last + 3][:, :, angular].transpose(2, 1, 0)
        R_M_S = flange if geometry.probe is None else flange @ rotation_from_vector(geometry.probe)
        P[:, angular] = rotation_vectors(R_M_S @ angles.R_M_S[angular].swapaxes(1, 2)).T
    return P


def _probe_axes(geometry: Geometry, frames: Array) -> Array:
    """Compute the axes (3, 3, n) about which the components of a probe's rotation vector rotate it: axis, component."""
    last = 4 * geometry.joints
    rotation = np.eye(3) if geometry.probe is None else left_jacobian(geometry.probe)
    return np.asarray(np.einsum("can,ck->kan", frames[last : last + 3], rotation))


def _frames(geometry: Geometry, angles: JointAngles) -> Array:
    """Compute axes and origins of all D-H frames, base first, then the fixed vectors of the base: (4 N + 8, 3, n).

    The part of A_i after rot_z(q_i) is the same for all configurations, hence one matrix product per joint.
    """
    vectors, rotated = (np.empty((m, 3, angles.count)) for m in (4 * geometry.joints + 8, 4))
    base = geometry.base_vectors[:, :, None]
    vectors[:4], vectors[-4:] = base[:4], base[4:]
    flat, rotated_flat = vectors.reshape(len(vectors), -1), rotated.reshape(4, -1)
    for i in range(geometry.joints):
        before = vectors[4 * i : 4 * i + 4]
        rotated[:2] = before[:2] * angles.cosines[i] + before[1::-1] * angles.signed_sines[i]
        rotated[2:] = before[2:]
        np.matmul(geometry.row_matrices[i], rotated_flat, out=flat[4 * i + 4 : 4 * i + 8])
    return vectors


# -- Plain D-H rows ---------------------------------------------------------------------------------------------------


_PARALLEL = math.sqrt(sys.float_info.epsilon)
"""Tilt [rad] below which two axes count as parallel. An arm of length L loses L times the tilt by this; above it, d of
about L over the tilt costs L times epsilon over the tilt by rounding. Both are below 1e-7 m at the square root."""

_SAME_ROWS = 2e-6
"""Difference of rows [m, rad] that is rounding: controllers and files say 1.570796327."""
MOST_FACTORY = (10e-3, 20e-3)
FACTORY_SOURCE = "four times the largest of the published calibrations of UR arms (2.2 mm, 3.5 mrad)"
"""Largest length [m] and angle [rad] by which a factory calibration changes published rows, and where that is from:
calibration.conf files in public bug reports of drivers. On the rows of another type the same files differ by at least
14 mm and 96 mrad."""


def plain_geometry(geometry: Geometry) -> Geometry:
    """Return the same arm with all beta zero: ``smr_positions`` are equal to rounding at every configuration.

    A plain row leaves an angle about and a shift along the next joint axis. These commute with that joint's angle,
    so they are added to theta and d of the next row, and after the last row to the tool. Flange orientations are equal
    too, unless the last row has a beta.
    """
    rows = geometry.rows.copy()
    angle = shift = 0.0
    for row in rows:
        row[0] += angle
        row[1] += shift
        row[:], angle, shift = _plain_row(row)
    tool = apply(transform(rotation_z(angle), [0.0, 0.0, shift]), geometry.tool)
    return replace(geometry, rows=rows, tool=tool)


def _plain_row(row: Array) -> tuple[Array, float, float]:
    """Convert a row (5,) to one without beta; also return the remaining angle [rad] about and shift [m] along z.

    With the row's x axis turned by ``psi`` about its first axis onto the common normal, and ``twist`` between the axes:

        trans(a, 0, d) rot_x(alpha) rot_y(beta)
            = rot_z(psi) trans(a', 0, d') rot_x(twist) trans(0, 0, shift) rot_z(turn)

    Of the two directions of the normal, the one closer to the row's x axis is chosen.
    """
    theta, d, a, alpha, beta = row.tolist()
    if beta == 0.0:
        return row, 0.0, 0.0
    ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
    sine = math.copysign(math.hypot(sb, sa * cb), sa * cb)
    if abs(sine) < _PARALLEL:
        psi, twist, shift = 0.0, math.atan2(0.0, ca * cb), 0.0
    else:
        psi, twist = math.atan2(sb / sine, sa * cb / sine), math.atan2(sine, ca * cb)
        shift = a * math.sin(psi) / sine
    cp, sp, ct = math.cos(psi), math.sin(psi), math.cos(twist)
    x_next = np.array([cb, sa * sb, -ca * sb])
    angle = math.atan2(x_next @ [-sp * ct, cp * ct, math.sin(twist)], x_next @ [cp, sp, 0.0])
    return np.array([theta + psi, d - shift * ct, a * cp, twist, 0.0]), angle, shift


def hayati_rows(plain: Array, published: Array) -> Array:
    """Convert plain rows (N, 4) to rows (N, 5) with beta of the same arm, near its published rows (N, 4).

    If two published axes are parallel, the row keeps the published d and has a beta, so that no length is large; the
    remaining angle and shift go into theta and d of the next row, as in ``plain_geometry``. Flange poses are equal.
    """
    rows = np.column_stack([plain, np.zeros(len(plain))])
    angle = shift = 0.0
    for i, row in enumerate(rows):
        row[0] += angle
        row[1] += shift
        angle = shift = 0.0
        if i + 1 < len(rows) and abs(math.sin(published[i, 3])) < _NEARLY_PARALLEL:
            row[:], angle, shift = _hayati_row(row, published[i])
    return rows


def off_published(plain: Array, published: Array) -> Array:
    """Return the differences (N, 5) [rad, m, m, rad, rad] of ``hayati_rows`` from published rows (N, 4)."""
    off = hayati_rows(plain, published) - np.column_stack([published, np.zeros(len(published))])
    off[:, [0, 3]] = np.remainder(off[:, [0, 3]] + np.pi, 2.0 * np.pi) - np.pi
    return off


def of_one_type(plain: Array, published: Array) -> bool:
    """Return whether plain rows (N, 4) are those of one arm of the type with these published rows (N, 4)."""
    if plain.shape != published.shape:
        return False
    off = np.abs(off_published(plain, published))
    return bool(off[:, 1:3].max() <= MOST_FACTORY[0] and off[:, [0, 3, 4]].max() <= MOST_FACTORY[1])


def same_chain(plain: Array, other: Array, published: Array) -> bool:
    """Return whether plain rows (N, 4) and others (N, 4) describe the same arm to rounding, even if d are large."""
    if plain.shape != other.shape:
        return False
    rows = [hayati_rows(one, published) for one in (plain, other)]
    angle = 2.0 * np.pi
    return bool(np.all(np.abs(np.remainder(rows[0] - rows[1] + 0.5 * angle, angle) - 0.5 * angle) < _SAME_ROWS))


def _hayati_row(row: Array, published: Array) -> tuple[Array, float, float]:
    """Convert a plain row (5,) to one with the published d and a beta; also return the remaining angle [rad] and
    shift [m] about z.

    The next axis intersects the plane z = d at the row's new origin; the x axis goes through that point.
    """
    theta, d, a, alpha = row[:4].tolist()
    c, s = math.cos(theta), math.sin(theta)
    axis = np.array([s * math.sin(alpha), -c * math.sin(alpha), math.cos(alpha)])
    shift = (d - published[1]) / axis[2]
    x, y = np.array([a * c, a * s]) - shift * axis[:2]
    sign = -1.0 if published[2] < 0.0 else 1.0
    theta_new = math.atan2(sign * y, sign * x)
    in_row = rotation_z(-theta_new) @ axis
    beta, alpha_new = math.asin(in_row[0]), math.atan2(-in_row[1], in_row[2])
    rest = (rotation_z(theta_new) @ rotation_x(alpha_new) @ rotation_y(beta)).T @ rotation_z(theta) @ rotation_x(alpha)
    rotated = np.array([theta_new, published[1], sign * math.hypot(x, y), alpha_new, beta])
    return rotated, math.atan2(rest[1, 0], rest[0, 0]), float(shift)


def plain_rows_of(origins: Array, published: Array) -> Array:
    """Return the plain rows (N, 4) of an arm from its joints' origins (N, 4, 4) in the frames of the links before.

    Each origin is ``rot_z(angle) trans(0, 0, shift) trans(a, 0, 0) rot_x(alpha) trans(0, 0, d) rot_z(theta)``: a and
    alpha are those of the row before, to which angle and shift belong, too. Of the two directions of a common normal,
    that of the ``published`` rows (N, 4) is chosen. What stands before the first joint belongs to the base.
    """
    rows = np.zeros((len(origins) + 1, 4))
    before = np.vstack([np.zeros(4), published])
    for joint, origin in enumerate(origins):
        R, p, a, twist = origin[:3, :3], origin[:3, 3], before[joint, 2], before[joint, 3]
        for sign in (1.0, -1.0):
            sine = sign * math.hypot(R[0, 2], R[1, 2])
            if abs(sine) < _PARALLEL:
                angle = math.atan2(sign * p[1], sign * p[0]) if math.hypot(p[0], p[1]) > _SAME_ROWS else 0.0
                theta, d, alpha = math.atan2(R[1, 0], R[0, 0]) - angle, p[2], 0.0
            else:
                angle, theta = math.atan2(R[0, 2] / sine, -R[1, 2] / sine), math.atan2(R[2, 0] / sine, R[2, 1] / sine)
                alpha = math.atan2(sine, R[2, 2])
                d = (math.sin(angle) * p[0] - math.cos(angle) * p[1]) / sine
            length = math.cos(angle) * p[0] + math.sin(angle) * p[1]
            if (length * a if abs(a) > _SAME_ROWS else alpha * twist) >= 0.0:
                break
        rows[joint] += [angle, p[2] - d * math.cos(alpha), length, alpha]
        rows[joint + 1, :2] += [theta, d]
    rows[1:, 0] -= 2.0 * math.pi * np.rint((rows[1:, 0] - published[:, 0]) / (2.0 * math.pi))
    return rows[1:]
