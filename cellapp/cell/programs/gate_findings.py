"""Warnings of the safety gate about the postures of a corrected program, which the gate does not drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellapp.cell.programs.records import CorrectedTarget
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from cellapp.cell.safety.gate import refuse_stop
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.model import CellModel


def gate_findings(profile: Profile, model: CellModel, name: str, targets: Sequence[CorrectedTarget]) -> list[str]:
    """Return a sentence for each corrected target at which the gate would refuse the arm, the others at home.

    Motions between targets are not judged, because the controller computes blends and straight lines itself. If the
    profile does not describe the cell, one sentence says so.
    """
    homes = home_positions(profile)
    missing = [other for other in profile.arms if other != name and other not in homes]
    if missing:
        return [f"postures were not checked against the cell: arms.{missing[0]}.home is not in the profile"]
    try:
        cell = cell_bodies(profile, model)
    except InputError as error:
        return [f"postures were not checked against the cell: {error}"]
    found = []
    for target in targets:
        if target.q_new is None:
            continue
        if refusal := refuse_stop(cell, {**homes, name: np.array(target.q_new)}):
            found.append(f"line {target.line}: {target.command}: with the other arms at home, {refusal}")
    return found
