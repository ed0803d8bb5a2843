"""Results about a plan before it is measured: whether it is safe, how long it takes, what it can show.

Results of designing a plan: its information against random plans, balance of its factors, its time; the view.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.estimation.discovery.records import PlannedAccuracy, PlannedEffect
from cellapp.ground.results import Record, Result


class PlanRefusal(Record):
    """A stop of a plan, or the way to it, that the safety gate refuses.

    ``configuration`` is the stop's number, from 0, None for home after the last one; ``before`` that of the stop
    before it, None for home. ``detour`` and ``via_home`` say how collection gets there although the gate refuses the
    planned way: from the stop before, or from home. ``line`` is that of a hand-edited file.
    """

    configuration: int | None
    before: int | None
    what: Literal["stop", "way", "view"]
    reason: str
    via_home: bool = False
    detour: Literal["straight", "one arm after the other"] | None = None
    line: int | None = None
    omitted_when_none = frozenset({"detour", "line"})

    @property
    def is_avoided(self) -> bool:
        """Whether another route leads there."""
        return self.via_home or self.detour is not None


class PlanCheckResult(Result, schema="cellapp-plan-check"):
    """``show DIR plan --check``: the safety gate and the tracker's view, over all stops and ways of a plan.

    ``plan PROFILE --from CSV`` is the same for a hand-edited plan; ``run`` is empty and ``file`` is given then.
    """

    run: str
    stops: int
    ways: int
    refused: tuple[PlanRefusal, ...] = ()
    file: str | None = None
    omitted_when_none = frozenset({"file"})

    @property
    def is_safe(self) -> bool:
        """Whether every stop can be measured; a detour is safe."""
        return all(one.is_avoided for one in self.refused)


class JointCoverage(Record):
    """What a plan uses of the range of one joint (from 1), all [rad].

    ``allowed`` is what stops are sampled from; ``used`` the lowest and the highest position; ``largest_gap`` the
    largest part of the allowed range without any stop.
    """

    joint: int
    allowed: tuple[float, float]
    used: tuple[float, float]
    largest_gap: float

    @property
    def share(self) -> float:
        """Used range over the allowed one."""
        return (self.used[1] - self.used[0]) / max(self.allowed[1] - self.allowed[0], 1e-12)


class PlannedTime(Record):
    """Estimated time of collecting a plan [s], by what it is spent on."""

    total_s: float
    moving_s: float
    resting_s: float
    measuring_s: float
    references_s: float
    warm_up_s: float


class ArmForecast(Record):
    """What the plan of one arm covers and can show; ``noise_rms_mm`` is the rms length of the tracker's noise."""

    stops: int
    reserves: int
    noise_rms_mm: float
    coverage: tuple[JointCoverage, ...]
    accuracy: tuple[PlannedAccuracy, ...]
    effects: tuple[PlannedEffect, ...]


class PlanForecastResult(Result, schema="cellapp-plan-forecast"):
    """``show DIR plan --forecast``: time, covered joint ranges, expected standard errors, effects that can be seen."""

    run: str
    time: PlannedTime
    arms: Mapping[str, ArmForecast]
    notes: tuple[str, ...] = ()


ErrorName = Literal["parameters", "mean", "worst"]


class ObservabilityIndices(Record):
    """O1 to O5 of the scaled geometry Jacobian of n stops.

    With singular values s_1 >= ... >= s_p: O1 = (s_1 ... s_p)^(1/p) / sqrt(n), O2 = s_p / s_1, O3 = s_p,
    O4 = s_p^2 / s_1, O5 = 1 / sum(1 / s_k) (Borm, Menq 1991; Driels, Pathre 1990; Nahvi, Hollerbach 1996; Sun,
    Hollerbach, ICRA 2008).
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float


class PlanQuality(Record):
    """Expected errors from n stops of one arm.

    ``parameters`` is the mean standard error of geometry parameters and effect coefficients, each relative to that of
    random plans of the same size (1 for these); ``mean_mm`` and ``worst_mm`` are the standard uncertainty of a
    predicted SMR position over the workspace: mean, and at its worst point.
    """

    stops: int
    parameters: float
    mean_mm: float
    worst_mm: float
    indices: ObservabilityIndices


class ArmDesign(Record):
    """The designed stops of one arm against random ones of the same number.

    ``equal_to_random``: how many random stops give the same ``parameters``, ``mean`` and ``worst`` errors.
    ``by_stops``: expected errors after the first n stops of the plan, in their order. ``largest_gap`` [rad] by joint.
    """

    candidates: int
    drawn: int
    rejected: Mapping[str, int]
    designed: PlanQuality
    random: PlanQuality
    equal_to_random: Mapping[ErrorName, float]
    by_stops: tuple[PlanQuality, ...]
    largest_gap: tuple[float, ...]


class FactorCorrelation(Record):
    """Correlation of a planned factor (approach side of a joint, step, dwell, time, ...) with another or a posture."""

    arm: str
    factor: str
    other: str
    correlation: float
    can_be_chosen: bool


class TravelTime(Record):
    """Time in motion [s]: of the plan, and of the same stops, approaches and dwells in random order (mean of
    samples)."""

    planned_s: float
    random_order_s: float


class PlanDesignResult(Result, schema="cellapp-plan-design"):
    """What ``plan`` knows of a designed plan; stored in the run."""

    arms: Mapping[str, ArmDesign]
    correlations: tuple[FactorCorrelation, ...]
    travel: TravelTime
    detours: int
    """Stops whose straight way is blocked and that are reached through other positions."""
    blocks: int
    repeats: int
    notes: tuple[str, ...] = ()

    @property
    def largest_correlation(self) -> FactorCorrelation | None:
        """Of the factors that can be chosen."""
        chosen = [one for one in self.correlations if one.can_be_chosen]
        return max(chosen, key=lambda one: abs(one.correlation), default=None)
