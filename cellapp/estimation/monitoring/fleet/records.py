"""Result of ``fleet`` and of ``compare`` with more than two runs: arms over their runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

from cellapp.estimation.discovery.records import Place
from cellapp.estimation.monitoring.check.records import CheckVerdict
from cellapp.ground.results import Record, Result, StageName

ArmCondition = Literal["beyond tolerance", "changed", "drifting", "unchanged", "not compared"]
ARM_CONDITIONS: tuple[ArmCondition, ...] = get_args(ArmCondition)
"""Worst first. ``drifting``: no single change is proven, but a trend is; ``not compared``: nothing to compare with."""

IdentityBasis = Literal["controller", "profile", "names"]
"""An arm is known by the serial number of its controller, by that in the profile, or only by the names of profile and
arm with its type."""

EffectState = Literal["stays", "appeared", "vanished", "grew", "shrank", "renamed", "not judged"]
"""Of an effect against the first run. ``renamed``: the data of one run cannot tell it from the one found in the other;
``not judged``: the difference may be chance, or the other run was not searched or could not show it."""

Figure = Literal[
    "heldout", "verified", "check", "noise", "repeatability", "pose_accuracy", "pose_repeatability", "temperature"
]
"""What is followed over time [mm; degC]: mean held-out error, largest verified distance from targets, rms error of
checks, noise of a measured position, repeatability of repeated stops, largest AP and RP of tests of ISO 9283, mean
temperature at the stops."""

FleetPart = Literal["arm", "installation"]
"""What changes: the arm, or base and tool, which a person may move."""

TrendFigure = Literal["heldout", "verified", "check", "parameter"]


class DatedValue(Record):
    """A measured value with its standard error, from which run and when (ISO 8601, UTC)."""

    run: str
    time: str
    value: float
    standard_error: float | None = None


class Change(DatedValue):
    """A value and its difference from that of the first run.

    ``standard_uncertainty`` is of the difference; ``p_value`` its chance without any change, times the number of
    comparisons of the whole result; None where it is not tested. ``proven``: that is at most the false alarm rate.
    """

    difference: float
    standard_uncertainty: float
    p_value: float | None = None
    proven: bool = False


class ParameterHistory(Record):
    """An identified parameter over the runs, the first run first.

    Attributes
    ----------
    unit : str
        Of the values: m or rad for geometry.
    part : str
        ``arm``; ``installation`` for base and tool, which a person may move: their changes are shown, not tested.
    moved_mm_per_unit : float or None
        Rms displacement of the SMR by one unit over evenly drawn configurations.
    """

    name: str
    unit: str
    part: FleetPart
    moved_mm_per_unit: float | None
    first: DatedValue
    changes: tuple[Change, ...]

    @property
    def last(self) -> Change | None:
        """The newest change; None with one run."""
        return self.changes[-1] if self.changes else None

    @property
    def moved_mm(self) -> float | None:
        """Rms displacement of the SMR by the newest change."""
        last = self.last
        return None if last is None or self.moved_mm_per_unit is None else abs(last.difference) * self.moved_mm_per_unit


class EffectSize(Record):
    """An effect in one run; ``size_mm`` is the rms displacement of the SMR by it over held-out stops."""

    run: str
    time: str
    found: bool
    searched: bool
    size_mm: float | None = None


class EffectHistory(Record):
    """An effect of an arm over the runs, and how the newest run differs from the first.

    ``where`` is the place in the newest run that has it; ``part`` is ``installation`` for an effect of the day, such as
    a base that drifts, which is not judged. ``parameter`` is the one that proves the state, with its difference from
    the first run (the value where it was not found) in ``unit``, and ``p_value`` as of ``Change``.
    """

    effect: str
    title: str
    where: Place
    part: FleetPart = "arm"
    state: EffectState
    sizes: tuple[EffectSize, ...]
    first_found: str
    parameter: str = ""
    unit: str = ""
    difference: float | None = None
    standard_uncertainty: float | None = None
    p_value: float | None = None
    instead_of: tuple[str, ...] = ()


class Crossing(Record):
    """When a trend reaches the tolerance: dates (ISO 8601), and months after the newest value.

    ``earliest`` and ``latest`` are the limits of a 95 % confidence set; None where it has no limit on that side.
    """

    tolerance_mm: float
    date: str
    months: float
    earliest: str | None
    latest: str | None


class Trend(Record):
    """Weighted linear regression of a figure over time; ``name`` is the parameter that moves the SMR.

    ``level`` [mm] is the line at ``origin`` (ISO 8601), the weighted mean time; ``slope`` is in mm a month of 30.4375
    days. ``p_value`` is the chance of such a slope without a trend, times the number of trends of the whole result;
    ``proven``: that is at most the false alarm rate. A parameter reaches the tolerance when it has moved the SMR by it
    since the newest calibration.
    """

    figure: TrendFigure
    name: str = ""
    points: tuple[DatedValue, ...]
    origin: str
    level: float
    level_standard_error: float
    slope: float
    slope_standard_error: float
    degrees_of_freedom: int
    p_value: float
    proven: bool
    tolerance_mm: float | None = None
    crossing: Crossing | None = None


class CheckPoint(Record):
    """A stored check: its verdict, rms error [mm], and what it found changed."""

    run: str
    time: str
    verdict: CheckVerdict
    rms_mm: float | None = None
    changes: tuple[str, ...] = ()


class IsoPoint(Record):
    """A characteristic of ISO 9283 that was judged [mm]."""

    run: str
    time: str
    characteristic: str
    value_mm: float | None
    tolerance_mm: float
    conformity: str


class ArmHistory(Record):
    """One arm over its runs, in the order in which they are compared: the oldest first.

    Attributes
    ----------
    runs : tuple of str
        Folders.
    known_by, serial, names
        How the arm was recognised, its serial number (empty if none), and "profile, arm" as the runs name it.
    reasons : tuple of str
        What makes its condition, the worst first.
    compared : tuple of str
        Runs whose model has parameters that were compared, the first run included.
    tolerance_mm : float or None
        Largest permissible position error by the newest profile that gives one.
    """

    type: str
    runs: tuple[str, ...]
    known_by: IdentityBasis
    serial: str = ""
    names: tuple[str, ...] = ()
    condition: ArmCondition = "not compared"
    reasons: tuple[str, ...] = ()
    compared: tuple[str, ...] = ()
    tolerance_mm: float | None = None
    parameters: tuple[ParameterHistory, ...] = ()
    effects: tuple[EffectHistory, ...] = ()
    figures: Mapping[Figure, tuple[DatedValue, ...]] = {}
    trends: tuple[Trend, ...] = ()
    checks: tuple[CheckPoint, ...] = ()
    iso9283: tuple[IsoPoint, ...] = ()
    notes: tuple[str, ...] = ()


class PairHistory(Record):
    """The inter-base transform of two arms over their runs.

    ``arms`` are keys of the result's ``arms``. ``distances_mm`` is how far the origin of the second base has moved in
    the frame of the first since the first run; ``moved``: a change of the newest run is proven.
    """

    arms: tuple[str, str]
    parameters: tuple[ParameterHistory, ...]
    distances_mm: tuple[DatedValue, ...]
    moved: bool


class FleetRun(Record):
    """A run that was read; ``problem`` is a sentence where it cannot be, ``stage`` has the model in force."""

    run: str
    profile: str = ""
    began: str = ""
    stage: StageName | None = None
    problem: str = ""
    notes: tuple[str, ...] = ()


class FleetResult(Result, schema="cellapp-fleet"):
    """``fleet``, and ``compare`` of more than two runs: the history of each arm, the worst condition first.

    Keys of ``arms`` are serial numbers or, where none is known, the names of profile and arm with its type.
    ``false_alarm`` is the largest chance that anything at all is said to have changed or to drift where nothing has;
    ``comparisons`` and ``trends_tested`` are the numbers of tests that it is shared by.
    """

    arms: Mapping[str, ArmHistory]
    folders: tuple[str, ...] = ()
    runs: tuple[FleetRun, ...] = ()
    pairs: tuple[PairHistory, ...] = ()
    false_alarm: float = 0.01
    comparisons: int = 0
    trends_tested: int = 0
    notes: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Arms that are beyond tolerance or have changed; empty if there is none."""
        return [
            f"{name}: {arm.condition}" + (f" ({arm.reasons[0]})" if arm.reasons else "")
            for name, arm in self.arms.items()
            if arm.condition in ("beyond tolerance", "changed")
        ]
