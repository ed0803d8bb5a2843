"""One self-contained HTML page of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path

from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.formats import formats_of
from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.calibrate.view import cooperative_noise_mm, detailed_tables, distance_mm, transform_tables
from cellapp.commands.certificate.judgements import judge_run
from cellapp.commands.collect.view import collection_tables
from cellapp.commands.export.run import lost_by_arm
from cellapp.commands.follow.view import path_sentences, path_tables
from cellapp.commands.locate.view import location_sentences, location_tables
from cellapp.commands.out_of_date import data_mark
from cellapp.commands.report.data import ReportData, read_report_data
from cellapp.commands.report.headlines import (
    headlines,
    missing_results,
    out_of_date_lines,
    unusable_arms,
    verified_headlines,
    warnings,
)
from cellapp.commands.report.judged import judgement_table
from cellapp.commands.report.summary import header_facts, nothing_found, summary
from cellapp.commands.view.acceptance_words import RULE_WORDS
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.uncertainty.conditions import measured_conditions
from cellapp.estimation.uncertainty.records import Judgement
from cellapp.interfaces.page.cell_views import cell_views
from cellapp.interfaces.page.certificate_page import certificate_section
from cellapp.interfaces.page.collection_section import drift_figures
from cellapp.interfaces.page.discovery_section import arm_sections
from cellapp.interfaces.page.page_figures import accuracy_figures, joint_curve_figures, pair_figures, residual_figures
from cellapp.interfaces.page.page_file import write_page_file
from cellapp.interfaces.page.page_parts import PageParts, page_parts
from cellapp.interfaces.page.page_sections import page_sections, section_messages
from cellapp.interfaces.page.page_tables import (
    base_table,
    calibration_facts,
    merged_tables,
    network_tables,
    nominal_and_identified_tables,
    pair_tables,
)
from cellapp.interfaces.page.plotly_script import plotly_base64, plotly_notice
from cellapp.interfaces.page.provenance import provenance_lines
from cellapp.interfaces.page.templates import template

_MOST_EVENTS = 100
"""Newest events of the run's log on the page; the run file has all of them."""


def write_page(run: RunFile) -> Path:
    """Write ``report.html`` into the run's folder and return its path.

    The page needs no other file and no network. The same run gives the same bytes except for the time of writing.

    Raises
    ------
    InputError
        If the run is not calibrated yet, or the page cannot be written.
    """
    return write_page_file(run.folder / REPORT_FILE, page_text(run, datetime.now(UTC)))


def page_text(run: RunFile, written: datetime) -> str:
    """The page as text. Raises ``InputError`` if the run is not calibrated yet."""
    data = read_report_data(run)
    parts = page_parts(run, data)
    judgements = judge_run(data.profile, data.results, measured_conditions(data.readings))
    return template("page.html").render(
        profile=data.profile,
        written=written.isoformat(timespec="seconds"),
        data_mark=data_mark(run),
        certificate=certificate_section(data),
        sections=page_sections(section_messages(data, parts, judgements), data.out_of_date),
        **_first_screen(data, judgements, written.date()),
        **_accuracy(data),
        **_discovery(data),
        **_parts(parts),
        cell=cell_views(data),
        cell_table=base_table(data.model),
        parameter_tables=nominal_and_identified_tables(data.calibrate, data.calibrated),
        merged_tables=merged_tables(data.calibrate),
        formats=tuple(formats_of(ExportFormat)),
        lost=lost_by_arm(run),
        warnings=warnings(data),
        missing=missing_results(data),
        provenance=provenance_lines(data),
        events=data.events[-_MOST_EVENTS:],
        plotly=plotly_base64(),
        plotly_notice=plotly_notice(),
    )


def _first_screen(data: ReportData, judgements: Sequence[Judgement], today: date) -> Mapping[str, object]:
    outdated = out_of_date_lines(data)
    return {
        "header_facts": header_facts(data),
        "alarm_title": "Out of date" if outdated else "Do not use",
        "outdated": bool(outdated),
        "alarms": [*unusable_arms(data), *outdated],
        "next_step": data.next_step,
        "summary": summary(data, judgements, today),
        "nothing_found": nothing_found(data),
        "judgement_table": judgement_table(judgements),
        "decision_rule": RULE_WORDS[data.profile.tolerances.decision],
    }


def _accuracy(data: ReportData) -> Mapping[str, object]:
    calibrate = data.calibrate
    return {
        "headlines": headlines(data),
        "verified_headlines": verified_headlines(data),
        "accuracy": [*accuracy_figures(data), *pair_figures(calibrate)],
        "accuracy_tables": detailed_tables(calibrate),
        "tracker": _tracker_words(calibrate),
        "has_pair": bool(calibrate.pair),
        "vectors": residual_figures(data),
        "fact_table": calibration_facts(calibrate),
        "network_tables": network_tables(calibrate),
        "transform_tables": transform_tables(calibrate),
        "pair_tables": pair_tables(calibrate),
    }


def _discovery(data: ReportData) -> Mapping[str, object]:
    settings = data.profile.discovery
    predicted = {name: arm.prediction for name, arm in data.held_out.items()}
    shown = {name: prediction for name, prediction in predicted.items() if prediction is not None}
    return {
        "discoveries": [] if data.discover is None else arm_sections(data.discover, shown, joint_curve_figures(data)),
        "simulations": settings.null_simulations,
        "false_alarm": settings.false_alarm,
    }


def _parts(parts: PageParts) -> Mapping[str, object]:
    located, paths, state = parts.located, parts.paths, parts.collection
    return {
        "targets": parts.targets,
        "plan": parts.plan,
        "iso9283": parts.iso9283,
        "check": parts.check,
        "station_tables": [] if located is None else location_tables(located),
        "station_sentences": [] if located is None else location_sentences(located),
        "path_tables": [] if paths is None else path_tables(paths),
        "path_sentences": [] if paths is None else path_sentences(paths),
        "collection_tables": [] if state is None else collection_tables(state),
        "drift": drift_figures(state),
    }


def _tracker_words(calibrate: CalibrateResult) -> str:
    """The error that the tracker's stated uncertainty alone would cause, by arm and for the pair."""
    words = [
        f"arm {name}: position {arm.tracker_mm:.4f} mm, distance {distance_mm(arm.tracker_mm, arm.tracker_mm):.4f} mm"
        for name, arm in calibrate.arms.items()
        if arm.tracker_mm
    ]
    cooperative = cooperative_noise_mm(calibrate) if calibrate.pair else None
    if cooperative is not None:
        words.append(f"pair: cooperative {cooperative:.4f} mm")
    return "; ".join(words)
