"""The result of ``iso9283`` as tables and sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from cellapp.commands.iso9283.by_hand_tables import by_hand_sentences, by_hand_tables
from cellapp.commands.iso9283.cells import pair_columns, series_of, tests_of, value_cells
from cellapp.commands.iso9283.charts import iso9283_charts
from cellapp.commands.iso9283.norm_tables import abilities_table, coverage_table
from cellapp.commands.iso9283.path_tables import path_tables
from cellapp.commands.iso9283.request import Iso9283Request
from cellapp.commands.record import View
from cellapp.commands.view.acceptance_words import RULE_WORDS
from cellapp.commands.view.parts import Part, Section, section_of
from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.iso9283.ability import ability_words
from cellapp.estimation.iso9283.norm import ISO_COMMANDS, IsoCommands
from cellapp.estimation.iso9283.records import (
    CommandedTests,
    DriftCharacteristics,
    Iso9283Result,
    IsoCube,
    IsoValue,
    PoseCharacteristics,
)
from cellapp.estimation.uncertainty.records import overall
from cellapp.ground.counting import counted

_UNCERTAIN_SHARE = 0.25
"""The norm's limit of the uncertainty of measuring, as share of the characteristic (6.5)."""
_VALUES: Mapping[str, Callable[[CommandedTests], Sequence[IsoValue]]] = {
    "pose accuracy AP": lambda tests: [one.accuracy for one in tests.pose],
    "distance accuracy AD": lambda tests: [one.accuracy for one in tests.distance],
    "variation vAP": lambda tests: [one.variation for one in tests.multidirectional],
    "path accuracy AT": lambda tests: [one.accuracy for one in tests.path],
    "drift dAP": lambda tests: [] if tests.drift is None else [tests.drift.accuracy],
}
"""The first of these that was measured makes the message of an arm."""
_FOUND: Mapping[IsoCommands, str] = {"nominal": "as found", "calibrated": "as left"}


def view(result: Iso9283Result, request: Iso9283Request | None = None) -> View:
    """The characteristics, the outcome, where they are stored, and what did not hold."""
    stored = [] if request is None or request.folder is None else [f"stored in {request.folder}"]
    parts: tuple[Part, ...] = (*iso9283_tables(result), *iso9283_sentences(result), *stored, *iso9283_charts(result))
    return View(parts, result.complaints())


def iso9283_section(result: Iso9283Result, about: str) -> Section:
    """What decides first: judgements, poses, distances, what was tested; the other tables are folded."""
    first = [
        _judgements(result),
        _poses(result),
        _cooperative(result),
        _distances(result),
        coverage_table(result.coverage),
    ]
    titles = {table.title for table in first}
    others = [table for table in iso9283_tables(result) if table.title not in titles]
    details = [Section("All other characteristics", others, folded=True)] if others else []
    shown = [table for table in first if table.rows]
    return section_of("", [*shown, *iso9283_sentences(result), *iso9283_charts(result), *details], about=about)


def iso9283_tables(result: Iso9283Result) -> list[Table]:
    """Judgements, then the characteristics of each test, then the cubes; only what was measured."""
    tables = [
        _judgements(result),
        _poses(result),
        _series(result),
        *by_hand_tables(result),
        _axes(result),
        _cooperative(result),
        _directions(result),
        _distances(result),
        _drift(result),
        _drift_groups(result),
        *path_tables(result),
        _exchange(result),
        abilities_table(result.abilities),
        coverage_table(result.coverage),
        _cubes(result),
        _test_poses(result),
    ]
    return [table for table in tables if table.rows]


def iso9283_sentences(result: Iso9283Result) -> list[str]:
    """The outcome in one sentence first; then conditions, what is missing, what limits the tests, notes."""
    return [
        _message(result),
        *([result.stopped] if result.stopped else []),
        *dict.fromkeys(RULE_WORDS[one.rule] for one in result.judgements),
        *_conditions(result),
        *_bases(result),
        *(f"arm {name}: the cube is limited by: {cube.limited_by}" for name, cube in _cubes_of(result) if cube),
        *(words for one in result.abilities if (words := ability_words(one))),
        *_uncertain(result),
        *by_hand_sentences(result),
        *(f"missing: {words}" for words in result.missing),
        *_refused(result),
        *(f"{' and '.join(pair.arms)}: {pair.refused}" for pair in result.pairs if pair.refused),
        *result.notes,
        *([f"all measured points with their times: {result.points_file}"] if result.points_file else []),
    ]


# -- sentences --------------------------------------------------------------------------------------------------------


def _message(result: Iso9283Result) -> str:
    """What the tests found, against the tolerances where there are some."""
    parts = []
    for name, arm in result.arms.items():
        for what, values in _VALUES.items():
            if words := _largest({kind: values(tests) for kind, tests in arm.tests.items()}):
                parts.append(f"arm {name} has a {what} of {words}")
                break
        else:
            yielded = [one.compliance_um_n for tests in arm.tests.values() for one in tests.compliance]
            parts += [f"arm {name} yields by up to {max(yielded):.1f} µm/N"] if yielded else []
    for pair in result.pairs:
        if words := _largest({kind: [one.accuracy for one in poses] for kind, poses in pair.vector.items()}):
            parts.append(f"{' and '.join(pair.arms)} together of {words}")
    measured = "; ".join(parts) or f"tests by ISO 9283: {', '.join(result.tests)}"
    verdict = {
        "conforms": "all that has a tolerance conforms",
        "does not conform": "not all that has a tolerance conforms",
        "cannot say": "not all can be decided against its tolerance",
        None: "",
    }[overall(result.judgements)]
    return f"{measured}{f'; {verdict}' if verdict else ''}"


def _largest(values: Mapping[IsoCommands, Sequence[IsoValue]]) -> str:
    """The largest value with each kind of commands, in words."""
    return ", ".join(
        f"{max(abs(one.value_mm) for one in values[kind]):.3f} mm {_FOUND[kind]}"
        for kind in ISO_COMMANDS
        if values.get(kind)
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
    """Arms whose repeatability the tracker cannot show by the norm's own rule."""
    for name, arm in result.arms.items():
        poses = [pose for tests in arm.tests.values() for pose in tests.pose if _is_uncertain(pose)]
        if poses:
            yield (
                f"arm {name}: the tracker's stated uncertainty alone may show an RP of"
                f" {max(pose.tracker_rp_mm or 0.0 for pose in poses):.3f} mm, more than a quarter of what was measured:"
                " the arm's own may be much smaller"
            )


def _refused(result: Iso9283Result) -> Iterator[str]:
    """Tests that could not be made, with the reason; each reason once."""
    for name, arm in result.arms.items():
        for reason in dict.fromkeys(arm.refused.values()):
            tests = ", ".join(test for test, why in arm.refused.items() if why == reason)
            yield f"arm {name}: not tested: {tests}: {reason}"


def _is_uncertain(pose: PoseCharacteristics) -> bool:
    return pose.tracker_rp_mm is not None and pose.tracker_rp_mm > _UNCERTAIN_SHARE * pose.repeatability.value_mm


def _cubes_of(result: Iso9283Result) -> Iterator[tuple[str, IsoCube | None]]:
    for name, arm in result.arms.items():
        yield name, arm.cube


# -- tables -----------------------------------------------------------------------------------------------------------


def _judgements(result: Iso9283Result) -> Table:
    columns = (
        Column("characteristic"),
        Column("of"),
        number_column("value", ".3f", "mm"),
        number_column("U", ".3f", "mm"),
        number_column("tolerance", ".3f", "mm"),
        Column("verdict"),
        Column("measured"),
    )
    rows = tuple(
        (
            one.characteristic.replace("_", " "),
            one.where,
            one.value_mm,
            one.expanded_mm,
            one.tolerance_mm,
            one.conformity,
            one.source,
        )
        for one in result.judgements
    )
    return Table("Characteristics against their tolerances", columns, rows)


def _poses(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("pose"),
        *pair_columns("AP", "RP"),
        number_column("n", "d"),
    )
    rows = [
        (name, kind, pose.pose, *value_cells(pose.accuracy), *value_cells(pose.repeatability), pose.accuracy.n)
        for name, kind, tests in tests_of(result)
        for pose in tests.pose
    ]
    return Table("Pose accuracy AP and repeatability RP [mm]", columns, tuple(rows))


def _series(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        number_column("speed", ".0f", "%"),
        Column("pose"),
        *pair_columns("AP", "RP"),
        number_column("n", "d"),
    )
    rows = [
        (
            name,
            kind,
            1e2 * one.speed_share,
            pose.pose,
            *value_cells(pose.accuracy),
            *value_cells(pose.repeatability),
            pose.accuracy.n,
        )
        for name, kind, one in series_of(result)
        for pose in one.pose
    ]
    return Table("Pose accuracy AP and repeatability RP at other speeds [mm]", columns, tuple(rows))


def _axes(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("pose"),
        *(number_column(f"AP {axis}", ".3f") for axis in "xyz"),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, kind, pose.pose, *pose.error_mm) for name, kind, tests in tests_of(result) for pose in tests.pose
    ]
    return Table("Components of AP along the axes of the arm's base [mm]", columns, tuple(rows))


def _cooperative(result: Iso9283Result) -> Table:
    columns = (
        Column("arms"),
        Column("commands"),
        Column("poses"),
        *pair_columns("AP", "RP"),
        *pair_columns("AD", "RD"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = []
    for pair in result.pairs:
        for kind in ISO_COMMANDS:
            both = zip(pair.vector.get(kind, ()), pair.distance.get(kind, ()), strict=True)
            for vector, length in both:
                values = (vector.accuracy, vector.repeatability, length.accuracy, length.repeatability)
                cells = [cell for value in values for cell in value_cells(value)]
                rows.append((" and ".join(pair.arms), kind, vector.pose, *cells, vector.accuracy.n))
    title = "Cooperative accuracy and repeatability [mm]: vector and distance between both SMRs"
    return Table(title, columns, tuple(rows))


def _directions(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("pose"),
        number_column("vAP", ".3f"),
        number_column("U", ".3f"),
        number_column("n", "d"),
    )
    rows = [
        (name, kind, one.pose, *value_cells(one.variation), one.variation.n)
        for name, kind, tests in tests_of(result)
        for one in tests.multidirectional
    ]
    return Table("Multi-directional pose accuracy variation vAP [mm]", columns, tuple(rows))


def _distances(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        Column("between"),
        number_column("commanded", ".3f"),
        *pair_columns("AD", "RD"),
        number_column("n", "d"),
    )
    rows = [
        (
            name,
            kind,
            " and ".join(one.between),
            one.commanded_mm,
            *value_cells(one.accuracy),
            *value_cells(one.repeatability),
            one.accuracy.n,
        )
        for name, kind, tests in tests_of(result)
        for one in tests.distance
    ]
    return Table("Distance accuracy AD and repeatability RD [mm]", columns, tuple(rows))


def _drift(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("commands"),
        number_column("observed", ".0f", "min"),
        *pair_columns("dAP", "dRP"),
        number_column("shift of the mean", ".3f"),
        number_column("groups", "d"),
    )
    rows = [
        (
            name,
            kind,
            one.minutes,
            *value_cells(one.accuracy),
            *value_cells(one.repeatability),
            one.shift_mm,
            len(one.groups),
        )
        for name, kind, one in _drifts(result)
    ]
    return Table("Drift at P1 [mm]", columns, tuple(rows))


def _drift_groups(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        number_column("after", ".0f", "min"),
        number_column("AP", ".3f"),
        number_column("RP", ".3f"),
        *(number_column(f"AP {axis}", ".3f") for axis in "xyz"),
        number_column("air", ".1f", "degC"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, g.minutes, g.accuracy_mm, g.repeatability_mm, *g.error_mm, g.temperature_c, g.n)
        for name, _, one in _drifts(result)
        for g in one.groups
    ]
    return Table("Groups of the drift test [mm]", columns, tuple(rows))


def _exchange(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        Column("compared with"),
        Column("pose"),
        number_column("E", ".3f"),
        number_column("U", ".3f"),
        number_column("n", "d"),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, one.with_run, one.pose, *value_cells(one.value), one.value.n)
        for name, arm in result.arms.items()
        if (one := arm.exchange) is not None
    ]
    return Table("Exchangeability E with nominal commands [mm]", columns, tuple(rows))


def _cubes(result: Iso9283Result) -> Table:
    columns = (
        Column("arm"),
        number_column("edge", ".0f", "mm"),
        *(number_column(f"centre {axis}", ".3f", "m") for axis in "xyz"),
        Column("plane"),
        number_column("payload", ".3f", "kg"),
        Column("limited by"),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, cube.edge_mm, *cube.centre_B, cube.plane, result.arms[name].payload_kg, cube.limited_by)
        for name, cube in _cubes_of(result)
        if cube is not None
    ]
    return Table("Test cubes, axes of the arm's base", columns, tuple(rows))


def _test_poses(result: Iso9283Result) -> Table:
    columns = (Column("arm"), Column("pose"), *(number_column(axis, ".4f", "m") for axis in "xyz"))
    rows: list[tuple[Cell, ...]] = [
        (name, pose.name, *pose.position_B)
        for name, cube in _cubes_of(result)
        if cube is not None
        for pose in cube.poses
    ]
    return Table("Commanded positions of the SMR in the arm's base", columns, tuple(rows))


def _drifts(result: Iso9283Result) -> Iterator[tuple[str, IsoCommands, DriftCharacteristics]]:
    for name, kind, tests in tests_of(result):
        if tests.drift is not None:
            yield name, kind, tests.drift
