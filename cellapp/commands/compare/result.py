"""Result of ``compare``: where two runs differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.estimation.discovery.records import Place
from cellapp.ground.results import Method, Record, Result, Stage


class ProfileDifference(Record):
    """A key of the profile, as ``arms.left.base.position[0]``, with its values as JSON; None where it is missing."""

    key: str
    a: str | None
    b: str | None


class ValueComparison(Record):
    """A parameter of two runs with standard errors, all in ``unit``; None where a run does not have it.

    ``difference`` is b less a, ``standard_uncertainty`` that of the difference, ``z`` one over the other.
    """

    name: str
    unit: str
    a: float | None
    b: float | None
    a_standard_error: float | None
    b_standard_error: float | None
    difference: float | None
    standard_uncertainty: float | None
    z: float | None

    @property
    def differs(self) -> bool:
        """Whether the two values differ by more than three standard uncertainties."""
        return self.z is not None and abs(self.z) > MOST_Z


MOST_Z = 3.0
"""Difference in standard uncertainties from which it counts: 0.3 % of normal differences are larger."""


class ErrorComparison(Record):
    """Mean and rms error of two runs [mm]; None where a run does not have it."""

    a_mean_mm: float | None
    b_mean_mm: float | None
    a_rms_mm: float | None
    b_rms_mm: float | None


class EffectComparison(Record):
    """An effect in one run or in both: where it acts, None in a run without it, and its sizes."""

    effect: str
    title: str
    a_where: Place | None
    b_where: Place | None
    parameters: tuple[ValueComparison, ...]

    @property
    def found_in(self) -> Literal["a", "b", "both"]:
        """Which of the runs has the effect."""
        if self.a_where is not None and self.b_where is not None:
            return "both"
        return "b" if self.a_where is None else "a"


class ArmComparison(Record):
    """One arm of two runs: parameters of the geometry, held-out errors by stage, effects, verification.

    ``verified_mm`` has the distances from the targets with nominal and with compensated commands.
    """

    parameters: tuple[ValueComparison, ...] = ()
    heldout_mm: Mapping[Stage, ErrorComparison] = {}
    effects: tuple[EffectComparison, ...] = ()
    verified_mm: Mapping[Literal["nominal", "compensated"], ErrorComparison] = {}


class PairComparison(Record):
    """The inter-base transform of ``method`` in two runs, and the pair's held-out cooperative errors by method.

    ``distance_mm`` is the distance between the two origins of the second base in the frame of the first.
    """

    method: Method | None
    parameters: tuple[ValueComparison, ...] = ()
    distance_mm: float | None = None
    cooperative_mm: Mapping[Method, ErrorComparison] = {}


class RunComparison(Result, schema="cellapp-comparison"):
    """``compare``: where two runs differ; ``notes`` say what cannot be compared, and what is out of date."""

    a: str
    b: str
    profile: tuple[ProfileDifference, ...]
    arms: Mapping[str, ArmComparison]
    pair: PairComparison | None
    notes: tuple[str, ...]
