"""The result of ``iso9283`` as tables and sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cellapp.commands.iso9283.request import Iso9283Request
from cellapp.commands.record import View
from cellapp.commands.view.charts import Axis, Chart, Series, noise_limit, series
from cellapp.commands.view.parts import Part, Section, section_of
from cellapp.commands.view.table import Field, Table, table_of
from cellapp.commands.view.words import RULE_WORDS
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands
from cellapp.estimation.iso9283.records import CommandedTests, Iso9283Result, IsoValue, PoseCharacteristics, SpeedSeries
from cellapp.estimation.uncertainty.records import overall
from cellapp.ground.counting import counted, mm
from cellapp.ground.results import Record

_UNCERTAIN_SHARE = 0.25
"""The norm's limit of the measuring uncertainty, as a share of the characteristic (6.5)."""
_VALUES: Mapping[str, Callable[[CommandedTests], Sequence[IsoValue]]] = {
    "pose accuracy AP": lambda tests: [one.accuracy for one in tests.pose],
    "distance accuracy AD": lambda tests: [one.accuracy for one in tests.distance],
    "variation vAP": lambda tests: [one.variation for one in tests.multidirectional],
    "path accuracy AT": lambda tests: [one.accuracy for one in tests.path],
    "drift dAP": lambda tests: [] if tests.drift is None else [tests.drift.accuracy],
}
"""Characteristics in order of preference; the first measured one makes the message of an arm."""
_COMMANDED: tuple[Field, ...] = (("arm", "arm"), ("commands", "commands"))
"""First columns of a table of ``_Commanded``."""


def view(result: Iso9283Result, request: Iso9283Request | None = None) -> View:
    """Show the characteristics, the outcome, where they are stored, and what did not hold."""
    stored = [] if request is None or request.folder is None else [f"stored in {request.folder}"]
    parts: tuple[Part, ...] = (*iso9283_tables(result), *iso9283_sentences(result), *stored, *iso9283_charts(result))
    return View(parts, result.complaints())


def iso9283_section(result: Iso9283Result, about: str) -> Section:
    """Show first what decides: judgements, poses, distances, tests; the other tables are folded."""
    tables = _tables(result)
    first, others = ([table for leads, table in tables if leads is asked] for asked in (True, False))
    details = [Section(others, folded=True, title="All other characteristics")] if others else []
    return section_of([*first, *iso9283_sentences(result), *iso9283_charts(result), *details], about=about)


def iso9283_tables(result: Iso9283Result) -> list[Table]:
    """Show judgements, characteristics of each test, and cubes; only what was measured."""
    return [table for _, table in _tables(result)]


def _tables(result: Iso9283Result) -> list[tuple[bool, Table]]:
    """Return the non-empty tables in their order, each with whether it decides."""
    tables = [
        (True, _judgements(result)),
        (True, _poses(result)),
        (True, _orientations(result)),
        (False, _series(result)),
        (True, _cooperative(result)),
        (False, _directions(result)),
        (True, _distances(result)),
        (False, _drift(result)),
        (False, _paths(result)),
        (False, _velocities(result)),
        (True, _coverage(result)),
        (False, _cubes(result)),
    ]
    return [(leads, table) for leads, table in tables if table.rows]


def iso9283_sentences(result: Iso9283Result) -> list[str]:
    """State the outcome; then conditions, what is missing, what limits the tests, notes."""
    return [
        _message(result),
        *([result.stopped] if result.stopped else []),
        *dict.fromkeys(RULE_WORDS[one.rule] for one in result.judgements),
        *_conditions(result),
        *_bases(result),
        *(
            f"arm {name}: the cube is limited by: {arm.cube.limited_by}"
            for name, arm in result.arms.items()
            if arm.cube
        ),
        *_uncertain(result),
        *(f"missing: {words}" for words in result.missing),
        *_refused(result),
        *(f"{' and '.join(pair.arms)}: {pair.refused}" for pair in result.pairs if pair.refused),
        *result.notes,
        *([f"all measured points with their times: {result.points_file}"] if result.points_file else []),
    ]


# -- sentences --------------------------------------------------------------------------------------------------------


def _message(result: Iso9283Result) -> str:
    """State the results of the tests, against the tolerances if there are any."""
    parts = []
    for name, arm in result.arms.items():
        for what, values in _VALUES.items():
            if words := _largest({kind: values(tests) for kind, tests in arm.tests.items()}):
                parts.append(f"arm {name} has a {what} of {words}")
                break
    for pair in result.pairs:
        if words := _largest({kind: [one.accuracy for one in poses] for kind, poses in pair.vector.items()}):
            parts.append(f"{' and '.join(pair.arms)} together of {words}")
    measured = "; ".join(parts) or f"tests by ISO 9283: {', '.join(result.tests)}"
    verdict = {
        "conforms": "all that has a tolerance conforms",
        "does not conform": "not all that has a tolerance conforms",
        "not decided": "not all can be decided against its tolerance",
        None: "",
    }[overall(result.judgements)]
    return f"{measured}{f'; {verdict}' if verdict else ''}"


def _largest(values: Mapping[IsoCommands, Sequence[IsoValue]]) -> str:
    """State the largest value with each kind of commands."""
    return ", ".join(
        f"{max(abs(one.value_mm) for one in values[kind]):.3f} mm ({kind})" for kind in ISO_COMMANDS if values.get(kind)
    )


def _conditions(result: Iso9283Result) -> Iterator[str]:
    made = result.conditions
    if made is None:
        return
    loads = ", ".join(f"{name} {arm.payload_kg:g} kg" for name, arm in result.arms.items())
    air = ""
    if made.temperature_c is not None:
        low, high = made.temperature_c
        air = f"; air {low:.1f} degC" if high - low < 0.05 else f"; air {low:.1f} to {high:.1f} degC"
    yield (
        f"{counted(made.cycles, 'cycle')} at {made.speed_share:.0%} of the profile's speed, {made.dwell_s:g} s of"
        " rest before each"
        f" measurement of {made.averaging_s:g} s; payload: {loads}{air}; {made.seconds / 60.0:.0f} min in all"
    )


def _bases(result: Iso9283Result) -> Iterator[str]:
    for name, arm in result.arms.items():
        if arm.base is not None:
            yield (
                f"arm {name}: base and SMR fitted to {counted(arm.base.n, 'position')}, residuals"
                f" {arm.base.rms_mm:.3f} mm rms;"
                f" the fit adds {arm.base.uncertainty_mm:.3f} mm to the standard uncertainty of a commanded coordinate"
            )


def _uncertain(result: Iso9283Result) -> Iterator[str]:
    """Yield arms whose repeatability the tracker cannot resolve by the norm's own rule."""
    for name, arm in result.arms.items():
        poses = [pose for tests in arm.tests.values() for pose in tests.pose if _is_uncertain(pose)]
        if poses:
            yield (
                f"arm {name}: the tracker's stated uncertainty alone may show an RP of"
                f" {max(pose.tracker_rp_mm or 0.0 for pose in poses):.3f} mm, more than a quarter of what was measured:"
                " the arm's own may be much smaller"
            )


def _refused(result: Iso9283Result) -> Iterator[str]:
    """Yield tests that could not be made, with the reason; each reason once."""
    for name, arm in result.arms.items():
        for reason in dict.fromkeys(arm.refused.values()):
            tests = ", ".join(test for test, why in arm.refused.items() if why == reason)
            yield f"arm {name}: not tested: {tests}: {reason}"


def _is_uncertain(pose: PoseCharacteristics) -> bool:
    return pose.tracker_rp_mm is not None and pose.tracker_rp_mm > _UNCERTAIN_SHARE * pose.repeatability.value_mm


# -- tables -----------------------------------------------------------------------------------------------------------


def _judgements(result: Iso9283Result) -> Table:
    return table_of(
        "Characteristics against their tolerances",
        result.judgements,
        ("characteristic", lambda one: one.characteristic.replace("_", " ")),
        ("of", "where"),
        ("value", "value_mm", ".3f", "mm"),
        ("U", "expanded_mm", ".3f", "mm"),
        ("tolerance", "tolerance_mm", ".3f", "mm"),
        ("verdict", "conformity"),
        ("measured", "source"),
    )


def _poses(result: Iso9283Result) -> Table:
    return table_of(
        "Pose accuracy AP and repeatability RP [mm]",
        _measured(result, "pose"),
        *_COMMANDED,
        ("pose", "one.pose"),
        *_pair_fields("AP", "RP"),
    )


def _orientations(result: Iso9283Result) -> Table:
    """Show angles about the base axes at the poses where a probe measured the orientation."""
    return table_of(
        "Orientation accuracy AP and repeatability RP about the axes of the base [mrad]",
        [row for row in _measured(result, "pose") if row.one.orientation is not None],
        *_COMMANDED,
        ("pose", "one.pose"),
        *(
            (f"{short} {axis}", lambda row, what=what, place=place: getattr(row.one.orientation, what)[place], ".3f")
            for short, what in (("AP", "accuracy_mrad"), ("RP", "repeatability_mrad"))
            for place, axis in enumerate("xyz")
        ),
        ("U(AP)", "one.orientation.accuracy_expanded_mrad", ".3f"),
        ("U(RP)", "one.orientation.repeatability_expanded_mrad", ".3f"),
        ("n", "one.orientation.n", "d"),
    )


def _series(result: Iso9283Result) -> Table:
    return table_of(
        "Pose accuracy AP and repeatability RP at other speeds [mm]",
        [_Commanded(name, kind, pose, tests) for name, kind, tests in _series_of(result) for pose in tests.pose],
        *_COMMANDED,
        ("speed", "of.speed_share", ".0f", "%"),
        ("pose", "one.pose"),
        *_pair_fields("AP", "RP"),
    )


def _cooperative(result: Iso9283Result) -> Table:
    rows = [
        _Commanded(" and ".join(pair.arms), kind, *both)
        for pair in result.pairs
        for kind in ISO_COMMANDS
        for both in zip(pair.vector.get(kind, ()), pair.distance.get(kind, ()), strict=True)
    ]
    *vectors, n = _pair_fields("AP", "RP")
    *distances, _ = _pair_fields("AD", "RD", "of")
    title = "Cooperative accuracy and repeatability [mm]: vector and distance between both SMRs"
    return table_of(
        title, rows, ("arms", "arm"), ("commands", "commands"), ("poses", "one.pose"), *vectors, *distances, n
    )


def _directions(result: Iso9283Result) -> Table:
    return table_of(
        "Multi-directional pose accuracy variation vAP [mm]",
        _measured(result, "multidirectional"),
        *_COMMANDED,
        ("pose", "one.pose"),
        ("vAP", "one.variation.value_mm", ".3f"),
        ("U", "one.variation.expanded_mm", ".3f"),
        ("n", "one.variation.n", "d"),
    )


def _distances(result: Iso9283Result) -> Table:
    return table_of(
        "Distance accuracy AD and repeatability RD [mm]",
        _measured(result, "distance"),
        *_COMMANDED,
        ("between", lambda row: " and ".join(row.one.between)),
        ("commanded", "one.commanded_mm", ".3f"),
        *_pair_fields("AD", "RD"),
    )


def _drift(result: Iso9283Result) -> Table:
    *pairs, _ = _pair_fields("dAP", "dRP")
    return table_of(
        "Drift at P1 [mm]",
        [_Commanded(name, kind, tests.drift) for name, kind, tests in _tests_of(result) if tests.drift is not None],
        *_COMMANDED,
        ("observed", "one.minutes", ".0f", "min"),
        *pairs,
        ("shift of the mean", "one.shift_mm", ".3f"),
        ("groups", lambda row: len(row.one.groups), "d"),
    )


def _paths(result: Iso9283Result) -> Table:
    return table_of(
        "Path accuracy AT and repeatability RT [mm]",
        _driven(result),
        *_COMMANDED,
        ("path", "one.path"),
        ("speed", "one.speed_mm_s", ".0f", "mm/s"),
        ("length", "one.length_mm", ".0f"),
        *_pair_fields("AT", "RT"),
    )


def _velocities(result: Iso9283Result) -> Table:
    return table_of(
        "Path velocity: accuracy AV, repeatability RV, fluctuation FV",
        [row for row in _driven(result) if row.one.velocity is not None],
        *_COMMANDED,
        ("path", "one.path"),
        ("commanded", "one.speed_mm_s", ".0f", "mm/s"),
        ("AV [%]", "one.velocity.accuracy_percent", ".3f"),
        ("U(AV) [%]", "one.velocity.expanded_percent", ".3f"),
        ("RV [%]", "one.velocity.repeatability_percent", ".3f"),
        ("FV", "one.velocity.fluctuation_mm_s", ".2f", "mm/s"),
        ("tracker's FV", "one.velocity.tracker_fluctuation_mm_s", ".2f", "mm/s"),
        ("n", "one.velocity.n", "d"),
        ("programme", lambda row: row.one.slowed or "keeps the speed"),
    )


def _driven(result: Iso9283Result) -> list[_Commanded]:
    """Return every path with its arm and commands, at all speeds."""
    series = [_Commanded(name, kind, one) for name, kind, at_speed in _series_of(result) for one in at_speed.path]
    return [*_measured(result, "path"), *series]


def _coverage(result: Iso9283Result) -> Table:
    """Show what the norm requires: done, done in part or not done, and how or why not."""
    return table_of(
        "What ISO 9283:1998 asks for, done and not done",
        result.coverage,
        ("clause", "clause"),
        ("characteristic", "characteristic"),
        ("arms", lambda one: ", ".join(one.arms)),
        ("state", "status"),
        ("how, or why not", "words"),
    )


def _cubes(result: Iso9283Result) -> Table:
    return table_of(
        "Test cubes, axes of the arm's base",
        [(name, arm) for name, arm in result.arms.items() if arm.cube is not None],
        ("arm", lambda row: row[0]),
        ("edge", lambda row: row[1].cube.edge_mm, ".0f", "mm"),
        *(
            (f"centre {axis}", lambda row, place=place: row[1].cube.centre_B[place], ".3f", "m")
            for place, axis in enumerate("xyz")
        ),
        ("plane", lambda row: row[1].cube.plane),
        ("payload", lambda row: row[1].payload_kg, ".3f", "kg"),
        ("limited by", lambda row: row[1].cube.limited_by),
    )


# -- cells -------------------------------------------------------------------------------------------------------------


def _tests_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, CommandedTests]]:
    """Yield arm, commands and the tests with these commands."""
    for name, arm in result.arms.items():
        for kind in ISO_COMMANDS:
            if kind in arm.tests:
                yield name, kind, arm.tests[kind]


def _series_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, SpeedSeries]]:
    """Yield arm, commands and the tests repeated at another speed."""
    for name, kind, tests in _tests_of(result):
        for one in tests.series:
            yield name, kind, one


class _Commanded(NamedTuple):
    """A measurement of an arm with one kind of commands; ``of`` is what it is part of, as a series of tests."""

    arm: str
    commands: IsoCommands
    one: Any
    of: Record | None = None


def _measured(result: Iso9283Result, what: str) -> list[_Commanded]:
    """Return what one kind of test measured, by arm and commands."""
    return [_Commanded(name, kind, one) for name, kind, tests in _tests_of(result) for one in getattr(tests, what)]


def _pair_fields(first: str, second: str, of: str = "one") -> Iterator[Field]:
    """Yield accuracy and repeatability with their expanded uncertainties, and the number of cycles."""
    for name, attribute in ((first, "accuracy"), (second, "repeatability")):
        yield name, f"{of}.{attribute}.value_mm", ".3f"
        yield f"U({name})", f"{of}.{attribute}.expanded_mm", ".3f"
    yield "n", f"{of}.accuracy.n", "d"


def iso9283_charts(result: Iso9283Result) -> list[Chart]:
    """Show accuracy at the poses, with the tolerance of AP if it is judged, and drift; only non-empty charts."""
    tolerances_mm = (one.tolerance_mm for one in result.judgements if one.characteristic == "pose_accuracy")
    charts = (accuracy_chart(result, next(tolerances_mm, None)), drift_chart(result))
    return [chart for chart in charts if not chart.is_empty]


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
            numbers = [float(pose.pose[1:]) for pose in poses]
            found = [value.value_mm for value in values]
            title = f"arm {name}, {kind}"
            drawn.append(series(title, numbers, found, "points", style=len(drawn)))
            words.append(f"{title}: {mm(largest)}")
    return Chart(
        "Pose accuracy at the five poses",
        Axis("pose P"),
        Axis("AP", "mm", logarithmic=True),
        tuple(drawn),
        f"Largest pose accuracy AP, by arm and commands: {'; '.join(words)}.",
        noise_limit(tolerance_mm, name="tolerance of AP"),
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


def _drifting(result: Iso9283Result) -> Iterator[tuple[str, CommandedTests]]:
    for name, arm in result.arms.items():
        for kind in reversed(ISO_COMMANDS):
            tests = arm.tests.get(kind)
            if tests is not None and tests.drift is not None:
                yield name, tests
                break
