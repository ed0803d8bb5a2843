"""Results of ``trials check``: single checks, shares with their intervals, and bars."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from scipy.special import betaincinv

from cellapp.estimation.monitoring.check.records import CheckVerdict
from cellapp.ground.counting import counted
from cellapp.ground.results import Record, Result

MOST_FALSE = 0.01
LEAST_FOUND = 0.95
"""Bars: largest share of false alarms, and least share of visible changes that are detected."""
Group = Literal["unchanged", "parameter", "effect", "tracker", "base", "smr"]


class CheckedChange(Record):
    """One check of one simulated cell.

    ``what`` is what was changed, ``moved_mm`` the rms motion of the SMR by it at the stops of the check; ``named`` says
    whether the first change that was found is it, ``listed`` whether it is that or one of its rivals. ``solved_mm`` is
    the error of a solved motion at the points. ``by_chi_squared`` and ``by_directions`` say whether chi-squared alone,
    and the least p-value of all directions, find a change after all planned stops.
    """

    seed: int
    group: Group
    arm: str
    what: str
    visible: bool
    moved_mm: float
    verdict: CheckVerdict
    stops: int
    named: bool = False
    listed: bool = False
    solved_mm: float | None = None
    by_chi_squared: bool = False
    by_directions: bool = False

    @property
    def alarm(self) -> bool:
        """Whether the check says that something changed."""
        return self.verdict not in ("valid", "cannot say")


def exact_interval(k: int, n: int) -> tuple[float, float]:
    """Compute the 95 % interval of a probability, k of n cases hit (Clopper, Pearson, Biometrika 26 (1934) 404)."""
    low = float(betaincinv(k, n - k + 1, 0.025)) if k else 0.0
    return low, float(betaincinv(k + 1, n - k, 0.975)) if k < n else 1.0


class Share(Record):
    """A share of n checks with its exact 95 % interval."""

    n: int
    count: int
    low: float
    high: float

    @classmethod
    def of(cls, facts: Sequence[bool]) -> Share:
        """Count the true facts."""
        n, k = len(facts), sum(facts)
        low, high = exact_interval(k, n)
        return cls(n=n, count=k, low=low, high=high)

    @property
    def value(self) -> float:
        """The share itself; NaN without any check."""
        return self.count / self.n if self.n else float("nan")


class CheckTrialResult(Result, schema="cellapp-trials-check"):
    """``trials check``: every check of every cell, and the bars."""

    profile: str
    cells: int
    planned: int
    station_free: bool
    weakest: Mapping[str, float]
    checks: tuple[CheckedChange, ...]
    failed: tuple[str, ...] = ()
    """Cells that could not be checked, and why."""

    def some(self, group: Group, *, visible: bool | None = None) -> list[CheckedChange]:
        """Return the checks of a group."""
        return [one for one in self.checks if one.group == group and visible in (None, one.visible)]

    def false_alarms(self) -> Share:
        """Return the share of the unchanged cells in which a change was found."""
        return share(self.some("unchanged"), lambda one: one.alarm)

    def found(self) -> Share:
        """Return the share of the visible changes of parameters that were detected."""
        return share(self.some("parameter", visible=True), lambda one: one.alarm)

    def complaints(self) -> list[str]:
        """Say what failed and bars that are missed, in words."""
        said, false, found = list(self.failed), self.false_alarms(), self.found()
        if false.n and false.value > MOST_FALSE:
            said.append(f"false alarms in {false.value:.2%} of {counted(false.n, 'check')}, at most {MOST_FALSE:.0%}")
        if found.n and found.value < LEAST_FOUND:
            said.append(f"{found.value:.1%} of {found.n} visible changes detected, at least {LEAST_FOUND:.0%}")
        return said


def share(checks: Sequence[CheckedChange], fact: Callable[[CheckedChange], bool]) -> Share:
    """Return the share of checks for which a fact is true."""
    return Share.of([fact(one) for one in checks])
