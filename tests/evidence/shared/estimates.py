"""What the figures ask of an estimate, and no step of a cell does."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.calibration.parameters import ParameterSet
from cellapp.robot.kinematics.chain import Geometry
from cellapp.robot.kinematics.transforms import Array


def merged_values(parameters: ParameterSet, geometry: Geometry, nominal: Geometry) -> Array:
    """Compute the values (k,) that act like ``geometry`` with the dropped parameters at ``nominal``."""
    vector, columns, dropped = geometry.vector(), list(parameters.columns), list(parameters.dropped)
    return np.asarray(vector[columns] + parameters.shares @ (vector - nominal.vector())[dropped])
