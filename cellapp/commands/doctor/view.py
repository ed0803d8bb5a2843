"""The findings of ``doctor`` as sentences; contents of a profile in units for people."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.cell.driving.records import ControllerCalibration
from cellapp.cell.profile import load_profile
from cellapp.commands.doctor.request import DoctorRequest
from cellapp.commands.doctor.result import DoctorResult
from cellapp.commands.record import View
from cellapp.commands.view.table import Cell, Table, table_of_cells
from cellapp.ground.counting import counted
from cellapp.ground.profile import Arm, Pose, Profile
from cellapp.ground.profile.sections import (
    AnyObstacle,
    BoxObstacle,
    CapsuleObstacle,
    CylinderObstacle,
    Placement,
    SphereObstacle,
)
from cellapp.robot.kinematics.chain import ROW_NAMES

_COLUMNS = "what", "in the profile"
_NO_DEVICE = "no device: readings come from a file"


def profile_tables(profile: Profile) -> list[Table]:
    """Show the cell and the constraints of its plan, one quantity per row."""
    return [
        table_of_cells(f"Cell {profile.name}", cell_words(profile), *_COLUMNS),
        table_of_cells("Plan", constraint_words(profile), *_COLUMNS),
    ]


def cell_words(profile: Profile) -> list[tuple[str, str]]:
    """Return arms, tracker, air sensor and everything else in the profile, each as name and words."""
    tracker, air = profile.tracker, profile.sensors.air
    return [
        *(row for name, arm in profile.arms.items() for row in _arm_words(name, arm)),
        ("tracker", _device(tracker.driver.kind, tracker.driver.has_device)),
        ("tracker pose", _pose(tracker.pose)),
        ("air sensor", "none: the tracker's own" if air is None else _device(air.kind, True)),
        *((f"obstacle {name}", _obstacle(obstacle)) for name, obstacle in profile.obstacles.items()),
        ("targets", profile.targets or "none"),
    ]


def _obstacle(obstacle: AnyObstacle) -> str:
    """Describe an obstacle: shape and sizes, what it is fixed to, and its pose there."""
    match obstacle:
        case BoxObstacle():
            shape = f"box {' x '.join(f'{1e3 * size:.0f}' for size in obstacle.size)} mm"
        case CylinderObstacle() | CapsuleObstacle():
            shape = f"{obstacle.shape} of radius {1e3 * obstacle.radius:.0f} mm, length {1e3 * obstacle.length:.0f} mm"
        case SphereObstacle():
            shape = f"sphere of radius {1e3 * obstacle.radius:.0f} mm"
        case _:
            shape = f"mesh {obstacle.file}, scale {obstacle.scale:g}"
    where = "in the cell" if obstacle.arm is None else f"on the {obstacle.fixed_to} of arm {obstacle.arm}"
    return f"{shape}, {where}: {_pose(obstacle.pose)}"


def _arm_words(name: str, arm: Arm) -> list[tuple[str, str]]:
    address = arm.driver.controller_address
    where = f" at {address}" if address else ""
    device, offset = _device(arm.driver.kind, arm.driver.has_device), arm.smr.offset
    smr = "unknown" if offset == "unknown" else f"{_mm(offset)} mm from the flange"
    return [
        (f"arm {name}", f"{arm.type.model}, {len(arm.type.joints)} joints, {device}{where}"),
        (f"arm {name} base", _pose(arm.base)),
        (f"arm {name} SMR", f"{smr}, seen within {math.degrees(arm.smr.acceptance):.0f} deg of its axis"),
        (f"arm {name} payload", f"{arm.payload.mass:.3g} kg, speed {100.0 * arm.speed_scale:.0f} % of the type's"),
    ]


def constraint_words(profile: Profile) -> list[tuple[str, str]]:
    """Return the constraints of a plan, each as name and words."""
    plan, tracker = profile.plan, profile.tracker
    reserve = f", and {plan.reserve} in reserve" if plan.reserve else ""
    ceiling = "" if plan.ceiling is None else f", ceiling at {plan.ceiling:.3f} m"
    obstacles = f", from {len(profile.obstacles)} obstacles" if profile.obstacles else ""
    low, high = (math.degrees(angle) for angle in tracker.elevation)
    words = [
        ("stops", f"{plan.stops} of each arm{reserve}, seed {profile.seed}"),
        (
            "clearance",
            f"{1e3 * plan.clearance:.0f} mm between arms{obstacles} and from the floor at {plan.floor:.3f} m{ceiling}",
        ),
        (
            "tracker",
            f"elevation {low:.0f} to {high:.0f} deg, distance {tracker.distance[0]:g} to {tracker.distance[1]:g} m"
            f"{_azimuth(tracker.azimuth)}",
        ),
        ("measuring", f"{tracker.averaging:g} s a point{_repeats(profile)}"),
    ]
    for name, arm in profile.arms.items():
        words.append((f"joints {name}", _ranges(arm.joint_limits)))
        words.append((f"incidence {name}", f"beam within {math.degrees(arm.smr.acceptance):.0f} deg of the SMR's axis"))
    if plan.ranges is not None:
        words.append(("ranges", f"{_ranges(plan.ranges)}, for all arms"))
    return words


def doctor_verdict(result: DoctorResult) -> str:
    """Summarize the doctor's findings in one line."""
    warnings = sum(finding.status == "warning" for finding in result.findings)
    more = f" ({counted(warnings, 'warning')})" if warnings else ""
    if not result.failed:
        return f"Ready: nothing would be refused{more}."
    names = ", ".join(finding.subject for finding in result.failed)
    return f"{counted(len(result.failed), 'check')} failed{more}: {names}."


def _device(kind: str, has_device: bool) -> str:
    return f"driver {kind}" if has_device else _NO_DEVICE


def _pose(pose: Pose | Placement | None) -> str:
    if pose is None:
        return "not given"
    x, y, z = pose.position
    roll, pitch, yaw = (math.degrees(angle) for angle in pose.rpy)
    return f"x {x:z.3f}, y {y:z.3f}, z {z:z.3f} m; roll {roll:z.1f}, pitch {pitch:z.1f}, yaw {yaw:z.1f} deg"


def _mm(point: tuple[float, float, float]) -> str:
    return ", ".join(f"{1e3 * value:z.1f}" for value in point)


def _degrees(pair: tuple[float, float]) -> str:
    return f"{math.degrees(pair[0]):z.0f} to {math.degrees(pair[1]):z.0f}"


def _ranges(pairs: Sequence[tuple[float, float]]) -> str:
    """Return joint ranges [rad] as degrees; one range if all are the same."""
    words = [_degrees(pair) for pair in pairs]
    return f"{words[0]} deg, each joint" if len(set(words)) == 1 < len(words) else f"{', '.join(words)} deg"


def _azimuth(azimuth: tuple[float, float]) -> str:
    whole = azimuth[1] - azimuth[0] >= 2.0 * math.pi
    return "" if whole else f", azimuth {_degrees(azimuth)} deg"


def _repeats(profile: Profile) -> str:
    repeat = profile.collection.repeat
    if repeat.precision is None:
        return ""
    return f", repeated up to {repeat.times} times until the mean is known to {1e6 * repeat.precision:.0f} µm"


_UNITS = ("mrad", "mm", "mm", "mrad", "mrad")


def view(result: DoctorResult, request: DoctorRequest | None = None) -> View:
    """Show on request the cell as in the profile, and every finding."""
    described = profile_tables(load_profile(request.profile)) if request is not None and request.cell else []
    values = [f"{one.key}: {one.value}  # {one.origin}" for one in result.profile or ()]
    findings = [f"{finding.status:8} {finding.subject}: {finding.text}" for finding in result.findings]
    tables = [_controller_table(name, its) for name, its in (result.controllers or {}).items()]
    written = [f"written: {path}" for path in result.written or ()]
    failed = f"{len(result.failed)} of {counted(len(result.findings), 'check')} failed"
    return View((*described, *values, *findings, *tables, *written), (failed,) if result.failed else ())


def _controller_table(name: str, its: ControllerCalibration) -> Table:
    """Show what the factory calibration changes at each joint of an arm."""
    values = ((f"{key} [{unit}]", "+.3f") for key, unit in zip(ROW_NAMES, _UNITS, strict=True))
    rows: list[tuple[Cell, ...]] = [(str(i), *(1e3 * x for x in row)) for i, row in enumerate(its.near, start=1)]
    title = f"Arm {name}: the controller's own calibration ({its.checksum}), less the published rows"
    return table_of_cells(title, rows, "joint", *values)
