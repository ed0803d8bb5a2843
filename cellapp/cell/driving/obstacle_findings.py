"""Findings of the doctor about obstacles: distances at home, arms standing on them, capsules of mounted ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cellapp.cell.safety.cell_bodies import ObstacleClearance, cover, obstacle_clearances
from cellapp.cell.safety.gate import CellBodies
from cellapp.ground.counting import counted
from cellapp.robot.kinematics.transforms import Array
from drivers.findings import Finding


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
