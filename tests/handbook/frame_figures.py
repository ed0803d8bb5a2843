"""Drawings of the chapter on frames: one for each frame and convention, those of the cell from a profile."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from cellapp.ground.errors import InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.chain import Geometry, frame_poses, smr_positions
from cellapp.robot.kinematics.transforms import (
    Array,
    apply,
    invert,
    rotation_x,
    rotation_y,
    rotation_z,
    rotation_zyx,
    transform,
)
from cellapp.robot.model.nominal import nominal_arm, pose_matrix
from tests.handbook.sketch import Mark, Sketch, arc, arrow, circle, dot, label, line, sketch_svg, triad

_ORIGIN = np.zeros(3)
_X, _Y, _Z = np.eye(3)
_RAISED = np.radians([0.0, -60.0, 50.0, -80.0, -90.0, 0.0])
"""A posture of a six-axis arm of which every link is seen."""
_TURNED_VIEW, _LINK_VIEW = 25.0, -65.0
"""Azimuths of the viewer [deg] of drawings whose parts stand beside each other in the picture."""


def cell(profile: Profile) -> Sketch:
    """All frames of a cell: C, M, the bases, the flanges and the SMRs."""
    tracker = _tracker_pose(profile)
    marks: list[Mark] = [*triad(np.eye(4), "C", 0.3, (-14.0, 12.0)), *triad(tracker, "M tracker", 0.4)]
    for name, arm in profile.arms.items():
        origins, rotations, smr = _posture(arm, _base(arm), tracker[:3, 3])
        marks += [*_stick(origins, rotations, arm), *triad(_base(arm), f"B {name}", 0.4, (16.0, 18.0))]
        marks += [label(origins[-1], "F", shift=(12.0, 14.0)), line(tracker[:3, 3], smr, ink="turn", dashed=True)]
        marks += [dot(smr, "turn"), label(smr, "S", "turn", (-8.0, 16.0))]
    return Sketch("Frames of a cell: C cell, M tracker, B bases, F flanges, S SMRs", tuple(marks), 110.0, 45.0)


def tracker(_: Profile) -> Sketch:
    """Azimuth, elevation and distance of a point in the tracker frame."""
    point = np.array([1.0, 0.75, 0.65])
    flat, reach = point * [1.0, 1.0, 0.0], float(np.hypot(point[0], point[1]))
    upwards = np.cross(flat, _Z)
    return Sketch(
        "Tracker frame M: azimuth about z from x, elevation from the x-y plane, distance",
        (
            *triad(np.eye(4), "M", 0.9, (-16.0, 8.0)),
            line(_ORIGIN, flat, point, ink="faint", dashed=True),
            arrow(_ORIGIN, point, "ink"),
            dot(point, "turn"),
            label(point, "S at (x, y, z)", shift=(8.0, -8.0), anchor="start"),
            label(0.75 * point, "rho", shift=(0.0, -10.0)),
            arc(_ORIGIN, _Z, 0.5 * _X, math.atan2(point[1], point[0])),
            label([0.5, 0.2, 0.0], "az", "turn", (2.0, 18.0)),
            arc(_ORIGIN, upwards, 0.75 * flat / reach, math.atan2(point[2], reach)),
            label(0.75 * flat / reach, "el", "turn", (20.0, -10.0)),
        ),
        20.0,
        25.0,
    )


def base(_: Profile) -> Sketch:
    """The six parameters of a base: where joint 1's axis meets the plane z = 0 of M, its tilt, z0 and theta0."""
    tilt = rotation_x(-0.30) @ rotation_y(0.32)
    foot = np.array([0.9, 1.1, 0.0])
    origin = foot + 0.75 * tilt[:, 2]
    T = transform(tilt @ rotation_z(0.6), origin)
    return Sketch(
        "Base frame B in the tracker frame M by six parameters",
        (
            *triad(np.eye(4), "M", 0.45, (-16.0, 8.0)),
            line(_ORIGIN, [0.9, 0.0, 0.0], foot, ink="turn", dashed=True),
            label([0.62, 0.0, 0.0], "x0", "turn", (-4.0, 18.0)),
            label([0.9, 0.6, 0.0], "y0", "turn", (0.0, 18.0)),
            line(foot, foot + 0.62 * _Z, ink="faint", dashed=True),
            line(foot - 0.2 * tilt[:, 2], foot + 1.5 * tilt[:, 2], ink="faint"),
            dot(foot),
            arc(foot, np.cross(_Z, tilt[:, 2]), 0.5 * _Z, math.acos(float(tilt[2, 2]))),
            label(foot + 0.5 * _Z, "alpha0, beta0", "turn", (-8.0, -8.0), "end"),
            arrow(foot, origin),
            label(foot + 0.2 * tilt[:, 2], "z0", "turn", (16.0, 4.0)),
            *triad(T, "B", 0.5, (-16.0, 6.0)),
            line(origin, origin + 0.5 * tilt[:, 0], ink="faint", dashed=True),
            arc(origin, tilt[:, 2], 0.36 * tilt[:, 0], 0.6),
            label(origin + 0.40 * tilt[:, 0], "theta0", "turn", (-6.0, 18.0)),
            label(foot + 1.5 * tilt[:, 2], "axis of joint 1", "faint", (0.0, -8.0)),
        ),
        25.0,
        22.0,
    )


def joints(profile: Profile) -> Sketch:
    """The axes of the first arm of a profile, with the positive sense of each joint."""
    arm = next(iter(profile.arms.values()))
    origins, rotations, smr = _posture(arm, np.eye(4))
    marks = [*triad(np.eye(4), "B = frame 0", 0.2, (0.0, 18.0), ("x", "y")), *_stick(origins, rotations, arm)]
    for number, (origin, rotation) in enumerate(zip(origins[:-1], rotations[:-1], strict=True), start=1):
        axis, across = rotation[:, 2], rotation[:, 0]
        marks += [line(origin - 0.05 * axis, origin + 0.18 * axis, ink="z", arrow=True)]
        marks += [arc(origin + 0.10 * axis, axis, 0.045 * across, 1.5 * math.pi)]
        marks += [label(origin + 0.23 * axis, f"q{number}", "z", (0.0, 4.0))]
    marks += [label(origins[-1], "F", shift=(-12.0, -2.0)), dot(smr, "turn"), label(smr, "S", "turn", (12.0, -4.0))]
    title = f"Joint axes of a {arm.type.model} and the sense in which each position grows"
    return Sketch(title, tuple(marks), -48.0, 24.0)


def row(_: Profile) -> Sketch:
    """One D-H row: theta about z, d along z, a along the new x, alpha about it."""
    theta, d, a, alpha = math.radians(35.0), 0.75, 1.5, math.radians(40.0)
    turned, beside = rotation_z(theta), np.array([-0.22, 0.0, 0.0])
    end = transform(turned @ rotation_x(alpha), turned @ [a, 0.0, d])
    top, across = d * _Z, turned[:, 0]
    return Sketch(
        "One row of the D-H table: theta, d, a, alpha",
        (
            *triad(np.eye(4), "frame i-1", 0.45, (-6.0, 20.0)),
            line([0.0, 0.0, -0.25], [0.0, 0.0, 1.5], ink="faint", dashed=True),
            label([0.0, 0.0, 1.5], "axis of joint i", "faint", (0.0, -8.0)),
            line(end[:3, 3] - 0.5 * end[:3, 2], end[:3, 3] + 0.9 * end[:3, 2], ink="faint", dashed=True),
            label(end[:3, 3] - 0.5 * end[:3, 2], "axis of joint i+1", "faint", (0.0, 16.0)),
            line(beside, _ORIGIN, ink="faint"),
            line(top + beside, top, ink="faint"),
            arrow(0.6 * beside, top + 0.6 * beside),
            label(0.5 * top + 0.6 * beside, "d", "turn", (-12.0, 4.0)),
            line(top, top + 0.75 * _X, ink="faint", dashed=True),
            arc(top, _Z, 0.6 * _X, theta),
            label(top + 0.62 * _X, "q + theta", "turn", (20.0, 22.0)),
            arrow(top, end[:3, 3]),
            label(top + 0.66 * a * across, "a", "turn", (0.0, -10.0)),
            line(end[:3, 3], end[:3, 3] + 0.6 * _Z, ink="faint", dashed=True),
            arc(end[:3, 3], across, 0.5 * _Z, alpha),
            label(end[:3, 3] + 0.6 * _Z, "alpha", "turn", (0.0, -6.0)),
            *triad(end, "frame i", 0.4, (0.0, 22.0)),
        ),
        -25.0,
        24.0,
    )


def hayati(_: Profile) -> Sketch:
    """Two nearly parallel axes: they come nearest far away, where a plain row would need its frame; beta tilts here."""
    beta, length = math.radians(-25.0), 1.2  # far more than in truth, for the picture's sake
    end = transform(rotation_y(beta), [length, 0.0, 0.0])
    tip, meeting = end[:3, 3], length / math.tan(-beta) * _Z
    return Sketch(
        "Nearly parallel axes: Hayati's angle beta",
        (
            *triad(np.eye(4), "frame i-1", 0.45, (-6.0, 20.0)),
            line(-0.3 * _Z, meeting + 0.2 * _Z, ink="faint", dashed=True),
            line(tip - 0.3 * end[:3, 2], tip + 1.08 * (meeting - tip), ink="faint", dashed=True),
            dot(meeting, "faint"),
            label(meeting, "a plain row has its frame here: metres away", "faint", (14.0, 6.0), "start"),
            arrow(_ORIGIN, tip),
            label(0.6 * tip, "a", "turn", (0.0, 18.0)),
            line(tip, tip + 0.9 * _Z, ink="faint", dashed=True),
            arc(tip, _Y, 0.75 * _Z, beta),
            label(tip + 0.75 * _Z, "beta", "turn", (16.0, -4.0)),
            *triad(end, "frame i", 0.45, (0.0, 24.0)),
        ),
        -80.0,
        14.0,
    )


def modified(_: Profile) -> Sketch:
    """The same link in both D-H conventions: the frame at its end, and at its beginning."""
    marks: list[Mark] = []
    tilt = rotation_x(math.radians(50.0))
    far = tilt[:, 2]
    for place, title, at_end in ((0.0, "standard D-H: used here", True), (2.3, "modified D-H (Craig)", False)):
        begin = place * _beside(_LINK_VIEW)
        end = begin + 1.1 * _X
        marks += [line(begin, end, width=3.0)]
        marks += [line(begin - 0.35 * _Z, begin + 0.85 * _Z, ink="faint", dashed=True)]
        marks += [line(end - 0.35 * far, end + 0.85 * far, ink="faint", dashed=True)]
        marks += [label(begin + 0.85 * _Z, "joint i", "faint", (0.0, -8.0))]
        marks += [label(end + 0.85 * far, "joint i+1", "faint", (0.0, -8.0))]
        T = transform(tilt if at_end else np.eye(3), end if at_end else begin)
        marks += [*triad(T, "frame i", 0.42, (-10.0, 24.0)), label(begin + 0.55 * _X - 0.8 * _Z, title)]
    return Sketch("A link in standard and in modified D-H: where its frame sits", tuple(marks), _LINK_VIEW, 16.0)


def flange(_: Profile) -> Sketch:
    """The flange frame: last frame of the chain, z along the last axis, outwards."""
    return Sketch(
        "Flange frame F: the last frame of the chain",
        (
            *_flange(),
            *triad(np.eye(4), "F", 0.45, (-20.0, 8.0)),
            arc(0.55 * _Z, _Z, 0.16 * _X, 1.5 * math.pi),
            label(0.55 * _Z, "qN", "turn", (40.0, 0.0)),
            arrow(-0.55 * _Z, _ORIGIN),
            label(-0.34 * _Z, "dN", "turn", (16.0, 4.0)),
            label(-0.62 * _Z, "frame N-1", "faint", (0.0, 12.0)),
            dot(-0.55 * _Z),
        ),
        30.0,
        24.0,
    )


def smr(_: Profile) -> Sketch:
    """The SMR in the flange frame: its offset, its normal, and the cone within which it returns the beam."""
    centre = np.array([0.30, 0.42, 0.38])
    reach = 0.5
    rim = circle(centre + reach * math.cos(math.radians(30.0)) * _Z, _Z, reach * math.sin(math.radians(30.0)))
    sides: list[Mark] = [line(centre, edge, ink="faint", dashed=True) for edge in rim.points[[0, 12, 25, 37]]]
    return Sketch(
        "SMR centre S in the flange frame F, its normal and its cone of acceptance",
        (
            *_flange(),
            *triad(np.eye(4), "F", 0.40, (-18.0, 6.0)),
            line(_ORIGIN, centre * [1, 0, 0], centre * [1, 1, 0], centre, ink="turn", dashed=True),
            label(centre * [0.85, 0, 0], "tx", "turn", (-8.0, 16.0)),
            label(centre * [1, 0.55, 0], "ty", "turn", (4.0, 16.0)),
            label(centre * [1, 1, 0.5], "tz", "turn", (14.0, 6.0)),
            *sides,
            rim,
            arrow(centre, centre + 0.40 * _Z, "ink"),
            label(centre + 0.40 * _Z, "normal", shift=(0.0, -6.0)),
            dot(centre, "turn"),
            label(centre, "S", "turn", (16.0, 6.0)),
            label(rim.points[12], "acceptance 30 deg", "faint", (12.0, 0.0), "start"),
        ),
        30.0,
        20.0,
    )


def tool(_: Profile) -> Sketch:
    """What else is given in the flange frame: TCP of a program, centre of mass of the payload, bodies on the flange."""
    T = transform(rotation_y(0.5), [0.05, 0.30, 0.75])
    mass = np.array([0.02, 0.16, 0.36])
    low, high = np.array([-0.14, 0.02, 0.10]), np.array([0.14, 0.36, 0.58])
    return Sketch(
        "A tool on the flange: TCP, centre of mass of the payload, a body that is kept clear",
        (
            *_flange(),
            *triad(np.eye(4), "F", 0.40, (-18.0, 6.0)),
            *_box(low, high),
            dot(mass),
            label(mass, "payload, centre of mass", shift=(12.0, 4.0), anchor="start"),
            *triad(T, "TCP", 0.28, (-24.0, 4.0)),
            line(_ORIGIN, T[:3, 3], ink="turn", dashed=True),
        ),
        30.0,
        18.0,
    )


def station(_: Profile) -> Sketch:
    """The tracker before and after a move, and a fixed point seen from both places."""
    T = transform(rotation_zyx(math.radians(35.0), 0.0, 0.0), [0.5, -1.5, 0.0])
    point = np.array([1.9, -0.1, 0.5])
    return Sketch(
        "The tracker was moved: the old frame M and the present one",
        (
            *triad(np.eye(4), "M of the calibration", 0.5, (0.0, 20.0)),
            *triad(T, "M at present", 0.5, (0.0, 20.0)),
            dot(point, "turn"),
            label(point, "S, same joint positions", shift=(12.0, -6.0), anchor="start"),
            arrow(_ORIGIN, point, "ink", dashed=True),
            arrow(T[:3, 3], point, "ink", dashed=True),
            label(0.55 * point, "p old", shift=(6.0, -8.0)),
            label(0.5 * (T[:3, 3] + point), "p new", shift=(14.0, 16.0)),
            arrow(0.12 * T[:3, 3], 0.88 * T[:3, 3]),
            label(0.5 * T[:3, 3], "the tracker moved", "turn", (0.0, 18.0)),
        ),
        15.0,
        30.0,
    )


def pair(profile: Profile) -> Sketch:
    """The first two arms of a profile: the inter-base transform and the distance between their SMRs."""
    arms = list(profile.arms.items())[:2]
    if len(arms) < 2:
        raise InputError(f"{profile.name}: the figure of the inter-base transform needs two arms")
    tracker, marks, smrs, bases = _tracker_pose(profile), list[Mark](), list[Array](), list[Array]()
    for name, arm in arms:
        origins, rotations, point = _posture(arm, _base(arm), tracker[:3, 3])
        marks += [*_stick(origins, rotations, arm), *triad(_base(arm), f"B {name}", 0.3, (0.0, 18.0))]
        marks += [dot(point, "turn"), label(point, f"S {name}", "turn", (0.0, 20.0))]
        smrs.append(point)
        bases.append(_base(arm)[:3, 3])
    marks += [arrow(0.9 * bases[1] + 0.1 * bases[0], 0.85 * bases[0] + 0.15 * bases[1], "turn")]
    marks += [label(0.5 * (bases[0] + bases[1]), "T second, first", "turn", (-8.0, 14.0))]
    marks += [line(*smrs, ink="turn", dashed=True), label(0.5 * (smrs[0] + smrs[1]), "D", "turn", (0.0, -8.0))]
    return Sketch("Two bases and the distance between their SMRs", tuple(marks), 140.0, 38.0)


def work(_: Profile) -> Sketch:
    """A work frame by three points: origin, one on x, one in the x-y plane."""
    T = transform(rotation_zyx(0.5, 0.15, 0.1), [0.2, 1.1, 0.1])
    plate = apply(T, np.array([[0, 0, 0], [1.1, 0, 0], [1.1, 0.75, 0], [0, 0.75, 0], [0, 0, 0.0]]))
    origin, on_x, in_plane = apply(T, np.array([[0, 0, 0], [0.9, 0, 0], [0.7, 0.6, 0.0]]))
    return Sketch(
        "A work frame from three measured points",
        (
            *triad(np.eye(4), "M, or a base B", 0.4, (0.0, 20.0)),
            line(*plate, ink="faint"),
            *triad(T, "", 0.45),
            dot(origin, "turn"),
            label(origin, "origin", "turn", (-8.0, 18.0)),
            dot(on_x, "turn"),
            label(on_x, "x: on the x axis", "turn", (-6.0, 18.0)),
            dot(in_plane, "turn"),
            label(in_plane, "xy: positive y", "turn", (0.0, -10.0)),
        ),
        20.0,
        32.0,
    )


def rotations(_: Profile) -> Sketch:
    """Yaw, pitch and roll one after the other, each about an axis of the frame turned so far."""
    yaw, pitch, roll = math.radians(40.0), math.radians(-35.0), math.radians(45.0)
    steps = (
        ("yaw about z", np.eye(3), _Z, yaw, _X),
        ("pitch about the new y", rotation_z(yaw), _Y, pitch, _X),
        ("roll about the newest x", rotation_z(yaw) @ rotation_y(pitch), _X, roll, _Y),
    )
    marks: list[Mark] = []
    for place, (name, before, axis, angle, shown) in enumerate(steps):
        at = 1.75 * place * _beside(_TURNED_VIEW)
        after = before @ (rotation_z(angle) if axis is _Z else rotation_y(angle) if axis is _Y else rotation_x(angle))
        marks += [line(at, at + 0.8 * before[:, k], ink="faint", dashed=True) for k in range(3)]
        marks += [*triad(transform(after, at), "", 0.75), arc(at, before @ axis, 0.55 * (before @ shown), angle)]
        marks.append(label(at - 0.62 * _Z, name, "turn"))
    return Sketch("R = rot_z(yaw) rot_y(pitch) rot_x(roll), turn by turn", tuple(marks), _TURNED_VIEW, 25.0)


FIGURES: Mapping[str, Callable[[Profile], Sketch]] = {
    "frame-cell": cell,
    "frame-tracker": tracker,
    "frame-base": base,
    "frame-joints": joints,
    "frame-row": row,
    "frame-hayati": hayati,
    "frame-modified": modified,
    "frame-flange": flange,
    "frame-smr": smr,
    "frame-tool": tool,
    "frame-station": station,
    "frame-pair": pair,
    "frame-work": work,
    "frame-rotations": rotations,
}
"""What draws each figure of the chapter, by the stem of its file."""


def figure_svg(stem: str, profile: Profile) -> str:
    """A figure as the text of an SVG file.

    Raises
    ------
    InputError
        If the profile lacks a pose, a joint or an arm that the figure needs.
    """
    return sketch_svg(FIGURES[stem](profile))


# -- inside -----------------------------------------------------------------------------------------------------------


def _tracker_pose(profile: Profile) -> Array:
    if profile.tracker.pose is None:
        raise InputError(f"{profile.name}: the figure of its frames needs the pose of the tracker")
    return pose_matrix(profile.tracker.pose)


def _base(arm: Arm) -> Array:
    if arm.base is None:
        raise InputError("the figure of frames needs the pose of every base; give it in the profile")
    return pose_matrix(arm.base)


def _posture(arm: Arm, T: Array, towards: Array | None = None) -> tuple[Array, Array, Array]:
    """Origins (N + 1, 3), rotations (N + 1, 3, 3) of the frames and the SMR (3,), with the base at ``T`` (4, 4).

    The first joint turns the SMR over the base's z axis ``towards`` a point (3,).
    """
    geometry: Geometry = nominal_arm(arm).with_T_M_B(T)
    q = (_RAISED if geometry.joints == len(_RAISED) else np.full(geometry.joints, 0.5))[None].copy()
    if towards is not None:
        seen = apply(invert(T), np.array([towards, smr_positions(geometry, q)[0]]))
        q[0, 0] += float(np.subtract(*np.arctan2(seen[:, 1], seen[:, 0])))
    rotations, origins = frame_poses(geometry, q)
    return origins[:, 0], rotations[:, 0], smr_positions(geometry, q)[0]


def _stick(origins: Array, rotations: Array, arm: Arm) -> list[Mark]:
    """The arm as a line: along each joint's axis by d, then along x by a."""
    points = [origins[0]]
    for place, joint in enumerate(arm.type.joints):
        points += [origins[place] + joint.d * rotations[place][:, 2], origins[place + 1]]
    return [line(*points, width=3.0)]


def _beside(azimuth: float) -> Array:
    """Unit vector (3,) to the right in a picture that is seen from this azimuth [deg]."""
    return np.array([-math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth)), 0.0])


def _flange() -> list[Mark]:
    """A flange with its last link, about z, the flange's face at z = 0."""
    return [
        circle(_ORIGIN, _Z, 0.24, "ink"),
        circle(-0.14 * _Z, _Z, 0.24, "ink"),
        line([0.0, 0.0, -0.62], [0.0, 0.0, 0.72], ink="faint", dashed=True),
    ]


def _box(low: Array, high: Array) -> list[Mark]:
    """The twelve edges of a box between two corners (3,)."""
    bottom = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]]
    levels = [line(*([*corner, z] for corner in bottom), ink="faint") for z in (low[2], high[2])]
    return [*levels, *(line([*corner, low[2]], [*corner, high[2]], ink="faint") for corner in bottom[:4])]
