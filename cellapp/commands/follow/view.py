"""Planned or driven paths, as tables and sentences."""

from __future__ import annotations

from cellapp.cell.targets.path_records import PathRecord, PathResult
from cellapp.commands.record import Request, View
from cellapp.commands.run_results import StageResults
from cellapp.commands.view.parts import Section, section_of
from cellapp.commands.view.table import Column, Table, number_column, table_of
from cellapp.commands.view.words import RULE_WORDS
from cellapp.ground.counting import counted
from cellapp.ground.results import FOLLOW, PATH


def view(result: PathResult, request: Request | None = None) -> View:
    """Show the paths, what limits them, and why following failed."""
    return View((*path_tables(result), *path_sentences(result)), result.complaints())


def paths_section(result: PathResult) -> Section:
    """Show the paths of a run, with how many can be driven and how many were."""
    refused = sum(bool(path.refusal) for path in result.paths)
    driven = sum(path.driven is not None for path in result.paths)
    words = f"{len(result.paths) - refused} of {len(result.paths)} paths can be driven"
    return section_of(
        "",
        view(result).parts,
        message=f"{words}; {driven} were driven." if driven else f"{words}.",
        about="Lines and arcs with speeds, as joint paths of the calibrated model: distances of the measured SMR from"
        " the wanted path, moving and at rest, and on the path of the published geometry. 'cellapp docs paths' explains"
        " them.",
    )


def stored_paths(results: StageResults) -> PathResult | None:
    """Return the paths measured last; else those planned or driven last. None if neither result holds."""
    for name, stored in ((FOLLOW, results.follow), (PATH, results.path)):
        if stored is not None and name not in results.out_of_date:
            return stored
    return None


def path_tables(result: PathResult) -> list[Table]:
    """Show the paths that can be driven, joint reversals, and with verification the distances from the path."""
    planned = [path for path in result.paths if not path.refusal]
    tables = []
    if planned:
        tables.append(_plans(planned))
    if any(path.reversals for path in planned):
        tables.append(_reversals(planned))
    if any(_measured(path) for path in planned):
        tables.append(_distances(planned))
    if any(path.driven is not None and path.driven.in_time is not None for path in planned):
        tables.append(_in_time(planned))
    return tables


def path_sentences(result: PathResult) -> list[str]:
    """State refusals, what limits the speed, what the tracker does not see, lags, and notes."""
    lines = []
    for path in result.paths:
        head = f"path {path.name}:"
        if path.refusal:
            lines.append(f"{head} refused: {path.refusal}")
            continue
        if path.slowed:
            lines.append(f"{head} the wanted speed is not kept everywhere: {path.slowed}")
        if path.unseen_mm is not None:
            lines.append(f"{head} the tracker does not see the SMR at {path.unseen_mm:.0f} mm")
        driven = path.driven
        if driven is not None and driven.lag is not None:
            lag = driven.lag
            lines.append(
                f"{head} the joints are {lag.delay_ms:.0f} ms late, {lag.late_mm:.1f} mm at its fastest, which is no"
                f" error of the path; bends are cut by at most {lag.cut_mm:.3f} mm"
            )
        if driven is not None and driven.lost_beams:
            lines.append(
                f"{head} the beam broke {counted(driven.lost_beams, 'time')}: the arm came to rest on its path, the SMR"
                " was found again, and the path was driven again from its beginning"
            )
        if driven is not None and driven.note:
            lines.append(f"{head} {driven.note}")
    rules = dict.fromkeys(RULE_WORDS[path.driven.rule] for path in result.paths if path.driven and path.driven.verdict)
    return [*lines, *rules, *result.notes]


# -- inside -----------------------------------------------------------------------------------------------------------


def _plans(paths: list[PathRecord]) -> Table:
    return table_of(
        "Paths",
        paths,
        ("path", "name"),
        ("arm", "arm"),
        ("length", "length_mm", ".0f", "mm"),
        ("time", "duration_s", ".2f", "s"),
        ("at speed", "at_speed", ".0f", "%"),
        ("tolerance", "tolerance_mm", ".3f", "mm"),
        ("off by the model", "deviation_mm", ".4f", "mm"),
        ("sigma", "uncertainty_mm", ".4f", "mm"),
    )


def _reversals(paths: list[PathRecord]) -> Table:
    return table_of(
        "Joints that turn round",
        [(path.name, one) for path in paths for one in path.reversals],
        ("path", lambda row: row[0]),
        ("joint", lambda row: row[1].joint, "d"),
        ("at", lambda row: row[1].at_mm, ".1f", "mm"),
        ("play crossed", lambda row: row[1].jump_mm, ".3f", "mm"),
        ("within", lambda row: row[1].window_mm, ".1f", "mm"),
    )


def _distances(paths: list[PathRecord]) -> Table:
    columns = (
        Column("path"),
        Column("by"),
        Column("how"),
        number_column("n", "d"),
        number_column("mean", ".3f", "mm"),
        number_column("95 %", ".3f", "mm"),
        number_column("max", ".3f", "mm"),
        number_column("U", ".3f", "mm"),
        Column("met"),
    )
    rows = []
    for path in paths:
        driven = path.driven
        if driven is None:
            continue
        kinds = (
            ("model", "moving", driven.moving),
            ("model", "at rest", driven.at_rest),
            ("nominal", driven.judged, driven.nominal),
        )
        for by, how, errors in kinds:
            if errors is not None:
                decides = by == "model" and how == driven.judged
                expanded, verdict = (driven.expanded_mm, driven.verdict) if decides else (None, "")
                rows.append((path.name, by, how, errors.n, errors.mean, errors.p95, errors.max, expanded, verdict))
    return Table("Distance of measured points from the path", columns, tuple(rows))


def _in_time(paths: list[PathRecord]) -> Table:
    return table_of(
        "In time: delay, which is taken out, and speed",
        [(path.name, path.driven.in_time) for path in paths if path.driven and path.driven.in_time],
        ("path", lambda one: one[0]),
        ("later", lambda one: one[1].delay_ms, ".2f", "ms"),
        ("U", lambda one: one[1].delay_expanded_ms, ".2f", "ms"),
        ("off then, rms", lambda one: one[1].rms_mm, ".3f", "mm"),
        ("largest", lambda one: one[1].largest_mm, ".3f", "mm"),
        ("speed", lambda one: one[1].speed_mm_s, ".2f", "mm/s"),
        ("measured", lambda one: one[1].mean_mm_s, ".2f", "mm/s"),
        ("U of it", lambda one: one[1].expanded_mm_s, ".2f", "mm/s"),
        ("fluctuation", lambda one: one[1].fluctuation_mm_s, ".2f", "mm/s"),
    )


def _measured(path: PathRecord) -> bool:
    driven = path.driven
    return driven is not None and (driven.moving or driven.at_rest or driven.nominal) is not None
