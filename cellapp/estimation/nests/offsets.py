"""Where the nests are on the flange, by the calibrated arm."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.nests.stop_groups import StopGroups
from cellapp.estimation.readings import Readings
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel


@dataclass(frozen=True, eq=False)
class NestOffset:
    """Offset of a nest in F (3,) [m], standard error of each coordinate (3,) [m], number of rows that it rests on."""

    offset_F: Array
    standard_error: Array
    n: int


def offsets_by_arm(arm: ArmModel, rows: Readings, groups: StopGroups) -> dict[str, NestOffset]:
    """Offsets of the nests that were measured, as the mean of their rows in the computed flange.

    An error of the computed flange that all rows of a nest share, as of the base, is not in the standard error.
    """
    rotations, origins = arm.flange(rows.q)
    p_F = np.einsum("nba,nb->na", rotations, rows.p_M - origins)
    found = {}
    for place, name in enumerate(groups.names):
        own = p_F[groups.row[groups.seen[:, place], place]]
        if len(own) > 1:
            found[name] = NestOffset(own.mean(axis=0), own.std(axis=0, ddof=1) / math.sqrt(len(own)), len(own))
    return found
