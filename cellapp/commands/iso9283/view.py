"""The result of ``iso9283`` as tables and sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from cellapp.commands.iso9283.request import Iso9283Request
from cellapp.commands.judgements import found_in
from cellapp.commands.record import View
from cellapp.commands.view.charts import Axis, Chart, series
from cellapp.commands.view.parts import Part, Section, section_of
from cellapp.commands.view.table import Field, Table, table_of, with_rows
from cellapp.commands.view.words import CHARACTERISTIC_WORDS, RULE_WORDS, judged_sentence, judgement_table
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands, IsoTest
from cellapp.estimation.iso9283.records import Iso9283Result, IsoValue
from cellapp.ground.counting import counted, mm
from cellapp.ground.grouping import grouped

_UNCERTAIN_SHARE = 0.25
"""The norm's limit of the measuring uncertainty, as a share of the characteristic (6.5)."""
_COMMANDED: tuple[Field, ...] = (("arm", "arm"), ("commands", "commands"))
"""First columns of a table of ``_Commanded``."""
_AT_SPEED: Field = ("speed", "speed_share", ".0f", "%")


def _pair_fields(first: str, second: str, of: str = "one") -> Iterator[Field]:
    """Yield accuracy and repeatability with their expanded uncertainties, and the number of cycles."""
    for name, attribute in ((first, "accuracy"), (second, "repeatability")):
        yield name, f"{of}.{attribute}.value_mm", ".3f"
        yield f"U({name})", f"{of}.{attribute}.expanded_mm", ".3f"
    yield "n", f"{of}.accuracy.n", "d"


_POSE: Field = ("pose", "one.pose")
_TESTS: Mapping[IsoTest, tuple[str, tuple[Field, ...]]] = {
    "pose": ("Pose accuracy AP and repeatability RP [mm]", (_AT_SPEED, _POSE, *_pair_fields("AP", "RP"))),
    "multidirectional": (
        "Multi-directional pose accuracy variation vAP [mm]",
        (
            _POSE,
            ("vAP", "one.variation.value_mm", ".3f"),
            ("U", "one.variation.expanded_mm", ".3f"),
            ("n", "one.variation.n", "d"),
        ),
    ),
    "distance": (
        "Distance accuracy AD and repeatability RD [mm]",
        (
            ("between", lambda row: " and ".join(row.one.between)),
            ("commanded", "one.commanded_mm", ".3f"),
            *_pair_fields("AD", "RD"),
        ),
    ),
    "drift": (
        "Drift at P1 [mm]",
        (
            ("observed", "one.minutes", ".0f", "min"),
            *[*_pair_fields("dAP", "dRP")][:-1],
            ("shift of the mean", "one.shift_mm", ".3f"),
            ("groups", lambda row: len(row.one.groups), "d"),
        ),
    ),
    "path": (
        "Path accuracy AT and repeatability RT [mm]",
        (
            ("path", "one.path"),
            ("speed", "one.speed_mm_s", ".0f", "mm/s"),
            ("length", "one.length_mm", ".0f"),
            *_pair_fields("AT", "RT"),
        ),
    ),
}
"""Title and columns of the table of each test of one arm."""


def view(result: Iso9283Result, request: Iso9283Request | None = None) -> View:
    """Show the characteristics, the outcome, where they are stored, and what did not hold."""
    stored = [] if request is None or request.folder is None else [f"stored in {request.folder}"]
    parts: tuple[Part, ...] = (*iso9283_tables(result), *iso9283_sentences(result), *stored, *iso9283_charts(result))
    return View(parts, result.complaints())


def iso9283_section(result: Iso9283Result, about: str) -> Section:
    """Show first what decides; the other tables are folded."""
    others = _other_tables(result)
    details = [Section(others, folded=True, title="All other characteristics")] if others else []
    first: list[Part] = [*_deciding_tables(result), *iso9283_sentences(result), *iso9283_charts(result)]
    return section_of([*first, *details], about=about)


def iso9283_tables(result: Iso9283Result) -> list[Table]:
    """Show judgements, characteristics of each test, and cubes; only what was measured."""
    return [*_deciding_tables(result), *_other_tables(result)]


def _deciding_tables(result: Iso9283Result) -> list[Table]:
    measured = (_of_test(result, "pose"), _orientations(result), _cooperative(result), _of_test(result, "distance"))
    return with_rows(judgement_table(result.judgements), *measured, _coverage(result))


def _other_tables(result: Iso9283Result) -> list[Table]:
    others: tuple[IsoTest, ...] = ("multidirectional", "drift", "path")
    return with_rows(*(_of_test(result, test) for test in others), _velocities(result), _cubes(result))


def iso9283_sentences(result: Iso9283Result) -> list[str]:
    """State the outcome; then conditions, what is missing, what limits the tests, notes."""
    return [
        _message(result),
        *([judged_sentence(result.judgements)] if result.judgements else []),
        *([result.stopped] if result.stopped else []),
        *dict.fromkeys(RULE_WORDS[one.rule] for one in result.judgements),
        *_conditions(result),
        *_bases(result),
        *_uncertain(result),
        *(f"missing: {words}" for words in result.missing),
        *_refused(result),
        *(f"{' and '.join(pair.arms)}: {pair.refused}" for pair in result.pairs if pair.refused),
        *result.notes,
        *([f"all measured points with their times: {result.points_file}"] if result.points_file else []),
    ]


# -- sentences --------------------------------------------------------------------------------------------------------


def _message(result: Iso9283Result) -> str:
    """State the first characteristic that was measured of each arm, and of two arms together."""
    parts = []
    for name, arm in result.arms.items():
        measured = grouped(
            (one.characteristic, (kind, one.value)) for kind in arm.tests for one in found_in(arm.tests[kind])
        )
        if measured:
            what, values = next(iter(measured.items()))
            parts.append(f"arm {name}: {CHARACTERISTIC_WORDS[what]} {_largest(grouped(values))}")
    for pair in result.pairs:
        if words := _largest({kind: [one.accuracy for one in poses] for kind, poses in pair.vector.items()}):
            parts.append(f"{' and '.join(pair.arms)} together: {words}")
    return "; ".join(parts) or f"tests by ISO 9283: {', '.join(result.tests)}"


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
        poses = [pose for tests in arm.tests.values() for pose in tests.pose]
        shown_mm = [(pose.tracker_rp_mm or 0.0, pose.repeatability.value_mm) for pose in poses]
        if large_mm := [by_tracker for by_tracker, rp in shown_mm if by_tracker > _UNCERTAIN_SHARE * rp]:
            yield (
                f"arm {name}: the tracker's stated uncertainty alone may show an RP of {max(large_mm):.3f} mm, more"
                " than a quarter of what was measured: the arm's own may be much smaller"
            )


def _refused(result: Iso9283Result) -> Iterator[str]:
    """Yield tests that could not be made, with the reason; each reason once."""
    for name, arm in result.arms.items():
        for reason in dict.fromkeys(arm.refused.values()):
            tests = ", ".join(test for test, why in arm.refused.items() if why == reason)
            yield f"arm {name}: not tested: {tests}: {reason}"


# -- tables -----------------------------------------------------------------------------------------------------------


def _of_test(result: Iso9283Result, test: IsoTest) -> Table:
    title, fields = _TESTS[test]
    return table_of(title, _measured(result, test), *_COMMANDED, *fields)


def _orientations(result: Iso9283Result) -> Table:
    """Show angles about the base axes at the poses where a probe measured the orientation."""
    return table_of(
        "Orientation accuracy AP and repeatability RP about the axes of the base [mrad]",
        [row for row in _measured(result, "pose") if row.one.orientation is not None],
        *_COMMANDED,
        _AT_SPEED,
        _POSE,
        *(
            (f"{short} {axis}", lambda row, what=what, place=place: getattr(row.one.orientation, what)[place], ".3f")
            for short, what in (("AP", "accuracy_mrad"), ("RP", "repeatability_mrad"))
            for place, axis in enumerate("xyz")
        ),
        ("U(AP)", "one.orientation.accuracy_expanded_mrad", ".3f"),
        ("U(RP)", "one.orientation.repeatability_expanded_mrad", ".3f"),
        ("n", "one.orientation.n", "d"),
    )


def _cooperative(result: Iso9283Result) -> Table:
    rows = [
        _Commanded(" and ".join(pair.arms), kind, vector, distance=distance)
        for pair in result.pairs
        for kind in ISO_COMMANDS
        for vector, distance in zip(pair.vector.get(kind, ()), pair.distance.get(kind, ()), strict=True)
    ]
    *vectors, n = _pair_fields("AP", "RP")
    *distances, _ = _pair_fields("AD", "RD", "distance")
    title = "Cooperative accuracy and repeatability [mm]: vector and distance between both SMRs"
    return table_of(title, rows, *_COMMANDED, ("poses", "one.pose"), *vectors, *distances, n)


def _velocities(result: Iso9283Result) -> Table:
    return table_of(
        "Path velocity: accuracy AV, repeatability RV, fluctuation FV",
        [row for row in _measured(result, "path") if row.one.velocity is not None],
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


class _Commanded(NamedTuple):
    """A measurement of an arm with one kind of commands; ``speed_share`` is of the profile's speed.

    Of two arms, ``one`` is the vector between both SMRs, ``distance`` its length.
    """

    arm: str
    commands: IsoCommands
    one: Any
    speed_share: float | None = None
    distance: Any = None


def _measured(result: Iso9283Result, what: str) -> list[_Commanded]:
    """Return what one kind of test measured, by arm, commands and speed."""
    usual = None if result.conditions is None else result.conditions.speed_share
    return [
        _Commanded(name, kind, one, speed)
        for name, arm in result.arms.items()
        for kind in ISO_COMMANDS
        if (tests := arm.tests.get(kind)) is not None
        for speed, made in ((usual, tests), *((series.speed_share, series) for series in tests.series))
        for one in _all(getattr(made, what, None))
    ]


def _all(found: Any) -> Sequence[Any]:
    """Return what was found as a sequence: of drift there is one, or none."""
    return found if isinstance(found, tuple) else () if found is None else (found,)


def iso9283_charts(result: Iso9283Result) -> list[Chart]:
    """Show the displacement of the mean position at P1 from the first group of cycles, by arm; empty without drift."""
    drawn, words = [], []
    for style, row in enumerate(_measured(result, "drift")):
        errors = np.array([group.error_mm for group in row.one.groups])
        moved = np.linalg.norm(errors - errors[0], axis=1)
        title = f"arm {row.arm}, {row.commands}"
        drawn.append(series(title, [group.minutes for group in row.one.groups], moved, style=style))
        words.append(f"{title}: {mm(row.one.shift_mm)} in {row.one.minutes:.0f} min")
    message = f"The mean position at P1 moved by: {'; '.join(words)}."
    return (
        [Chart("Drift at P1", Axis("after", "min"), Axis("displacement", "mm"), tuple(drawn), message)] if drawn else []
    )
