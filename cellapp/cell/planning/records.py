"""Results about a plan before it is measured: whether it is safe, how long it takes, what it can show."""

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

    ``plan PROFILE --check FILE`` is the same for a hand-edited plan; ``run`` is empty and ``file`` is given then.
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

    ``allowed`` is what stops are drawn from; ``used`` the lowest and the highest position; ``largest_gap`` the largest
    part of the allowed range without any stop.
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


class LawInMotion(Record):
    """From which size on a law of joints is seen: its effect, cycles a turn for lines, unit, and the smallest size of
    each joint by source (stops, sweeps, both); None where no size that arms have is seen."""

    effect: str
    cycles: int
    unit: str
    smallest: Mapping[str, Mapping[str, float | None]]


class SweepForecast(Record):
    """What stops, sweeps and both together will tell of an arm: standard errors by source, and sizes of laws."""

    accuracy: Mapping[str, PlannedAccuracy]
    laws: tuple[LawInMotion, ...]


class PlanForecastResult(Result, schema="cellapp-plan-forecast"):
    """``show DIR plan --forecast``: time, covered joint ranges, expected standard errors, effects that can be seen."""

    run: str
    time: PlannedTime
    arms: Mapping[str, ArmForecast]
    notes: tuple[str, ...] = ()
