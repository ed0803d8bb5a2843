"""Results of ``check``: whether a stored calibration still holds, from about twenty stops; where the tracker is now."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from cellapp.ground.results import Matrix, Point, Record, Result, StageName

CheckVerdict = Literal[
    "valid", "tracker moved", "base moved", "smr moved", "arm changed", "not explained", "not decided"
]


TRACKER_MOVED: CheckVerdict = "tracker moved"
CHANGES_OF_ARMS: tuple[CheckVerdict, ...] = ("base moved", "smr moved", "arm changed", "not explained")
"""What a check found that no new station of the tracker mends: it rests on the arms' model, wherever the tracker is."""
TRACKER = "tracker"
"""Stands for the name of an arm where the tracker moved."""


class FoundChange(Record):
    """A parameter or an effect of an arm that changed since the calibration; ``arm`` is "tracker" where that moved.

    ``value`` and ``standard_error`` are of the change, in ``unit``; ``p_value`` is its chance, corrected for the number
    of changes that were tested; ``moved_mm`` the rms displacement of the SMR by it over the readings of the
    calibration, ``turned_mrad`` the rms rotation of its probe, where orientation was measured. ``rivals`` are changes
    that explain the stops about as well.
    """

    arm: str
    what: str
    value: float | None
    standard_error: float | None
    unit: str
    p_value: float
    moved_mm: float
    turned_mrad: float | None = None
    rivals: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Where and what, without the amount."""
        named = self.arm == TRACKER or self.what.endswith(f"arm {self.arm}")
        return self.what if named else f"arm {self.arm}: {self.what}"


class CheckedArm(Record):
    """One arm: stops that were measured, their errors against the model [mm], and the accuracy that is left.

    ``expected_mm`` is the rms position error that the calibration promised there, ``rms_mm`` what was found,
    ``left_mm`` the rms error over the calibration's readings that the found changes make, with the promised one.
    ``expected_mrad`` and ``rms_mrad`` are those of orientation, where it was measured.
    """

    stops: int
    expected_mm: float
    rms_mm: float
    left_mm: float | None = None
    expected_mrad: float | None = None
    rms_mrad: float | None = None


class CheckedPoint(Record):
    """A measured SMR: joint positions [rad], position in the tracker frame [m], distance from the prediction [mm].

    ``error_mrad`` is the angle of its orientation from the prediction, where it was measured.
    """

    q: tuple[float, ...]
    measured_M: Point
    error_mm: float
    error_mrad: float | None = None


class CheckedStop(Record):
    """One stop: what was measured there, arm -> point, and where the sequential test stood after it.

    ``log_evidence`` and ``log_valid`` are minus the logarithms of the chances to be wrong in saying that something
    changed, or that nothing visible did; ``p_value`` is the chance of errors as large without a change; ``time_s`` [s]
    counts from the first motion.
    """

    points: Mapping[str, CheckedPoint]
    log_evidence: float
    log_valid: float
    p_value: float
    time_s: float


class WeakChange(Record):
    """A visible change that the measured stops show too weakly.

    ``moved_mm`` is as in ``FoundChange``; ``detected`` is the size in ``unit`` that these stops show surely enough.
    """

    arm: str
    what: str
    moved_mm: float
    detected: float
    unit: str


class CheckResult(Result, schema="cellapp-check"):
    """``check``: the verdict with its evidence.

    Attributes
    ----------
    verdict : str
    model : str
        The stage whose model was checked.
    planned, sure_after : int
        Stops that were chosen, and number of stops after which the sequential test ended.
    p_value : float
        Chance of errors as large if nothing has changed.
    false_alarm, miss : float
        Chances that the test was set for: of a change where there is none, of missing a visible one.
    arms : mapping
    changes : tuple of FoundChange
        The most evident first.
    weak : tuple of WeakChange
    visible : mapping
        Arm, or "tracker" -> change -> the size from which it is visible [m, rad, or unit of the effect's value].
    station_shift_mm, station_turn_deg, T_new_old
        Motion of the tracker, where one was solved for; ``T_new_old`` (4 x 4) maps coordinates in its earlier frame
        into the present one.
    moved_bases : mapping
        Arm -> pose of its base (4 x 4) in the tracker frame, where the base moved.
    smr_offsets_F : mapping
        Arm -> centre of the SMR in the frame of the last joint [m], where it was remounted.
    stops : tuple of CheckedStop
    seconds : float or None
        From the first motion to the last [s], in the time of the cell.
    stale : str
        Why the model should not have been used before the check; empty if it held as far as was known.
    simulated : bool
        Whether the hidden physics of another profile took the place of the simulated cell's own.
    next_step : str
        What to do now, empty if nothing.
    notes : tuple of str
    """

    verdict: CheckVerdict
    model: StageName | None = None
    planned: int
    sure_after: int
    p_value: float
    false_alarm: float = 0.01
    miss: float = 0.05
    arms: Mapping[str, CheckedArm]
    changes: tuple[FoundChange, ...] = ()
    weak: tuple[WeakChange, ...] = ()
    visible: Mapping[str, Mapping[str, float]] = {}
    station_shift_mm: float | None = None
    station_turn_deg: float | None = None
    T_new_old: Matrix | None = None
    moved_bases: Mapping[str, Matrix] = {}
    smr_offsets_F: Mapping[str, Point] = {}
    stops: tuple[CheckedStop, ...] = ()
    seconds: float | None = None
    stale: str = ""
    simulated: bool = False
    next_step: str = ""
    notes: tuple[str, ...] = ()

    @property
    def found_change(self) -> bool:
        """Whether something has changed, so that the model should not be used as it is."""
        return self.verdict in (TRACKER_MOVED, *CHANGES_OF_ARMS)

    @property
    def found_other_arms(self) -> bool:
        """Whether arms, bases or SMRs changed: what was measured of them before does not hold. A tracker may move."""
        return self.verdict in CHANGES_OF_ARMS

    def complaints(self, *, strict: bool = False) -> list[str]:
        """Why the calibration does not hold, or why that is not known; empty if it holds.

        With ``strict`` also that the model was out of date before the check.
        """
        complaints = [f"the model was out of date already: {self.stale}"] if strict and self.stale else []
        if self.verdict == "valid":
            return complaints
        if self.verdict == "not decided":
            return ["whether the calibration holds is not known", *complaints]
        found = "; ".join(one.words for one in self.changes)
        words = f"the calibration does not hold as it is: {self.verdict}" + (f" ({found})" if found else "")
        return [words, *complaints]


# -- ``check --tracker-moved`` -------------------------------------------------------------------------------------


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
