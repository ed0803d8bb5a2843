"""Result of ``check --tracker-moved``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from cellapp.ground.results import Matrix, Point, Record, Result

LocateVerdict = Literal["located", "base moved", "smr moved", "not explained"]
"""Whether the tracker's motion explains the points; earlier versions tried a moved base and a remounted SMR."""


class StationPose(Record):
    """A pose in the cell frame [m, rad]; ``rpy`` as in the profile."""

    position: Point
    rpy: Point


class LocatedPoint(Record):
    """One measured point: joint positions [rad], measured position [m] and residual [mm] in the present tracker frame.

    ``found_off_mm``: how far it was from where it was first expected.
    """

    arm: str
    q: tuple[float, ...]
    measured_M: Point
    residual_mm: Point
    found_off_mm: float


class LocateResult(Result, schema="cellapp-locate"):
    """``check --tracker-moved``: where the tracker stands now, from a few points of the arms.

    Attributes
    ----------
    verdict : str
    moved : bool
        Whether the tracker moved by more than the profile's limit of drift since the readings were taken.
    T_new_old : 4 x 4
        Maps coordinates in the tracker frame of the readings into the present one.
    shift_mm, turn_deg : float
        Distance of the two stations, and angle between them.
    covariance : 6 x 6
        Of a small motion of ``T_new_old`` in the present frame: shift at its origin [m], then rotation [rad].
    uncertainty_mm : float
        What the station adds to the standard uncertainty of a predicted coordinate, rms over the points.
    rms_mm, chi_squared, degrees_of_freedom, probability
        Of the residuals; ``probability`` of a larger chi-squared if one motion of the tracker explains all points.
    tracker_pose : StationPose
        The tracker in the cell frame; meaningless where the verdict is not "located".
    simulated_pose : StationPose or None
        Where the tracker of a simulated cell was put.
    carried : bool
        Whether the arms' models state the station's uncertainty from now on.
    """

    verdict: LocateVerdict
    moved: bool
    T_new_old: Matrix
    shift_mm: float
    turn_deg: float
    covariance: Matrix
    uncertainty_mm: float
    rms_mm: float
    chi_squared: float
    degrees_of_freedom: int
    probability: float
    tracker_pose: StationPose
    simulated_pose: StationPose | None = None
    carried: bool = True
    points: tuple[LocatedPoint, ...]
    notes: tuple[str, ...] = ()

    @property
    def by_arm(self) -> Mapping[str, int]:
        """Arm -> number of points."""
        return {name: sum(point.arm == name for point in self.points) for name in {p.arm: None for p in self.points}}

    def complaints(self) -> list[str]:
        """Say why the tracker could not be located; empty if it was."""
        if self.verdict == "located":
            return []
        worst = max(self.points, key=lambda point: math.hypot(*point.residual_mm))
        return [
            f"no motion of the tracker explains the points: they are off by {self.rms_mm:.3f} mm rms, most"
            f" ({math.hypot(*worst.residual_mm):.3f} mm) of arm {worst.arm}: a base or an SMR was moved too, or the arm"
            " changed. With the tracker where it stood, 'cellapp check DIR' names what; or calibrate again"
        ]
