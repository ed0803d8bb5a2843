"""Compare the factory calibration in a controller with the published rows of its arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cellapp.cell.profile.files import controller_file_text
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.ground.profile import Arm, Profile
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.plain_dh import hayati_rows, off_published, same_chain
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import controller_rows, published_rows
from drivers.findings import Finding

_DRAWS = 500
"""Number of random configurations at which two chains are compared."""
CONTROLLER_FILE = "{arm}-calibration.conf"
"""Name of the file with the calibration of an arm's controller."""


@dataclass(frozen=True, eq=False)
class FactoryTable:
    """Factory calibration in a controller.

    Attributes
    ----------
    deltas : array, shape (N, 4)
        Deltas of the published rows theta, d, a, alpha [rad, m, m, rad]; lengths d may be hundreds of metres.
    near : array, shape (N, 5)
        Deltas of equivalent rows theta, d, a, alpha, beta close to the published ones.
    off_mm : tuple of two floats
        Mean and largest distance between the SMRs of both chains, after a rigid-body fit [mm].
    """

    checksum: str
    deltas: Array
    near: Array
    off_mm: tuple[float, float]


def factory_tables(
    profile: Profile, reported: Mapping[str, tuple[Sequence[Sequence[float]], str]]
) -> dict[str, FactoryTable]:
    """Return the calibration of each controller that has one, by arm; ``reported`` has rows (N, 4) and checksums."""
    return {
        name: _table(profile.arms[name], np.array(rows), checksum)
        for name, (rows, checksum) in reported.items()
        if checksum and len(rows) == len(profile.arms[name].type.joints)
    }


def _table(arm: Arm, rows: Array, checksum: str) -> FactoryTable:
    published = published_rows(arm)
    near = hayati_rows(rows, published)
    tool = np.zeros(3) if arm.smr.offset == "unknown" else np.array(arm.smr.offset)
    chain = nominal_geometry(published, tool)
    limits = np.array(arm.joint_limits)
    q = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (_DRAWS, len(limits)))
    there = smr_positions(replace(chain, rows=near), q)
    off = (
        np.linalg.norm(smr_positions(start_from_nominal(chain, q, there, tool_unknown=False), q) - there, axis=1) * 1e3
    )
    near = off_published(rows, published)
    return FactoryTable(checksum, rows - published, near, (float(off.mean()), float(off.max())))


def factory_findings(profile: Profile, tables: Mapping[str, FactoryTable]) -> list[Finding]:
    """Report whether each arm's nominal rows are those of its controller."""
    return [_finding(name, profile.arms[name], table) for name, table in tables.items()]


def _finding(name: str, arm: Arm, table: FactoryTable) -> Finding:
    subject, published = f"arm {name}: calibration", published_rows(arm)
    if arm.factory is not None:
        if same_chain(published + table.deltas, controller_rows(arm), published):
            return Finding(subject, "ok", f"the controller's own, {table.checksum}, is that of arms.{name}.factory")
        text = (
            f"the controller's own, {table.checksum}, is not that of arms.{name}.factory"
            f" ({arm.factory.checksum or 'no checksum'}): write it with --controllers DIR, then collect and calibrate"
            " again"
        )
        return Finding(subject, "failed", text)
    mean, most = table.off_mm
    text = (
        f"the controller computes with its own, {table.checksum}: its SMR is {mean:.3f} mm (at most {most:.3f} mm) from"
        f" that of the published rows. --controllers DIR writes it for arms.{name}.factory"
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
