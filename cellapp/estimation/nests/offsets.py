"""Offsets of the nests on the flange from the calibrated arm."""

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
    """Offset of a nest in F (3,) [m], standard error of each coordinate (3,) [m], number of rows used."""

    offset_F: Array
    standard_error: Array
    n: int


def offsets_by_arm(arm: ArmModel, rows: Readings, groups: StopGroups) -> dict[str, NestOffset]:
    """Compute the offset of each measured nest as the mean of its rows in the computed flange frame.

    The standard error omits errors of the computed flange that all rows of a nest share, such as that of the base.
    """
    rotations, origins = arm.flange(rows.q)
    p_F = np.einsum("nba,nb->na", rotations, rows.p_M - origins)
    found = {}
    for place, name in enumerate(groups.names):
        own = p_F[groups.row[groups.seen[:, place], place]]
        if len(own) > 1:
            found[name] = NestOffset(own.mean(axis=0), own.std(axis=0, ddof=1) / math.sqrt(len(own)), len(own))
    return found
