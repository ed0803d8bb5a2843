"""Charts of tests by ISO 9283: accuracy as found and as left, error of each visit over the cycles, drift."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cellapp.commands.view.charts import Axis, Chart, Limit, Series, mm, series
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result
from cellapp.ground.counting import counted


def iso9283_charts(result: Iso9283Result) -> list[Chart]:
    """Show accuracy at the poses, each arm's errors over the cycles with its last commands, drift; only non-empty
    charts.

    If AP is judged, its tolerance is drawn as a line.
    """
    tolerances_mm = (one.tolerance_mm for one in result.judgements if one.characteristic == "pose_accuracy")
    pose_tolerance_mm = next(tolerances_mm, None)
    charts = [accuracy_chart(result, pose_tolerance_mm)]
    for name, arm in result.arms.items():
        for kind in reversed(ISO_COMMANDS):
            if kind in arm.tests and arm.tests[kind].pose:
                charts.append(cycle_chart(name, kind, arm.tests[kind], pose_tolerance_mm))
                break
    return [chart for chart in (*charts, drift_chart(result)) if not chart.is_empty]


def accuracy_chart(result: Iso9283Result, tolerance_mm: float | None = None) -> Chart:
    """Show AP of every arm at each pose, with each kind of commands."""
    drawn: list[Series] = []
    words = []
    for name, arm in result.arms.items():
        for kind in ISO_COMMANDS:
            poses = arm.tests[kind].pose if kind in arm.tests else ()
            if not poses:
                continue
            values = [pose.accuracy for pose in poses]
            largest = max(value.value_mm for value in values)
            hints = [f"{pose.pose}: U = {mm(pose.accuracy.expanded_mm or 0.0)}" for pose in poses]
            numbers = [float(pose.pose[1:]) for pose in poses]
            found = [value.value_mm for value in values]
            title = f"arm {name}, {kind}"
            drawn.append(series(title, numbers, found, "points", style=len(drawn), hints=hints))
            words.append(f"{title}: {mm(largest)}")
    return Chart(
        "Pose accuracy at the five poses",
        Axis("pose P"),
        Axis("AP", "mm", logarithmic=True),
        tuple(drawn),
        f"Largest pose accuracy AP, by arm and commands: {'; '.join(words)}.",
        _limits(tolerance_mm),
    )


def cycle_chart(name: str, kind: IsoCommands, tests: CommandedTests, tolerance_mm: float | None = None) -> Chart:
    """Show the distance of each attained from the commanded position, pose by pose, over all cycles."""
    errors = [np.linalg.norm(np.array(pose.deviations_mm), axis=1) for pose in tests.pose]
    drawn = [
        series(pose.pose, np.arange(1.0, len(one) + 1.0), one, "points", style=number)
        for number, (pose, one) in enumerate(zip(tests.pose, errors, strict=True))
    ]
    worst = max(tests.pose, key=lambda pose: pose.accuracy.value_mm)
    return Chart(
        f"Arm {name}: error at each visit, {kind} commands",
        Axis("cycle"),
        Axis("error", "mm"),
        tuple(drawn),
        f"Largest pose accuracy AP {mm(worst.accuracy.value_mm)} at {worst.pose}, largest repeatability RP"
        f" {mm(max(pose.repeatability.value_mm for pose in tests.pose))}, {counted(worst.accuracy.n, 'cycle')}.",
        _limits(tolerance_mm),
    )


def drift_chart(result: Iso9283Result) -> Chart:
    """Show the displacement of the mean position at P1 from the first group of cycles, by arm."""
    drawn, words = [], []
    for style, (name, tests) in enumerate(_drifting(result)):
        drift = tests.drift
        assert drift is not None
        errors = np.array([group.error_mm for group in drift.groups])
        moved = np.linalg.norm(errors - errors[0], axis=1)
        drawn.append(series(f"arm {name}", [group.minutes for group in drift.groups], moved, style=style))
        words.append(f"arm {name} {mm(drift.shift_mm)} in {drift.minutes:.0f} min")
    message = f"The mean position at P1 moved by: {'; '.join(words)}." if words else "Drift was not measured."
    return Chart("Drift at P1", Axis("after", "min"), Axis("displacement", "mm"), tuple(drawn), message)


def _limits(tolerance_mm: float | None) -> tuple[Limit, ...]:
    return () if tolerance_mm is None else (Limit("tolerance of AP", tolerance_mm),)


def _drifting(result: Iso9283Result) -> Iterator[tuple[str, CommandedTests]]:
    for name, arm in result.arms.items():
        for kind in reversed(ISO_COMMANDS):
            tests = arm.tests.get(kind)
            if tests is not None and tests.drift is not None:
                yield name, tests
                break
