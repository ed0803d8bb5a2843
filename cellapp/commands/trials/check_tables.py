"""Tables of ``trials check``."""

from __future__ import annotations

from collections.abc import Sequence

from cellapp.commands.trials.check_records import CheckedChange, CheckTrialResult, Group, share
from cellapp.commands.view.table import Cell, Column, Interval, Table, number_column

_PERCENT = ".1f"
_TITLES: dict[Group, str] = {
    "unchanged": "nothing",
    "parameter": "a parameter by 0.05 mm or 50 urad",
    "effect": "stiffness, play or eccentricity",
    "tracker": "tracker",
    "base": "base of an arm",
    "smr": "SMR",
}
_MOST_LINES = 15
"""Parameters with the fewest detections that are shown."""


def check_trial_tables(result: CheckTrialResult) -> list[Table]:
    """Shares by what was changed, statistics compared, and the changes that are hardest to find."""
    if not result.some("parameter"):
        return [_groups(result)]
    return [_groups(result), _statistics(result), _hardest(result)]


def check_trial_sentences(result: CheckTrialResult) -> list[str]:
    """How the tables came about, and which bars are missed."""
    false, found = result.false_alarms(), result.found()
    alarms = f"False alarms: {false.value:.2%} of {false.n} [{false.low:.2%}, {false.high:.2%}], at most 1 %."
    if not found.n:
        return [f"{result.cells} calibrations of measured robots, {false.n} checks on other rows. {alarms}"]
    return [
        f"{result.cells} cells, {len(result.checks)} checks of at most {result.planned} stops"
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
    rows: list[tuple[Cell, ...]] = []
    for group, title in _TITLES.items():
        for visible in (True, False):
            some = result.some(group, visible=visible)
            if some:
                hidden = "" if visible or group == "unchanged" else ", not visible"
                rows.append((f"{title}{hidden}", *_cells(some)))
    columns = (
        Column("changed"),
        number_column("checks", "d"),
        number_column("detected", _PERCENT, "%"),
        number_column("95 %", _PERCENT, "%"),
        number_column("named", _PERCENT, "%"),
        number_column("listed", _PERCENT, "%"),
        number_column("cannot say", "d"),
        number_column("mean stops", ".1f"),
        number_column("largest error", ".3f", "mm"),
    )
    return Table(f"{result.profile}: what was changed and what the check found", columns, tuple(rows))


def _cells(some: Sequence[CheckedChange]) -> tuple[Cell, ...]:
    found = share(some, lambda one: one.alarm)
    changed = some[0].group != "unchanged"
    solved = [one.solved_mm for one in some if one.solved_mm is not None]
    return (
        found.n,
        100.0 * found.value,
        Interval(100.0 * found.low, 100.0 * found.high),
        100.0 * share(some, lambda one: one.named).value if changed else None,
        100.0 * share(some, lambda one: one.listed).value if changed else None,
        sum(one.verdict == "cannot say" for one in some),
        sum(one.stops for one in some) / len(some),
        max(solved, default=None),
    )


def _statistics(result: CheckTrialResult) -> Table:
    """The sequential test beside tests after all planned stops, each at 1 % false alarms."""
    rows: list[tuple[Cell, ...]] = []
    for name, fact in (
        ("stop by stop", lambda one: one.alarm),
        ("all directions, after all stops", lambda one: one.by_directions),
        ("chi-squared alone, after all stops", lambda one: one.by_chi_squared),
    ):
        shares = [
            share(result.some("unchanged"), fact),
            share(result.some("parameter", visible=True), fact),
            share(result.some("parameter", visible=False), fact),
            share(result.some("effect", visible=True), fact),
        ]
        rows.append((name, *(100.0 * one.value if one.n else None for one in shares)))
    columns = (
        Column("statistic"),
        number_column("unchanged", ".2f", "%"),
        number_column("parameters", _PERCENT, "%"),
        number_column("parameters not visible", _PERCENT, "%"),
        number_column("effects", _PERCENT, "%"),
    )
    return Table("Found by", columns, tuple(rows))


def _hardest(result: CheckTrialResult) -> Table:
    """Visible changes that were detected or listed least."""
    by: dict[str, list[CheckedChange]] = {}
    for one in (*result.some("parameter", visible=True), *result.some("effect", visible=True)):
        by.setdefault(one.what, []).append(one)
    rows = sorted(
        (
            (
                what,
                len(some),
                sum(one.moved_mm for one in some) / len(some),
                100.0 * share(some, lambda one: one.alarm).value,
                100.0 * share(some, lambda one: one.listed).value,
                sum(one.stops for one in some) / len(some),
            )
            for what, some in by.items()
        ),
        key=lambda row: (row[3], row[4], row[2]),
    )
    columns = (
        Column("changed"),
        number_column("checks", "d"),
        number_column("moves", ".3f", "mm"),
        number_column("detected", _PERCENT, "%"),
        number_column("listed", _PERCENT, "%"),
        number_column("mean stops", ".1f"),
    )
    return Table("Visible changes that are hardest to find or to name", columns, tuple(rows[:_MOST_LINES]))
