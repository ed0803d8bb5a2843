"""Data classes of the check: belief of a calibration, power of stops, state of the test, conclusion.

A change is that of a parameter by 0.05 mm or 50 µrad, or of an effect such that the SMR moves by 0.05 mm rms. It is
*visible* if it moves the SMR, rms over the readings of the calibration, by at least ``VISIBLE`` standard deviations of
a measured coordinate (of tracker and arm together). The best-fitting motion of the tracker is subtracted first: what a
motion of the tracker explains as well is no change of an arm. If a probe measures orientation too, its rotation by the
change counts as well, in its own standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.monitoring.check.records import CheckedArm, CheckVerdict, FoundChange
from cellapp.estimation.prior.linear_model import Measured
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model import ArmModel

LENGTH_M = 5e-5
"""Change of a length that the check has to detect [m]."""
TURN_RAD = 5e-5
"""Change of an angle that the check has to detect [rad]."""
FALSE_ALARM, MISS = 0.01, 0.05
"""Probabilities of a false alarm and of missing a visible change."""
VISIBLE = 1.0
"""Least motion of the SMR by a visible change, in standard deviations of a measured coordinate."""
TRACKER = "tracker"
"""Name that takes the place of an arm's if the tracker moved."""

ChangeKind = Literal["tracker", "base", "smr", "parameter", "effect"]


@dataclass(frozen=True, eq=False)
class ArmBelief:
    """Prediction of one arm by a calibration, with its uncertainty.

    Attributes
    ----------
    stored : ArmModel
        The calibration itself, which targets are compensated with.
    model : ArmModel
        Mean of the posterior, near ``stored``, without a network. Its last terms are watched effects that the
        calibration does not have: their values are zero.
    columns : tuple of int, length K
        Geometric parameters, as indices into ``parameter_names``: base, D-H rows and tool.
    covariance : array, shape (p, p)
        Posterior covariance of the geometric parameters, then of the values of all terms; zero for watched ones.
    scatter_m : float
        Standard deviation of a measured coordinate beyond the stated uncertainty of the tracker [m], from held-out
        readings.
    noise_m : float
        Standard deviation of a measured coordinate, of tracker and arm together [m].
    day_m : float
        Rms motion of the SMR by effects of the day of the calibration, such as drift, of which today's are unknown [m].
    promised_m : float
        Root mean square length of the error of a prediction over the readings of the calibration [m].
    measured : Measured
        The readings of the calibration without gross errors, in the frame of ``model``: positions, then orientations
        where the check measures them.
    scatter_rad, noise_rad : float
        As ``scatter_m`` and ``noise_m``, of a component of an orientation [rad]; zero where none is measured.
    """

    stored: ArmModel
    model: ArmModel
    columns: tuple[int, ...]
    covariance: Array
    scatter_m: float
    noise_m: float
    day_m: float
    promised_m: float
    measured: Measured
    scatter_rad: float = 0.0
    noise_rad: float = 0.0

    @property
    def positions(self) -> Measured:
        """The positions among the readings of the calibration."""
        return self.measured.positions


@dataclass(frozen=True, eq=False)
class CheckBelief:
    """Predictions of a cell by a calibration.

    ``arms`` maps names to beliefs, in the expected frame of the tracker: the earlier one, or the approximate one of a
    new station. ``T_new_old`` (4, 4) maps the earlier frame into that; None if the tracker was not set up anew.
    ``station_free`` is True if it was set up anew, so that its motion is no change.
    """

    arms: Mapping[str, ArmBelief]
    station_free: bool = False
    T_new_old: Array | None = None

    @property
    def models(self) -> dict[str, ArmModel]:
        """Arm -> mean of its posterior."""
        return {name: arm.model for name, arm in self.arms.items()}


@dataclass(frozen=True, eq=False)
class Power:
    """How well some stops show one change of 0.05 mm or 50 µrad.

    ``noncentrality`` is the square of its size over its standard error, beside a station that is unknown where the
    belief says so; ``moved_mm`` the rms motion of the SMR by it over the calibration's readings after the best motion
    of the tracker; ``visible`` as defined above; ``detected`` the size in ``unit`` that is found with 95 %.
    """

    arm: str
    what: str
    kind: ChangeKind
    noncentrality: float
    moved_mm: float
    visible: bool
    unit: str
    detected: float


@dataclass(frozen=True, eq=False)
class ChosenStops:
    """Chosen stops as rows of the candidates, in the order of driving, and what they show when all are measured.

    ``needed`` is the non-centrality at which a change is detected with the asked power at the asked false alarms.
    """

    order: NDArray[np.intp]
    power: tuple[Power, ...]
    needed: float

    @property
    def weakest(self) -> Power | None:
        """The visible change that the stops show least; None if no change is visible."""
        visible = [one for one in self.power if one.visible]
        return min(visible, key=lambda one: one.noncentrality) if visible else None


@dataclass(frozen=True)
class SequentialState:
    """State of the sequential test after some stops.

    Attributes
    ----------
    stops : int
    sure : bool
        Whether the test has ended; nothing more has to be measured.
    changed, valid : bool
        Whether it is sure that something changed, or before the last stop that nothing visible did.
    log_evidence : float
        Log of the ratio of the likelihood of any change to that of none; a change is sure at log(1 / false alarm).
    log_valid : float
        Log of the least ratio of the likelihood of no change to that of a visible one; valid is sure at log(1 / miss).
    p_value : float
        Probability of errors as large if nothing has changed, by chi-squared.
    """

    stops: int
    sure: bool
    changed: bool
    valid: bool
    log_evidence: float
    log_valid: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Conclusion:
    """The outcome of a check, in the words and records of the result of ``check``.

    Attributes
    ----------
    verdict : CheckVerdict
    sure_after : int
        Stops after which the test ended.
    p_value : float
    changes : tuple of FoundChange
        Named changes of arms, bases, SMRs or the tracker, the most evident first, with their rivals.
    arms : mapping
        Arm -> CheckedArm.
    T_new_old : array, shape (4, 4), or None
        Motion of the tracker that was solved for: maps coordinates in its earlier frame into the present one.
    moved_bases : mapping
        Arm -> pose of its base (4, 4) in the tracker's frame, where the base moved.
    smr_offsets_F : mapping
        Arm -> centre of the SMR (3,) in the frame of the last joint [m], where the SMR was remounted.
    weak : tuple of Power
        Visible changes that the measured stops show with less than the asked power.
    notes : tuple of str
    """

    verdict: CheckVerdict
    sure_after: int
    p_value: float
    changes: tuple[FoundChange, ...]
    arms: Mapping[str, CheckedArm]
    T_new_old: Array | None
    moved_bases: Mapping[str, Array]
    smr_offsets_F: Mapping[str, Array]
    weak: tuple[Power, ...]
    notes: tuple[str, ...]

    @property
    def station_shift_mm(self) -> float | None:
        """Motion of what is at the earlier tracker's origin [mm], where a motion was solved for."""
        return None if self.T_new_old is None else float(np.linalg.norm(self.T_new_old[:3, 3])) * 1e3

    @property
    def station_turn_deg(self) -> float | None:
        """Turn of the tracker [deg], where a motion was solved for."""
        if self.T_new_old is None:
            return None
        R = self.T_new_old[:3, :3]
        sine = 0.5 * float(np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]))
        return float(np.degrees(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))))
