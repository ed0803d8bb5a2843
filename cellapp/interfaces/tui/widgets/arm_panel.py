"""Panels of one arm and of the tracker while a job runs: the newest known state, in a few lines.

The strip below the header of every screen: age of the data of arms, tracker and job, and the progress of a halt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from textual.app import ComposeResult
from textual.containers import Vertical
from textual.content import Content
from textual.reactive import reactive
from textual.widget import Widget

from cellapp.ground.progress import CellLive
from cellapp.interfaces.tui.job_record import (
    HALT_WORDS,
    Activity,
    ArmRecord,
    Freshness,
    TrackerRecord,
    banner_of,
    strip_of,
)
from cellapp.interfaces.tui.widgets.controls import Line

_STYLES: Mapping[Activity, str] = {
    "unknown": "$text-muted",
    "moving": "bold $text-warning",
    "settling": "$text-primary",
    "measuring": "$text-primary",
    "measured": "$text-success",
    "not measured": "bold $text-error",
    "resting": "$text-muted",
    "stopped": "bold $text-error",
    "asked": "bold $text-error",
    "braking": "bold $text-error",
    "at rest": "bold $text-warning",
    "not seen at rest": "bold white on $error",
}
_UNKNOWN = "not reported yet"


class ArmPanel(Widget):
    """Name, activity, joint positions, joint temperatures, error of the newest stop, standard error so far."""

    arm: reactive[ArmRecord] = reactive(ArmRecord)

    def __init__(self, name: str) -> None:
        super().__init__(classes="arm")
        self.arm_name = name
        self.tooltip = (
            f"Arm {name}: what it does; joint positions; joint temperatures; distance of the newest measured point from"
            " the model; standard error of a predicted position."
        )

    def render(self) -> Content:
        """Return the lines of the panel."""
        width = self.content_size.width
        first = Content.assemble((self.arm_name, "bold"), " ", (activity_words(self.arm), _STYLES[self.arm.activity]))
        return Content("\n").join([first, *(Content(line) for line in arm_lines(self.arm, width))])


def activity_words(arm: ArmRecord) -> str:
    """Return what an arm does: ``MOVING to stop 13, 4 s``."""
    stop = "" if arm.stop is None else f" stop {arm.stop + 1}"
    match arm.activity:
        case "unknown":
            return "-"
        case "moving":
            seconds = "" if arm.expected_s is None else f", {arm.expected_s:.0f} s"
            return f"MOVING{' to' if stop else ''}{stop}{seconds}"
        case "asked" | "braking" | "at rest" | "not seen at rest" as halt:
            return HALT_WORDS[halt]
        case "not measured":
            return f"NOT MEASURED{stop}: {arm.reason}"
        case activity:
            return f"{activity.upper()}{stop}"


def arm_lines(arm: ArmRecord, width: int) -> list[str]:
    """Return joint positions [deg], temperatures [degC] and errors [mm] in lines of at most ``width`` characters."""
    degrees = None if arm.q is None else [math.degrees(q) for q in arm.q]
    report = arm.report
    error = _UNKNOWN
    if report is not None:
        error = f"{report.residual_mm:.3f} mm, std. error {report.standard_error_mm:.4f} mm"
    return [
        f"q   {_numbers(degrees, '°', width - 4)}",
        f"T   {_numbers(arm.joint_temperature_c, '°C', width - 4)}",
        f"err {error}",
    ]


def _numbers(values: Sequence[float] | None, unit: str, width: int) -> str:
    """Format values with one decimal if they fit, else rounded, followed by the unit."""
    if values is None:
        return _UNKNOWN
    with_decimal = " ".join(f"{value:6.1f}" for value in values) + f" {unit}"
    return with_decimal if len(with_decimal) <= width else " ".join(f"{value:4.0f}" for value in values) + f" {unit}"


def tracker_words(tracker: TrackerRecord) -> str:
    """Return arm, newest point [mm], uncertainty [mm] and air in one line; during a sweep, its progress."""
    if tracker.sweep is not None:
        return f"→ {tracker.sweep.arm}, sweep {' · '.join(tracker.sweep.words())}"
    parts = []
    if tracker.arm is not None:
        parts.append(f"→ {tracker.arm}{', measuring' if tracker.measuring else ''}")
    if tracker.point is not None:
        x, y, z = (1e3 * value for value in tracker.point.p_M)
        sigma = "" if tracker.point.sigma_mm is None else f" ± {tracker.point.sigma_mm:.3f}"
        at = "at" if tracker.point.arm == tracker.arm else f"{tracker.point.arm} at"
        parts.append(f"{at} ({x:z.3f}, {y:z.3f}, {z:z.3f}){sigma} mm")
    if tracker.air is not None:
        air = tracker.air
        pressure = "" if air.pressure_hpa is None else f", {air.pressure_hpa:.0f} hPa"
        humidity = "" if air.humidity_percent is None else f", {air.humidity_percent:.0f} %"
        parts.append(f"air {air.temperature_c:.2f} °C{pressure}{humidity}")
    return " · ".join(parts) or "has measured nothing yet"


_STRIP_STYLES: Mapping[Freshness, str] = {
    "fresh": "$text-success",
    "late": "bold $text-warning",
    "lost": "bold white on $error",
}


class LiveStrip(Vertical):
    """Ages in one line while a cell is open; above them, in red, a stop or an arm that counts as moving.

    The application draws it ten times a second, so that neither a job that hangs nor a missing event leaves it
    out of date.
    """

    def compose(self) -> ComposeResult:
        yield Line(classes="banner")
        yield Line(classes="ages")

    def show(self, live: CellLive | None, unseen: Mapping[str, str]) -> None:
        """Draw the state, and the arms that the run counts as moving, arm -> why."""
        line, parts = self.query_one(".banner", Line), [] if live is None else strip_of(live)
        if (banner := banner_of(live, unseen)) is None:
            line.say("", "banner")
        else:
            words, causes, alarm = banner
            line.say("\n".join([words, *causes[:2]]), f"banner shown{' alarm' if alarm else ''}")
        ages = Content("   ").join(Content.styled(text, _STRIP_STYLES[look]) for text, look in parts)
        self.query_one(".ages", Line).say(ages, "ages shown" if parts else "ages")
