"""One self-contained HTML page of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.errors import InputError
from cellapp.exports.formats import FORMATS
from cellapp.exports.run_export import lost_by_arm
from cellapp.reporting.cell_views import cell_views
from cellapp.reporting.collection_section import collection_state, drift_figures
from cellapp.reporting.collection_text import collection_tables
from cellapp.reporting.discovery_section import arm_sections
from cellapp.reporting.headlines import headlines, missing_results, out_of_date_lines, warnings
from cellapp.reporting.location_text import location_sentences, location_tables
from cellapp.reporting.page_figures import accuracy_figures, pair_figures, residual_vector_figures
from cellapp.reporting.page_tables import (
    base_table,
    calibration_facts,
    merged_tables,
    network_tables,
    nominal_and_identified_tables,
    pair_tables,
)
from cellapp.reporting.path_table import path_sentences, path_tables, stored_paths
from cellapp.reporting.plan_section import plan_section
from cellapp.reporting.provenance import provenance_lines
from cellapp.reporting.report_data import ReportData, read_report_data
from cellapp.reporting.tables import (
    cooperative_noise_mm,
    detailed_tables,
    distance_mm,
    transform_tables,
)
from cellapp.reporting.targets_section import targets_section
from cellapp.reporting.words import METHOD_WORDS
from cellapp.results import LOCATE, CalibrateResult
from cellapp.run import RunFile
from cellapp.run.sqlite_file import REPORT_FILE

if TYPE_CHECKING:
    from jinja2 import Template

PAGE_FILE = REPORT_FILE
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
    text = page_text(run, datetime.now(UTC))
    path = run.folder / PAGE_FILE
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror}); check disk and folder rights") from None
    return path


def page_text(run: RunFile, written: datetime) -> str:
    """The page as text. Raises ``InputError`` if the run is not calibrated yet."""
    data = read_report_data(run)
    return _template().render(
        profile=data.profile,
        written=written.isoformat(timespec="seconds"),
        **_first_words(data),
        **_accuracy(data),
        **_discovery(data),
        **_station(data),
        targets=targets_section(data),
        **_paths(data),
        **_collection(run),
        plan=plan_section(run),
        cell=cell_views(data.model, data.readings),
        cell_table=base_table(data.model),
        parameter_tables=nominal_and_identified_tables(data.calibrate, data.calibrated),
        merged_tables=merged_tables(data.calibrate),
        formats=tuple(FORMATS),
        lost=lost_by_arm(run),
        provenance=provenance_lines(data),
        events=data.events[-_MOST_EVENTS:],
    )


def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=PackageLoader("cellapp", "reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup  # made by cellapp, without any text that a user wrote
    return environment.get_template("page.html")


def _first_words(data: ReportData) -> Mapping[str, object]:
    return {
        "headlines": headlines(data),
        "out_of_date": out_of_date_lines(data),
        "next_step": data.next_step,
        "warnings": warnings(data),
        "missing": missing_results(data),
    }


def _accuracy(data: ReportData) -> Mapping[str, object]:
    calibrate = data.calibrate
    return {
        "accuracy": [*accuracy_figures(data), *pair_figures(calibrate)],
        "accuracy_tables": detailed_tables(calibrate),
        "tracker": _tracker_words(calibrate),
        "methods": [(method, words) for method, words in METHOD_WORDS.items() if method in calibrate.pair],
        "vectors": residual_vector_figures(data),
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
        "discoveries": [] if data.discover is None else arm_sections(data.discover, shown),
        "simulations": settings.null_simulations,
        "false_alarm": settings.false_alarm,
    }


def _station(data: ReportData) -> Mapping[str, object]:
    located = data.results.locate
    shown = located is not None and located.moved and LOCATE not in data.out_of_date
    return {
        "station_tables": location_tables(located) if located is not None and shown else [],
        "station_sentences": location_sentences(located) if located is not None and shown else [],
    }


def _paths(data: ReportData) -> Mapping[str, object]:
    stored = stored_paths(data.results)
    return {
        "path_tables": [] if stored is None else path_tables(stored),
        "path_sentences": [] if stored is None else path_sentences(stored),
    }


def _collection(run: RunFile) -> Mapping[str, object]:
    state = collection_state(run)
    return {
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
