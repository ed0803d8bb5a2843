"""The page's drawings of the cell, made from the model and the readings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cellapp.kinematics.chain import frame_poses, smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model import CellModel
from cellapp.reporting.captioned import CaptionedFigure
from cellapp.run import Readings

_MOST_POINTS = 400
"""Measured positions drawn of each arm: more add kilobytes and no shape."""


def cell_views(model: CellModel, readings: Mapping[str, Readings]) -> list[CaptionedFigure]:
    """The cell in space, from above and from the side, in the tracker frame with its z axis up."""
    from cellapp.reporting import cell_figures
    from cellapp.reporting.svg import ARM_COLOURS

    level = levelling_rotation(next(iter(model.arms.values())).up_M)
    stops = typical_stops(readings)
    arms = []
    for name, arm in model.arms.items():
        measured = readings[name]
        typical = measured.take([stops[name]])
        origins = frame_poses(arm.geometry, typical.q)[1][:, 0]
        arms.append(
            cell_figures.ArmDrawing(
                measured.p_M[evenly_spread(len(measured), _MOST_POINTS)] @ level.T,
                level @ origins[0],
                np.vstack([origins, smr_positions(arm.geometry, typical.q)]) @ level.T,
            )
        )
    # the side view shows the line from the tracker to the arms at full length
    across = int(np.argmax(np.abs(np.mean([arm.base for arm in arms], axis=0))[:2]))
    names = [(f"arm{1 + place % ARM_COLOURS}", f"arm {name}") for place, name in enumerate(model.arms)]
    marks = "dots: measured SMR positions; squares: bases; triangle: tracker"
    if any(len(arm) > _MOST_POINTS for arm in readings.values()):
        marks += f"; {_MOST_POINTS} positions of an arm are drawn"
    legend = (*names, ("", marks))
    space = (*names, ("", f"lines: links of an arm at a measured stop, up to its SMR; dotted: line of sight; {marks}"))
    return [
        CaptionedFigure(cell_figures.space_figure("cell-space", arms), "The cell in space", space, "wide"),
        CaptionedFigure(cell_figures.plane_figure("cell-top", arms, 0, 1), "The cell from above", legend),
        CaptionedFigure(cell_figures.plane_figure("cell-side", arms, across, 2), "The cell from the side", legend),
    ]


def evenly_spread(n: int, most: int) -> NDArray[np.intp]:
    """At most ``most`` of n rows, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))


def typical_stops(readings: Mapping[str, Readings]) -> dict[str, int]:
    """A row of each arm with joints near their medians; rows of one common stop if the arms share any."""
    off = {name: np.linalg.norm(arm.q - np.median(arm.q, axis=0), axis=1) for name, arm in readings.items()}
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    if not common:
        return {name: int(np.argmin(values)) for name, values in off.items()}
    row_of_stop = {
        name: {stop: row for row, stop in enumerate(arm.configuration.tolist())} for name, arm in readings.items()
    }
    best = min(sorted(common), key=lambda stop: sum(float(off[name][row_of_stop[name][stop]]) for name in off))
    return {name: row_of_stop[name][best] for name in readings}


def levelling_rotation(up_M: Array) -> Array:
    """The smallest rotation (3, 3) that takes ``up_M`` to z (Rodrigues' formula with axis up_M x z)."""
    x, y, z = up_M
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + z))
