"""Sections of a report: what each shows of a run, their order, and whether their results still hold."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from cellapp.cell.exports.export_format import ExportFormat
from cellapp.cell.exports.formats import formats_of
from cellapp.cell.profile import profile_to_json
from cellapp.cell.run import RunFile
from cellapp.cell.run.measurement_order import order_sentences
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.commands.calibrate.charts import pair_held_out, pair_stop_chart, stop_error_chart, vector_charts
from cellapp.commands.calibrate.detail_tables import calibration_facts, pair_tables
from cellapp.commands.calibrate.view import detailed_tables, motion_sentences, parameter_tables, transform_tables
from cellapp.commands.check.view import location_view
from cellapp.commands.check.view import view as check_view
from cellapp.commands.collect.charts import residual_drift_chart
from cellapp.commands.collect.state import collection_state
from cellapp.commands.collect.view import collection_section
from cellapp.commands.compensate.view import paths_section, targets_section
from cellapp.commands.discover.view import discovery_section
from cellapp.commands.iso9283.view import iso9283_section
from cellapp.commands.plan.view import plan_section
from cellapp.commands.rehearse.result import kept_log
from cellapp.commands.rehearse.view import log_section
from cellapp.commands.report.data import ReportData, warnings
from cellapp.commands.stages import CALIBRATION_FILE, readings_digest, sha256_of
from cellapp.commands.stored_model import values_in_force
from cellapp.commands.trials.detectability import detectability_parts, stored_detectability
from cellapp.commands.view.charts import Chart, enumerated
from cellapp.commands.view.parts import Facts, Section, section_of
from cellapp.commands.view.table import Cell, table_of_cells
from cellapp.commands.view.words import RULE_WORDS, judged_sentence, judgement_table
from cellapp.estimation.calibration.identification import start_from_nominal
from cellapp.estimation.calibration.quantities import measured_minus_computed, position_errors
from cellapp.ground.counting import counted, mm
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.results import CALIBRATE, CHECK, COMPENSATE, ISO9283, Provenance, StageName, best_method, day_of
from cellapp.ground.version import __version__
from cellapp.robot.kinematics.chain import hayati_rows, nominal_geometry, smr_positions
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.nominal import controller_rows, published_rows

_HASH = "SHA-256"


def provenance_facts(data: ReportData) -> Facts:
    """Show programs, seeds, settings, counts of readings, hashes."""
    origin = data.calibrate.provenance
    plant = data.profile.plant
    lines = [
        ("Profile", data.profile.name),
        (f"{_HASH} of the profile", sha256_of(profile_to_json(data.profile))),
        ("Seed of splits and draws", str(origin.seed)),
        *([] if plant is None else [("Seed of the simulated cell", str(plant.seed))]),
        ("Calibrated by", _programs(origin)),
        ("Calibrated at", origin.written),
        ("Page made by", f"cellapp {__version__}, Python {platform.python_version()}, numpy {np.__version__}"),
        *_reading_lines(data),
        ("Settings", _settings(data.profile)),
        *((f"{_HASH} of the readings of arm {name}", readings_digest(arm)) for name, arm in data.readings.items()),
        (f"{_HASH} of {CALIBRATION_FILE}", sha256_of(data.model_in_force + "\n")),
    ]
    return Facts(tuple(lines))


def _reading_lines(data: ReportData) -> list[tuple[str, str]]:
    lines = []
    for name, readings in data.readings.items():
        splits = data.calibrate.arms[name].splits
        used = ", ".join(f"{count} {word}" for word, count in splits.items())
        unused = len(readings) - sum(splits.values())
        arm = data.profile.arms[name]
        title = f"Readings of arm {name} ({arm.type.model})"
        lines.append((title, f"{len(readings)}: {used}, {unused} unused; driver: {arm.driver.kind}"))
    lines += [("Order of measurement", sentence) for sentence in order_sentences(data.in_order)]
    pair = data.calibrate.pair.get("method_1")
    if pair is not None and pair.splits:
        lines.append(("Common stops of the pair", ", ".join(f"{count} {word}" for word, count in pair.splits.items())))
    return lines


def _settings(profile: Profile) -> str:
    settings = profile.calibration
    stated = (("length", settings.priors.length, "m"), ("angle", settings.priors.angle, "rad"))
    priors = [f"{kind} {value:g} {unit}" for kind, value, unit in stated if value is not None]
    none = "from the arm's own spread" if settings.parameter_set == "auto" else "none"
    return f"parameter set {settings.parameter_set}, priors {', '.join(priors) or none}, robust {settings.robust}"


def _programs(origin: Provenance) -> str:
    words = [origin.program]
    for title, version in (("Python", origin.python), ("numpy", origin.numpy), ("torch", origin.torch)):
        if version is not None:
            words.append(f"{title} {version}")
    return ", ".join(words)


_ABOUT = (
    "Rows alone, at configurations that the calibration did not use: base and SMR are registered to the other readings;"
    " no network, no effects."
)


def controllers_section(run: RunFile, data: ReportData) -> Section | None:
    """Show errors at the SMR by published, factory and identified rows; None if no controller has its own."""
    recorded, rows = recorded_controllers(run), list[tuple[Cell, ...]]()
    said = []
    for name, held_out in data.held_out.items():
        arm, controller = run.profile.arms[name], recorded.get(name)
        own = None if controller is None else controller.dh_rows
        factory = np.array(own) if own is not None else None if arm.factory is None else controller_rows(arm)
        if factory is None:
            continue
        learn = data.readings[name].take(data.readings[name].in_split("identify"))
        errors: dict[str, Array] = {}
        for whose, table in (("published", published_rows(arm)), ("factory", factory)):
            computed = _computed(arm, table, learn.q, learn.p_M, held_out.readings.q)
            errors[whose] = position_errors(held_out.readings.p_M, computed) * 1e3
        if "geometry" in held_out.errors_mm:
            errors["cellapp"] = held_out.errors_mm["geometry"]
        for whose, off in errors.items():
            rows.append((name, whose, float(off.mean()), float(np.sqrt(np.mean(off**2))), float(off.max())))
        said.append(f"arm {name}: " + ", ".join(f"{whose} {off.mean():.3f} mm" for whose, off in errors.items()))
    if not rows:
        return None
    errors_mm = ((f"{what} [mm]", ".4f") for what in ("mean", "rms", "max"))
    return Section(
        [table_of_cells("Errors at the SMR by whose rows", rows, "arm", "rows", *errors_mm)],
        message=f"Mean error of the SMR by whose D-H rows: {'; '.join(said)}.",
        about=_ABOUT,
    )


def _computed(arm: Arm, rows: Array, q: Array, p_M: Array, at: Array) -> Array:
    """Compute SMR positions (m, 3) [m] at ``at`` (m, N) by plain rows (N, 4); base and SMR are registered to the
    readings ``q`` and ``p_M`` (n, 3)."""
    published = published_rows(arm)
    chain = replace(nominal_geometry(published, np.zeros(3)), rows=hayati_rows(rows, published))
    return smr_positions(start_from_nominal(chain, q, p_M, tool_unknown=True), at)


_ABOUT_ACCURACY = (
    "Nominal is the geometry of the manufacturer, geometry has the identified lengths and angles, network adds a"
    ' residual network, effects adds the physical effects that discovery accepted instead. "95 %" is a percentile,'
    ' "95 % of mean" the bootstrap interval of the mean. The noise floor is the error that the stated uncertainty of'
    " the tracker alone would cause; without one there is none. 'cellapp docs glossary' explains the errors."
)
_MOST_EVENTS = 100
"""Newest events of the run's log that the report shows; the run file has all of them."""
_OPEN = frozenset({"accuracy", "targets", "iso9283", "check", "discovery"})
"""Sections open at first: what was reached and found. The others say how, and on what basis."""
_ON_RECORD = frozenset({"parameters", "controllers", "notes", "provenance"})
"""Sections that paper shows, too."""


def report_sections(run: RunFile, data: ReportData) -> list[Section]:
    """Build the sections that have contents, in their order."""
    return placed({key: make(run, data) for key, (_, _, make) in SECTIONS.items()}, data.results.out_of_date)


def placed(made: Mapping[str, Section | None], out_of_date: Mapping[StageName, str]) -> list[Section]:
    """Put sections in the order of the report, with their titles and why they no longer hold."""
    found = []
    for key, (title, stages, _) in SECTIONS.items():
        section = made.get(key)
        if section is not None:
            reasons = "; ".join(dict.fromkeys(out_of_date[stage] for stage in stages if stage in out_of_date))
            folded = key not in _OPEN and not reasons
            kept = key in _ON_RECORD
            found.append(replace(section, title=title, key=key, outdated=reasons, folded=folded, on_record=kept))
    return found


def detectability_section(run: RunFile) -> Section | None:
    """Show from which size on the plan would find effects; None if that was not tried."""
    result = stored_detectability(run)
    if result is None:
        return None
    about = (
        "Effects were hidden in simulated arms of this cell at the planned stops, at sizes that the trials before"
        " suggested, and searched as 'discover' does. Their laws are not those of the library."
    )
    return section_of(detectability_parts(result), about=about)


# -- accuracy ---------------------------------------------------------------------------------------------------------


def _judgements(data: ReportData) -> Section | None:
    if not data.judgements:
        return None
    return Section(
        [judgement_table(data.judgements)],
        message=judged_sentence(data.judgements),
        about=f"{RULE_WORDS[data.profile.tolerances.decision]} U is the expanded uncertainty with coverage factor 2;"
        " tolerances are those of the profile.",
    )


def _accuracy(data: ReportData) -> Section:
    calibrate = data.calibrate
    return Section(
        [*accuracy_charts(data), *detailed_tables(calibrate), *motion_sentences(calibrate)],
        message=_accuracy_message(data),
        about=_ABOUT_ACCURACY,
    )


def accuracy_charts(data: ReportData) -> Iterator[Chart]:
    """Yield the errors by configuration of each arm, and of the pair if stored by stop."""
    for name, held_out in data.held_out.items():
        yield stop_error_chart(name, held_out, data.calibrate.arms[name].tracker_mm)
    if pair_held_out(data.calibrate):
        yield pair_stop_chart(data.calibrate)


def _accuracy_message(data: ReportData) -> str:
    """State the mean held-out errors of each arm and of the pair, with the nominal and the best model."""
    parts = []
    for name, arm in data.calibrate.arms.items():
        best = arm.validate_[arm.best_stage].position_mm.mean
        nominal = f" (nominal {mm(arm.validate_['nominal'].position_mm.mean)})" if "nominal" in arm.validate_ else ""
        parts.append(f"arm {name} {mm(best)}{nominal}")
    method = best_method(data.calibrate.pair)
    if method is not None:
        pair = data.calibrate.pair
        nominal = f" (nominal cell {mm(pair['nominal'].cooperative_mm.mean)})" if "nominal" in pair else ""
        parts.append(f"cooperative {mm(pair[method].cooperative_mm.mean)}{nominal}")
        rotated = pair[method].cooperative_mrad
        parts += [] if rotated is None else [f"rotation of one flange in the other's frame {rotated.mean:.3f} mrad"]
    return f"Mean error at configurations that the calibration did not use: {'; '.join(parts)}."


# -- results of other verbs -------------------------------------------------------------------------------------------


def _targets(data: ReportData) -> Section | None:
    """Show targets that were compensated or measured, if that holds."""
    compensate = data.results.held.compensate
    verify = data.results.verified if data.results.verified.arms else None
    if compensate is None and verify is None:
        return None
    floors_mm = {name: arm.tracker_mm for name, arm in data.calibrate.arms.items()}
    return targets_section(compensate, verify, floors_mm)


def _iso9283(data: ReportData) -> Section | None:
    """Show the tests by ISO 9283; the section says if they no longer hold."""
    result = data.results.iso9283
    about = (
        "Each arm was driven through the cube, the poses and the cycles of ISO 9283:1998; 'cellapp docs iso9283' has"
        " the formulas and says what one SMR cannot show."
    )
    return None if result is None else iso9283_section(result, about)


def _check(data: ReportData) -> Section | None:
    """Show a check if it holds: a check of another model says nothing."""
    result = data.results.held.check
    about = (
        "A few stops were measured again and compared with what the stored model expects there; 'cellapp docs check'"
        " explains how that is judged."
    )
    return None if result is None else section_of(check_view(result).parts, about=about)


def _discovery(data: ReportData) -> Section | None:
    return None if data.discover is None else discovery_section(data.discover, data.profile.discovery)


def _paths(data: ReportData) -> Section | None:
    result = data.results.held.path
    return None if result is None else paths_section(result)


def _station(data: ReportData) -> Section | None:
    located = data.results.held.locate
    if located is None or not located.moved:
        return None
    about = "The tracker was moved after the readings were taken; what follows was measured from where it stands now."
    return section_of(location_view(located).parts, about=about)


# -- geometry ---------------------------------------------------------------------------------------------------------


def _residuals(data: ReportData) -> Section:
    """Show residuals of the newest model over the run, those of the identified geometry as vectors, and the drift."""
    residuals_M = measured_minus_computed(data.model, data.readings)
    runs = (residual_drift_chart(name, data.readings[name].time_s, off) for name, off in residuals_M.items())
    vectors = (
        chart
        for name, held_out in data.held_out.items()
        if "geometry" in held_out.errors_mm
        for chart in vector_charts(name, held_out)
    )
    return Section(
        [*runs, *vectors, calibration_facts(data.calibrate)],
        message="What the model leaves, and how the identification went; a pattern in the arrows is an effect.",
        about="Residuals of the held-out configurations as arrows, enlarged; the black arrow gives the scale. Residuals"
        " in the tracker frame are specific to one tracker station; residuals in the base frame move with the arm.",
    )


def _pair(data: ReportData) -> Section | None:
    pair = data.calibrate.pair
    if (method := best_method(pair)) is None:
        return None
    known = [one.value for axis in "xyz" if (one := pair[method].identified.get(axis)) is not None]
    message = "Base of the second arm in the base of the first one."
    if len(known) == len("xyz"):
        message = f"The bases of both arms are {math.hypot(*known):.4f} m apart."
    return Section(
        [*transform_tables(data.calibrate), *pair_tables(data.calibrate)],
        message=message,
        about="The transform between the two bases, identified from the distances between the two SMRs, where both"
        " flanges have a probe together with relative rotations, and for comparison from both bases in the common"
        " tracker frame, on the same stops.",
    )


def _parameters(data: ReportData) -> Section:
    in_force = values_in_force(data.calibrate, data.model)
    counts = (f"{len(arm.identified)} parameters of arm {name}" for name, arm in in_force.arms.items())
    others = (
        "Other programs read the geometry of the model in force: 'cellapp export DIR --as FORMAT --out FILE', with"
        f" {', '.join(formats_of(ExportFormat))}. No file of a rigid chain holds the rest of the model: each"
        " says by how much the SMR is off without it."
    )
    return Section(
        [others, *parameter_tables(in_force)],
        message=f"Identified: {enumerated(counts)}.",
        about="Lengths and angles of the chain from tracker to SMR (D-H, with a Hayati angle beta where axes are"
        " parallel), with one standard error, in the model in force. A parameter that these data cannot"
        " separate from others keeps its nominal value and is merged into the others.",
    )


def _collection(run: RunFile, data: ReportData) -> Section | None:
    state = collection_state(run, data.results)
    return None if state is None else collection_section(state)


# -- the run ----------------------------------------------------------------------------------------------------------


def _notes(data: ReportData) -> Section | None:
    notes = warnings(data)
    return Section(notes, message=f"{counted(len(notes), 'warning or note', 'warnings or notes')}.") if notes else None


def _provenance(data: ReportData) -> Section:
    origin = data.calibrate.provenance
    count = sum(len(readings) for readings in data.readings.values())
    log = Facts(tuple((event.written, f"{event.level}: {event.text}") for event in data.events[-_MOST_EVENTS:]))
    return Section(
        [provenance_facts(data), *([Section([log], title="Log of the run")] if log.rows else [])],
        message=f"Calibrated by {origin.program} on {day_of(origin.written)} from {counted(count, 'reading')}; hashes"
        " identify the data.",
    )


Maker = Callable[[RunFile, ReportData], Section | None]
"""Builds a section; None if the run has nothing to show there."""


def _of(made: Callable[[ReportData], Section | None]) -> Maker:
    return lambda run, data: made(data)


SECTIONS: Mapping[str, tuple[str, tuple[StageName, ...], Maker]] = {
    "judgements": ("Errors against their tolerances", (CALIBRATE,), _of(_judgements)),
    "accuracy": ("Accuracy at configurations that were not used", (CALIBRATE,), _of(_accuracy)),
    "targets": ("Accuracy at targets", (COMPENSATE,), _of(_targets)),
    "iso9283": ("Tests by ISO 9283", (ISO9283,), _of(_iso9283)),
    "check": ("Check of the calibration", (CHECK,), _of(_check)),
    "discovery": ("Missing effects", (), _of(_discovery)),
    "residuals": ("Residuals of the geometry", (CALIBRATE,), _of(_residuals)),
    "pair": ("Inter-base transform", (CALIBRATE,), _of(_pair)),
    "paths": ("Paths", (), _of(_paths)),
    "station": ("Station of the tracker", (), _of(_station)),
    "plan": ("Plan", (), lambda run, _: plan_section(run)),
    "power": ("What the plan can name", (), lambda run, _: detectability_section(run)),
    "rehearsal": ("Rehearsal", (), lambda run, _: None if (log := kept_log(run)) is None else log_section(log)),
    "collection": ("Collecting", (), _collection),
    "parameters": ("Identified parameters", (CALIBRATE,), _of(_parameters)),
    "controllers": ("The controllers' own calibration", (CALIBRATE,), controllers_section),
    "notes": ("Warnings and notes", (), _of(_notes)),
    "provenance": ("Provenance", (), _of(_provenance)),
}
"""Sections in the order of the report: anchor, title, the stages whose results they show even if out of date, maker."""
