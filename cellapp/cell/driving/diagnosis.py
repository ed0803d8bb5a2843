"""Examine what is reachable, what is missing and what would be refused. Read only; nothing moves.

Compare the factory calibration in a controller with the published rows of its arm.
"""

from __future__ import annotations

import importlib.util
import platform
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from cellapp.cell.driving.cell import arm_context, build_plant, tracker_context
from cellapp.cell.driving.records import ControllerCalibration
from cellapp.cell.profile.controller_file import controller_file_text
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.cell_bodies import ObstacleClearance, cell_bodies, cover, obstacle_clearances
from cellapp.cell.safety.gate import CellBodies, clear_alone, refuse_stop, visible
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.ground.counting import counted
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.chain import hayati_rows, nominal_geometry, off_published, same_chain, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import controller_rows, published_rows
from drivers.arms.registry import ARMS
from drivers.findings import Finding

LONGEST_PROBE_S = 5.0
"""A device that is silent for this long [s] counts as dead, even if the profile allows it more time."""

_SAMPLES = 2000
"""Number of random configurations for the visible share; its standard error is about 1 %."""
_LEAST_VISIBLE = 0.002
"""Smallest visible share (4 of the samples) with which planning is expected to find enough stops."""
_OLDEST_PYTHON, _FIRST_UNTRIED_PYTHON = (3, 11), (3, 13)


def examine(profile: Profile) -> list[Finding]:
    """Check everything that a profile names; probe all devices concurrently.

    However many devices are dead, this takes about twice ``LONGEST_PROBE_S``, or the time limit of the slowest
    connection: a minute for LMF, a sensor's own ``timeout``. Problems become findings, not exceptions.
    """
    with ThreadPoolExecutor(max_workers=len(profile.arms) + 2, thread_name_prefix="probe") as pool:
        probes = _start_probes(pool, profile)
        placement = _placement(profile)
        findings = [_python(profile), *_found(probes)]
    return findings + placement


def require_links(profile: Profile, look: Callable[[], None]) -> None:
    """Measure the links to all controllers at once; ``look`` is called meanwhile and may raise.

    Raise ``HardwareError`` if one is too slow for the controller's watchdog.
    """
    with ThreadPoolExecutor(max_workers=len(profile.arms), thread_name_prefix="link") as pool:
        links = {name: pool.submit(arm.driver.link, arm_context(name, arm), look) for name, arm in profile.arms.items()}
    slow = [f"arm {name}: {one.text}" for name, its in links.items() for one in its.result() if one.status == "failed"]
    if slow:
        raise HardwareError(f"{'; '.join(slow)}; nothing was moved")


_Probes = Mapping[str, Future[Sequence[Finding]]]
"""Device, as named in findings -> future of its probe's findings."""


def _start_probes(pool: Executor, profile: Profile) -> _Probes:
    """Probe all devices concurrently."""
    air, tracker = profile.sensors.air, profile.tracker.driver

    def probe_arm(name: str) -> list[Finding]:
        arm = profile.arms[name]
        found = [*arm.driver.probe(arm_context(name, arm), LONGEST_PROBE_S)]
        if found and found[0].status != "failed":
            found += arm.driver.link(arm_context(name, arm), lambda: None)
        return [*_shared_address(profile, name), *found]

    probes: dict[str, Callable[[], Sequence[Finding]]] = {
        f"arm {name}": partial(probe_arm, name) for name in profile.arms
    }
    probes["tracker"] = partial(tracker.probe, tracker_context(profile), LONGEST_PROBE_S)
    if air is not None:
        probes["sensor air"] = air.probe
    return {name: pool.submit(probe) for name, probe in probes.items()}


def _found(probes: _Probes) -> list[Finding]:
    """Collect the findings of the probes, with the device's name in front of each subject."""
    return [
        replace(one, subject=f"{device}: {one.subject}" if one.subject else device)
        for device, probe in probes.items()
        for one in probe.result()
    ]


def _python(profile: Profile) -> Finding:
    """Check the interpreter and the packages of all kinds of arms, including those that this profile does not need."""
    version = platform.python_version()
    if not _OLDEST_PYTHON <= sys.version_info[:2] < _FIRST_UNTRIED_PYTHON:
        return Finding("python", "failed", f"Python {version}; needed is 3.11 or 3.12: ur-rtde has no build for others")
    needed = {package for arm in profile.arms.values() for package in arm.driver.packages}
    texts, failed = [f"Python {version}"], False
    for package in dict.fromkeys(package for kind in ARMS.values() for package in kind.packages):
        if all(importlib.util.find_spec(module) is not None for module in package.modules):
            texts.append(f"{package.name} is installed")
        elif package in needed:
            texts.append(f"{package.name} is not installed; {package.needed_by} need it: pip install {package.name}")
            failed = True
        else:
            texts.append(f"{package.name} is not installed, and this profile does not need it")
    return Finding("python", "failed" if failed else "ok", ", ".join(texts))


def _shared_address(profile: Profile, name: str) -> list[Finding]:
    """Report other arms with the same controller address."""
    address = profile.arms[name].driver.controller_address
    others = [
        other
        for other, arm in profile.arms.items()
        if address and other != name and arm.driver.controller_address == address
    ]
    if not others:
        return []
    text = f"host {address} is also that of arm {', '.join(others)}; give each arm its own controller"
    return [Finding("address", "failed", text)]


# -- placement --------------------------------------------------------------------------------------------------------


def _placement(profile: Profile) -> list[Finding]:
    """Check that the arms are safe at home, and that the tracker sees enough of them."""
    placed = {name: arm for name, arm in profile.arms.items() if arm.base is not None and arm.home is not None}
    has_arms = any(arm.driver.has_device for arm in profile.arms.values())
    if not has_arms or not placed or profile.tracker.pose is None:
        return []
    findings = [] if profile.plant is None else [_plant(profile)]
    bare = [name for name, arm in placed.items() if not arm.type.capsules]
    if bare:
        text = f"arm {', '.join(bare)} has no bodies, so no collision can be foreseen; add capsules to its type"
        return [*findings, Finding("home", "failed", text)]
    known = {name: one for name, one in profile.obstacles.items() if one.arm is None or one.arm in placed}
    homes = {name: np.array(arm.home) for name, arm in placed.items()}
    try:
        cell = cell_bodies(profile.model_copy(update={"arms": placed, "obstacles": known}))
    except InputError as error:
        return [*findings, Finding("obstacles", "failed", str(error))]
    findings += obstacle_findings(cell, homes)
    refusal = refuse_stop(cell, homes)
    if refusal:
        text = f"{refusal}; change arms.*.home, arms.*.base, obstacles, plan.floor or plan.clearance"
        findings.append(Finding("home", "failed", text))
    else:
        findings.append(Finding("home", "ok", f"safe to stand at: {', '.join(placed)}"))
    return [*findings, *(_visibility(cell, profile, name) for name in placed)]


def _plant(profile: Profile) -> Finding:
    try:
        build_plant(profile)
    except InputError as error:
        return Finding("plant", "failed", str(error))
    return Finding("plant", "ok", "the simulated cell can be built")


def _visibility(cell: CellBodies, profile: Profile, name: str) -> Finding:
    """Check the share of random configurations, clear of floor and self, at which the tracker sees the SMR."""
    subject = f"arm {name}: SMR"
    if profile.arms[name].smr.offset == "unknown":
        return Finding(subject, "warning", "smr.offset is unknown: the tracker will be pointed at the flange instead")
    body = cell.arms[name]
    low, high = np.maximum(body.limits[:, 0], -np.pi), np.minimum(body.limits[:, 1], np.pi)
    if profile.plan.ranges is not None:
        ranges = np.array(profile.plan.ranges)
        low, high = np.maximum(body.limits[:, 0], ranges[:, 0]), np.minimum(body.limits[:, 1], ranges[:, 1])
    low, high = np.where(low <= high, low, body.limits[:, 0]), np.where(low <= high, high, body.limits[:, 1])
    q = np.random.default_rng([profile.seed, 0xD0C]).uniform(low, high, size=(_SAMPLES, len(low)))
    clear = clear_alone(cell, place(body, q))
    share = float((visible(cell, name, q) & clear).mean())
    text = f"the tracker sees it in {share:.1%} of {_SAMPLES} random configurations that the arm may take"
    if share >= _LEAST_VISIBLE:
        return Finding(subject, "ok", text)
    advice = "check smr.normal, smr.acceptance, arms.*.base, tracker.pose and the limits"
    return Finding(subject, "warning" if share > 0.0 else "failed", f"{text}; {advice}")


# -- Findings of the doctor about obstacles: distances at home, arms standing on them, capsules of mounted ones -------


def obstacle_findings(cell: CellBodies, homes: Mapping[str, Array]) -> Iterator[Finding]:
    """Yield a finding for each obstacle of the cell, and for each obstacle mounted on an arm."""
    found = list(obstacle_clearances(cell, homes))
    for obstacle in cell.obstacles:
        yield _standing(cell, obstacle.name, [one for one in found if one.obstacle == obstacle.name])
    for name, arm in cell.arms.items():
        for obstacle in arm.mounted:
            capsules = cover(obstacle)
            count = len(capsules.radius)
            text = f"on the flange of arm {name}"
            if capsules.excess > 0.0:
                text += (
                    f"; checks use {counted(count, 'capsule')} around it, which reach up to"
                    f" {1e3 * capsules.excess:.0f} mm out of it"
                )
            yield Finding(f"obstacle {obstacle.name}", "ok", text)


def _standing(cell: CellBodies, name: str, beside: list[ObstacleClearance]) -> Finding:
    homes = ", ".join(f"arm {one.arm} {1e3 * one.moving:.0f} mm" for one in beside)
    words = [f"distance at home: {homes}"]
    on_it = [one.arm for one in beside if one.base < cell.clearance]
    if on_it:
        words.append(f"{', '.join(on_it)} on or beside it: base and first link are not checked against it")
    refused = [f"arm {one.arm} must keep {1e3 * one.asked:.0f} mm" for one in beside if not one.moving >= one.asked]
    if refused:
        words += [*refused, f"change obstacles.{name}, arms.*.home, arms.*.base or plan.clearance"]
    return Finding(f"obstacle {name}", "failed" if refused else "ok", "; ".join(words))


_COMPARED = 500
"""Number of random configurations at which two chains are compared."""
CONTROLLER_FILE = "{arm}-calibration.conf"
"""Name of the file with the calibration of an arm's controller."""


def factory_tables(
    profile: Profile, reported: Mapping[str, tuple[Sequence[Sequence[float]], str]]
) -> dict[str, ControllerCalibration]:
    """Return the calibration of each controller that has one, by arm; ``reported`` has rows (N, 4) and checksums."""
    return {
        name: _table(profile.arms[name], np.array(rows), checksum)
        for name, (rows, checksum) in reported.items()
        if checksum and len(rows) == len(profile.arms[name].type.joints)
    }


def _table(arm: Arm, rows: Array, checksum: str) -> ControllerCalibration:
    published = published_rows(arm)
    near = hayati_rows(rows, published)
    tool = np.zeros(3) if arm.smr.offset == "unknown" else np.array(arm.smr.offset)
    chain = nominal_geometry(published, tool)
    limits = np.array(arm.joint_limits)
    q = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (_COMPARED, len(limits)))
    there = smr_positions(replace(chain, rows=near), q)
    off = (
        np.linalg.norm(smr_positions(start_from_nominal(chain, q, there, tool_unknown=False), q) - there, axis=1) * 1e3
    )
    return ControllerCalibration(
        checksum=checksum,
        deltas=tuple(map(tuple, (rows - published).tolist())),
        near=tuple(map(tuple, off_published(rows, published).tolist())),
        mean_mm=float(off.mean()),
        max_mm=float(off.max()),
    )


def factory_findings(profile: Profile, tables: Mapping[str, ControllerCalibration]) -> list[Finding]:
    """Report whether each arm's nominal rows are those of its controller."""
    return [_finding(name, profile.arms[name], table) for name, table in tables.items()]


def _finding(name: str, arm: Arm, table: ControllerCalibration) -> Finding:
    subject, published = f"arm {name}: calibration", published_rows(arm)
    if arm.factory is not None:
        if same_chain(published + np.array(table.deltas), controller_rows(arm), published):
            return Finding(subject, "ok", f"the controller's own, {table.checksum}, is that of arms.{name}.factory")
        text = (
            f"the controller's own, {table.checksum}, is not that of arms.{name}.factory"
            f" ({arm.factory.checksum or 'no checksum'}): write it with --controllers DIR, then collect and calibrate"
            " again"
        )
        return Finding(subject, "failed", text)
    text = (
        f"the controller computes with its own, {table.checksum}: its SMR is {table.mean_mm:.3f} mm (at most"
        f" {table.max_mm:.3f} mm) from that of the published rows. --controllers DIR writes it for arms.{name}.factory"
    )
    return Finding(subject, "ok", text)


def controller_files(profile: Profile, own: Mapping[str, tuple[Sequence[Sequence[float]], str]]) -> dict[str, str]:
    """Return name and text of a file per arm calibration; ``own`` maps arms to deltas (N, 4) and checksum."""
    return {
        CONTROLLER_FILE.format(arm=name): controller_file_text(
            deltas,
            checksum,
            (f"What the controller of arm {name} of {profile.name} adds to the published rows of its arm.",),
        )
        for name, (deltas, checksum) in own.items()
    }
