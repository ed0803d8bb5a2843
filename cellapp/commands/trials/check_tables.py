"""Tables of ``trials check``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from cellapp.commands.trials.check_records import CheckedChange, CheckTrialResult, Group, Share, share
from cellapp.commands.view.table import Field, Interval, Table, table_of
from cellapp.ground.counting import counted
from cellapp.ground.grouping import grouped

_PERCENT = ".1f"
_TITLES: dict[Group, str] = {
    "unchanged": "nothing",
    "parameter": "a parameter by 0.05 mm or 50 µrad",
    "effect": "stiffness, play or eccentricity",
    "tracker": "tracker",
    "base": "base of an arm",
    "smr": "SMR",
}
_MOST_LINES = 15
"""Most parameters shown, those with the fewest detections."""


def check_trial_tables(result: CheckTrialResult) -> list[Table]:
    """Show shares by kind of change, the compared statistics, and the changes that are hardest to find."""
    if not result.some("parameter"):
        return [_groups(result)]
    return [_groups(result), _statistics(result), _hardest(result)]


def check_trial_sentences(result: CheckTrialResult) -> list[str]:
    """State the conditions of the tables, and the bars that are missed."""
    false, found = result.false_alarms(), result.found()
    alarms = f"False alarms: {false.value:.2%} of {false.n} [{false.low:.2%}, {false.high:.2%}], at most 1 %."
    if not found.n:
        return [f"{result.cells} calibrations of measured robots, {counted(false.n, 'check')} on other rows. {alarms}"]
    return [
        f"{counted(result.cells, 'cell')}, {counted(len(result.checks), 'check')} of at most"
        f" {counted(result.planned, 'stop')}"
        f"{', the tracker set up anew' if result.station_free else ''}. A change is visible if it moves the SMR by at"
        " least the standard deviation of a measured coordinate, rms, beside the best motion of the tracker. Named: the"
        " first change that is stated is the true one; listed: it is that, or stated as one that the stops cannot tell"
        " from it. Intervals are 95 %, of the binomial distribution.",
        alarms,
        f"Visible changes of parameters detected: {found.value:.1%} of {found.n} [{found.low:.1%}, {found.high:.1%}],"
        " at least 95 %.",
        *(f"Missed: {text}." for text in result.complaints()),
    ]


def _groups(result: CheckTrialResult) -> Table:
    titles = {
        f"{title}{'' if visible or group == 'unchanged' else ', not visible'}": result.some(group, visible=visible)
        for group, title in _TITLES.items()
        for visible in (True, False)
    }
    return table_of(
        f"{result.profile}: what was changed and what the check found",
        [_Checks(title, some) for title, some in titles.items() if some],
        ("changed", "title"),
        ("checks", "found.n", "d"),
        ("detected", "found.value", _PERCENT, "%"),
        ("95 %", lambda its: Interval(100.0 * its.found.low, 100.0 * its.found.high), _PERCENT, "%"),
        ("named", lambda its: its.of_changes(lambda one: one.named), _PERCENT, "%"),
        ("listed", lambda its: its.of_changes(lambda one: one.listed), _PERCENT, "%"),
        ("cannot say", lambda its: sum(one.verdict == "cannot say" for one in its.some), "d"),
        ("mean stops", "stops", ".1f"),
        ("largest error", "largest_mm", ".3f", "mm"),
    )


@dataclass(frozen=True)
class _Checks:
    """One row of a table: checks under a title."""

    title: str
    some: Sequence[CheckedChange]

    @property
    def found(self) -> Share:
        return share(self.some, lambda one: one.alarm)

    @property
    def stops(self) -> float:
        return sum(one.stops for one in self.some) / len(self.some)

    @property
    def moved_mm(self) -> float:
        return sum(one.moved_mm for one in self.some) / len(self.some)

    @property
    def largest_mm(self) -> float | None:
        return max((one.solved_mm for one in self.some if one.solved_mm is not None), default=None)

    def of_changes(self, fact: Callable[[CheckedChange], bool]) -> float | None:
        """Return the share of checks for which a fact is true; None if nothing was changed."""
        return share(self.some, fact).value if self.some[0].group != "unchanged" else None


_STATISTICS: Mapping[str, Callable[[CheckedChange], bool]] = {
    "stop by stop": lambda one: one.alarm,
    "all directions, after all stops": lambda one: one.by_directions,
    "chi-squared alone, after all stops": lambda one: one.by_chi_squared,
}


def _statistics(result: CheckTrialResult) -> Table:
    """Show the sequential test beside tests after all stops, each at 1 % false alarms."""

    def of(heading: str, group: Group, visible: bool | None, number_format: str) -> Field:
        some = result.some(group, visible=visible)
        return heading, lambda name: share(some, _STATISTICS[name]).value if some else None, number_format, "%"

    return table_of(
        "Found by",
        _STATISTICS,
        ("statistic", str),
        of("unchanged", "unchanged", None, ".2f"),
        of("parameters", "parameter", True, _PERCENT),
        of("parameters not visible", "parameter", False, _PERCENT),
        of("effects", "effect", True, _PERCENT),
    )


def _hardest(result: CheckTrialResult) -> Table:
    """Show the visible changes that were detected or listed least often."""
    visible = (*result.some("parameter", visible=True), *result.some("effect", visible=True))
    lines = [_Checks(what, some) for what, some in grouped((one.what, one) for one in visible).items()]
    lines.sort(key=lambda its: (its.found.value, its.of_changes(lambda one: one.listed) or 0.0, its.moved_mm))
    return table_of(
        "Visible changes that are hardest to find or to name",
        lines[:_MOST_LINES],
        ("changed", "title"),
        ("checks", "found.n", "d"),
        ("moves", "moved_mm", ".3f", "mm"),
        ("detected", "found.value", _PERCENT, "%"),
        ("listed", lambda its: its.of_changes(lambda one: one.listed), _PERCENT, "%"),
        ("mean stops", "stops", ".1f"),
    )
