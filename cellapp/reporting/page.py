"""One self-contained HTML page of a run."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cellapp
from cellapp.calibration.calibrate import CALIBRATION_FILE, RESULT
from cellapp.calibration.circumstances import circumstances_of_arms
from cellapp.calibration.evaluation import position_errors
from cellapp.discovery.discover import DISCOVER_RESULT
from cellapp.effects import Circumstances
from cellapp.errors import InputError
from cellapp.kinematics.chain import Geometry, frame_poses, parameter_names, smr_positions
from cellapp.kinematics.transforms import Array, apply, invert
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile, profile_to_json
from cellapp.reporting.discovery import arm_sections
from cellapp.reporting.drawing import Drawing
from cellapp.reporting.findings import is_current, own_sentence
from cellapp.reporting.table import Table
from cellapp.reporting.tables import (
    METHODS,
    detailed_tables,
    distance_mm,
    parameter_tables,
    transform_tables,
    verification_tables,
)
from cellapp.run import Readings, RunFile, stated_uncertainty

PAGE_FILE = "report.html"

_VERIFY_RESULT = "verify"  # as in cellapp.pipeline, which imports this module
_NO_PAIR = "pair: skipped"
_MOST_EVENTS = 100
_STAGE_WORDS = {
    "nominal": "nominal",
    "geometry": "identified geometry",
    "network": "geometry and network",
    "effects": "geometry and effects",
}
_METHOD_COLOURS = {
    "method_1": "geometry",
    "method_2": "tracker-network",
    "proposed": "network",
    "effects": "effects",
}
_MOST_POINTS = 400
_MOST_ARROWS = 150
_METHOD_WORDS = {
    "nominal": "the nominal cell",
    "method_1": "geometry alone",
    "method_2": "geometry and a network in the tracker frame",
    "proposed": "geometry and a network in the base frame",
    "effects": "geometry and effects",
}


@dataclass(frozen=True)
class _Drawings:
    """The figures by section of the page."""

    accuracy: list[Drawing]
    pair: list[Drawing]
    vectors: list[Drawing]
    targets: list[Drawing]
    cell: list[Drawing]


@dataclass(frozen=True)
class _Results:
    """What a run holds: the three results, those of later steps None where there are none that still hold."""

    calibrate: Mapping[str, Any]
    discover: Mapping[str, Any] | None
    verify: Mapping[str, Any] | None
    missing: tuple[tuple[str, str], ...]


def write_page(run: RunFile) -> Path:
    """Write ``report.html`` into the run's folder and return its path.

    The page needs no other file and no network. The same run gives the same bytes but for the time of writing.

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
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    results = _read(run)
    model = CellModel.load(run.folder / CALIBRATION_FILE)
    readings = {name: run.readings(name) for name in model.arms}
    known = circumstances_of_arms(model.arms, readings)
    drawn = _draw(results, model, readings, known)
    environment = Environment(
        loader=PackageLoader("cellapp", "reporting"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup  # our own drawings, which hold nothing that a user wrote
    environment.filters["right"] = _right_aligned
    discover, verify = results.discover, results.verify
    return environment.get_template("page.html").render(
        profile=run.profile,
        written=written.isoformat(timespec="seconds"),
        headlines=_headlines(results),
        warnings=_warnings(results),
        missing=results.missing,
        accuracy=drawn.accuracy,
        accuracy_tables=detailed_tables(results.calibrate),
        tracker=_tracker_words(results.calibrate),
        cooperative=drawn.pair,
        transform_tables=transform_tables(results.calibrate),
        pair_tables=_pair_tables(results.calibrate),
        vectors=drawn.vectors,
        fact_table=_fact_table(results.calibrate),
        network_tables=_network_tables(results.calibrate),
        methods=[(method, words) for method, words in _METHOD_WORDS.items() if method in results.calibrate["pair"]],
        discoveries=[] if discover is None else arm_sections(discover, _certainties(model, readings, known)),
        simulations=run.profile.discovery.null_simulations,
        false_alarm=run.profile.discovery.false_alarm,
        targets=drawn.targets,
        verification_tables=[] if verify is None else verification_tables(verify),
        target_tables=[] if verify is None else _target_tables(verify),
        cell=drawn.cell,
        cell_table=_base_table(model),
        parameter_tables=_parameter_tables(results.calibrate, model),
        merged_tables=_merged_tables(results.calibrate),
        provenance=[*_provenance(run.profile, results, readings), *_hashes(run, readings)],
        events=run.events()[-_MOST_EVENTS:],
    )


# -- what there is and what there is not ------------------------------------------------------------------------------


def _read(run: RunFile) -> _Results:
    texts = {step: run.read_result(step) for step in (RESULT, DISCOVER_RESULT, _VERIFY_RESULT)}
    calibrated = texts[RESULT]
    if calibrated is None:
        raise InputError(f"{run.path}: not calibrated yet, nothing to report; run 'cellapp calibrate' first")
    calibrate = json.loads(calibrated)
    discover, verify = (None if text is None else json.loads(text) for text in list(texts.values())[1:])
    missing = []
    if not calibrate["pair"]:
        missing.append(("Pair (inter-base transform and cooperative errors)", _why_no_pair(run.profile, calibrate)))
    if discover is None:
        missing.append(("Missing effects", "make them with: cellapp discover DIR"))
    elif not is_current(discover):
        discover = None
        missing.append(("Missing effects", "an older version looked for them; run anew: cellapp discover DIR"))
    elif any(
        arm["accepted"] and "effects" not in calibrate["arms"][name]["validate"]
        for name, arm in discover["arms"].items()
    ):
        discover = None
        missing.append(
            ("Missing effects", "the run was calibrated again since they were found; run anew: cellapp discover DIR")
        )
    if verify is None or not verify["arms"]:
        why = "measure targets with: cellapp push DIR TARGETS --verify"
        if verify is not None:
            why = "targets were pushed, but none was measured with both commands; " + why
        elif all(not arm.driver.has_device for arm in run.profile.arms.values()):
            why = "the profile names no devices; with a profile that does, " + why
        missing.append(("Verification at new targets", why))
        verify = None
    return _Results(calibrate, discover, verify, tuple(missing))


def _why_no_pair(profile: Profile, calibrate: Mapping[str, Any]) -> str:
    said = [note for note in calibrate["notes"] if note.startswith(_NO_PAIR)]
    reason = said[0].removeprefix("pair: ") if said else "not made"
    two = len(profile.arms) == 2
    more = "measure more stops with both arms" if two else "measure two arms at the same stops in a new run"
    return f"{reason}; {more}, then: cellapp calibrate DIR"


# -- words ------------------------------------------------------------------------------------------------------------


def _headlines(results: _Results) -> list[tuple[str, str]]:
    """Pairs of what is spoken of and a sentence about it."""
    lines = []
    for name, arm in results.calibrate["arms"].items():
        errors = {stage: summary["position_mm"]["mean"] for stage, summary in arm["validate"].items()}
        found = {} if results.discover is None else results.discover["arms"].get(name, {})
        last = "effects" if found.get("accepted") else "geometry"
        sentence = (
            f"Where the arm goes is now known to {errors[last]:.3f} mm (mean over"
            f" {arm['validate'][last]['position_mm']['n']} configurations that the calibration did not see);"
            f" with the maker's nominal figures it is {errors['nominal']:.3f} mm"
        )
        sentence += f", with the geometry alone {errors['geometry']:.3f} mm." if last == "effects" else "."
        if not arm["converged"]:
            sentence = f"The calibration did not converge ({arm['message']}): do not use it."
        lines.append((f"Arm {name}", sentence))
        if found:
            reason = own_sentence(name, found)
            lines.append((f"Arm {name}, what was missing", f"{found['verdict'].capitalize()}: {reason}."))
    pair = results.calibrate["pair"]
    if pair:
        means = {method: pair[method]["cooperative_mm"]["mean"] for method in METHODS if method in pair}
        method = next(method for method in ("effects", "proposed", "method_1", "nominal") if method in means)
        sentence = (
            f"The distance between the two arms' SMRs is known to {means[method]:.3f} mm with {_METHOD_WORDS[method]}"
        )
        if method != "nominal" and "nominal" in means:
            sentence += f"; with the nominal figures it is {means['nominal']:.3f} mm"
        lines.append(("Pair", sentence + " (means over held-out stops)."))
    for name, ways in ({} if results.verify is None else results.verify["arms"]).items():
        before, after = ways["nominal_mm"]["mean"], ways["compensated_mm"]["mean"]
        word = "fell" if after < before else "did not fall: it went"
        lines.append(
            (
                f"Arm {name}, verified",
                f"At {ways['compensated_mm']['n']} new targets the measured mean error {word} from {before:.3f} mm to"
                f" {after:.3f} mm with compensation.",
            )
        )
    return lines


def _warnings(results: _Results) -> list[str]:
    notes = [note for note in results.calibrate["notes"] if not note.startswith(_NO_PAIR)]
    targets = [] if results.verify is None else results.verify["targets"]
    return notes + [f"target {target['name']}: {target['note']}" for target in targets if target["note"]]


# -- tables that only the page has ------------------------------------------------------------------------------------


def _right_aligned(table: Table) -> list[bool]:
    """For each column whether it holds numbers: they are read by their last digits."""
    return [
        place > 0
        and any(row[place] for row in table.rows)
        and all(_is_number(row[place]) for row in table.rows if row[place])
        for place in range(len(table.columns))
    ]


def _is_number(text: str) -> bool:
    """Of a number or of an interval."""
    try:
        for part in text.split(" to "):
            float(part)
    except ValueError:
        return False
    return True


def _target_tables(verify: Mapping[str, Any]) -> list[Table]:
    tables = []
    for name in verify["arms"]:
        rows = [
            (str(number), target["name"], _mm(target["nominal_mm"]), _mm(target["compensated_mm"]))
            for number, target in enumerate(_targets_of(verify, name), start=1)
        ]
        columns = ("number", "target", "uncompensated", "compensated")
        tables.append(Table(f"Arm {name}: each target [mm]", columns, tuple(rows)))
    return tables


def _targets_of(verify: Mapping[str, Any], arm: str) -> list[Mapping[str, Any]]:
    """The targets of one arm that were measured with both commands."""
    both = ("nominal_mm", "compensated_mm")
    return [t for t in verify["targets"] if t["arm"] == arm and all(t[way] is not None for way in both)]


def _mm(value: float) -> str:
    return f"{value:.4f}"


def _pair_tables(calibrate: Mapping[str, Any]) -> list[Table]:
    tables = []
    for method in METHODS:
        identified = calibrate["pair"].get(method, {}).get("identified", {})
        rows = []
        for name, entry in identified.items():
            factor, unit = (1e3, "mm") if entry["unit"] == "m" else (math.degrees(1.0), "deg")
            other = entry.get("by_tracker")
            beside = "" if other is None else f"{other * factor:.5f}"
            rows.append(
                (name, f"{entry['value'] * factor:.5f}", f"{entry['standard_error'] * factor:.5f}", beside, unit)
            )
        if rows:
            first, second = calibrate["arms"]
            title = f"Pair: base of {first} in the base of {second}, with {_METHOD_WORDS[method]}"
            columns = ("parameter", "by distances", "standard error", "by the tracker frame", "unit")
            tables.append(Table(title, columns, tuple(rows)))
    return tables


def _parameter_tables(calibrate: Mapping[str, Any], model: CellModel) -> list[Table]:
    """Those of ``calibrate --parameters`` with the nominal value of each parameter and how far it is from it."""
    tables = []
    for table, (name, arm) in zip(parameter_tables(calibrate), calibrate["arms"].items(), strict=True):
        nominal = model.arms[name].nominal
        published = dict(zip(parameter_names(nominal.joints), nominal.vector().tolist(), strict=True))
        rows = []
        for row, (parameter, entry) in zip(table.rows, arm["identified"].items(), strict=True):
            factor = 1e3 if entry["unit"] == "m" else math.degrees(1.0)
            delta = entry["value"] - published[parameter]
            if entry["unit"] == "rad":
                delta = math.remainder(delta, 2.0 * math.pi)
            rows.append((parameter, f"{published[parameter] * factor:.5f}", row[1], f"{delta * factor:+.5f}", *row[2:]))
        columns = ("parameter", "nominal", "value", "delta", "standard error", "unit")
        tables.append(Table(table.title, columns, tuple(rows)))
    return tables


def _tracker_words(calibrate: Mapping[str, Any]) -> str:
    """What the tracker's stated uncertainty alone would leave of each error."""
    known = {name: arm.get("tracker_mm") for name, arm in calibrate["arms"].items()}
    words = [
        f"arm {name}: position {stated:.4f} mm, distance {distance_mm(stated, stated):.4f} mm"
        for name, stated in known.items()
        if stated
    ]
    together = distance_mm(*known.values()) if calibrate["pair"] else None
    if together is not None:
        words.append(f"pair: cooperative {together:.4f} mm")
    return "; ".join(words)


def _fact_table(calibrate: Mapping[str, Any]) -> Table:
    """How the calibration went, an arm a column."""
    columns = [_training_facts(arm) for arm in calibrate["arms"].values()]
    rows = tuple((what, *(facts[what] for facts in columns)) for what in columns[0])
    return Table("How the arms were calibrated", ("", *(f"arm {name}" for name in calibrate["arms"])), rows)


def _network_tables(calibrate: Mapping[str, Any]) -> list[Table]:
    """The networks that were compared before one was trained to the end."""
    tables = []
    for name, arm in calibrate["arms"].items():
        tried = (arm.get("network") or {}).get("tried", [])
        if tried:
            shapes = tuple(
                (str(place), _shape(entry), f"{entry['left_out_rms_mm']:.4f}")
                for place, entry in enumerate(tried, start=1)
            )
            title = f"Arm {name}: networks tried inside the training split"
            tables.append(Table(title, ("number", "inputs, hidden layers", "left-out rms [mm]"), shapes))
    return tables


def _shape(network: Mapping[str, Any]) -> str:
    words = {"sincos": "sines and cosines", "angles": "scaled angles"}
    turning = ", turning with joint 1" if network.get("turning") else ""
    return f"{words[network['inputs']]}, {' + '.join(str(width) for width in network['hidden'])}{turning}"


def _training_facts(arm: Mapping[str, Any]) -> dict[str, str]:
    network, repeats = arm.get("network"), arm.get("repeatability_mm")
    stated, excess = arm.get("tracker_mm"), arm.get("excess_mm")
    if network is None:
        about = left_out = "none trained"
    else:
        about = f"{_shape(network)}; {'used' if network['used'] else 'not used, as it did not help on left-out folds'}"
        left_out = f"{network['left_out_rms_mm']:.4f}, without {network['without_rms_mm']:.4f}"
    return {
        "parameters identified": str(arm["rank"]),
        "iterations": str(arm["iterations"]),
        "condition of the scaled Jacobian": "" if arm["condition"] is None else f"{arm['condition']:.1f}",
        "tracker's stated uncertainty, rms length [mm]": "not stated" if not stated else f"{stated:.4f}",
        "scatter of a coordinate beyond it [mm]": "" if excess is None else f"{excess:.4f}",
        "position repeatability, mean and RP [mm]": (
            "no stop was repeated" if repeats is None else f"{repeats['mean']:.4f}, {repeats['rp']:.4f}"
        ),
        "network": about,
        "network, rms on left-out folds [mm]": left_out,
    }


def _merged_tables(calibrate: Mapping[str, Any]) -> list[Table]:
    tables = []
    for name, arm in calibrate["arms"].items():
        rows = [
            (parameter, ", ".join(f"{share:+.4g} {kept}" for kept, share in shares.items()) or "nothing (no effect)")
            for parameter, shares in arm["merged"].items()
        ]
        if rows:
            columns = ("parameter", "merged into")
            tables.append(Table(f"Arm {name}: parameters that act like others", columns, tuple(rows)))
    return tables


def _base_table(model: CellModel) -> Table:
    rows = []
    for name, arm in model.arms.items():
        x, y, z = arm.geometry.T_M_B()[:3, 3]
        rows.append((name, f"{x:.5f}", f"{y:.5f}", f"{z:.5f}", f"{math.hypot(x, y, z):.3f}"))
    columns = ("arm", "x", "y", "z", "distance from the tracker")
    return Table("Bases in the tracker frame [m]", columns, tuple(rows))


def _provenance(profile: Profile, results: _Results, readings: Mapping[str, Readings]) -> list[tuple[str, str]]:
    origin, arms = results.calibrate["provenance"], results.calibrate["arms"].values()
    settings = profile.calibration
    lines = [
        ("Profile", profile.name),
        ("SHA-256 of the profile", hashlib.sha256(profile_to_json(profile).encode("utf-8")).hexdigest()),
        ("Seed of splits and draws", str(origin["seed"])),
        *([] if profile.plant is None else [("Seed of the simulated cell", str(profile.plant.seed))]),
        ("Calibrated by", _programs(origin, torch_used=any(arm.get("network") for arm in arms))),
        ("Calibrated at", origin["written"]),
        ("Page made by", f"cellapp {cellapp.__version__}, Python {platform.python_version()}, numpy {np.__version__}"),
    ]
    for name, arm in readings.items():
        splits = results.calibrate["arms"][name]["splits"]
        used = ", ".join(f"{count} {word}" for word, count in splits.items())
        rest = len(arm) - sum(splits.values())
        kind = profile.arms[name].type.model if name in profile.arms else "?"
        driver = profile.arms[name].driver.kind if name in profile.arms else "?"
        lines.append((f"Readings of arm {name} ({kind})", f"{len(arm)}: {used}, {rest} unused; driver: {driver}"))
    pair = results.calibrate["pair"].get("method_1", {}).get("splits")
    if pair:
        lines.append(("Common stops of the pair", ", ".join(f"{count} {word}" for word, count in pair.items())))
    stated = (("length", settings.priors.length, "m"), ("angle", settings.priors.angle, "rad"))
    priors = [f"{kind} {value:g} {unit}" for kind, value, unit in stated if value is not None]
    lines.append(
        (
            "Settings",
            f"parameter set {settings.parameter_set}, priors {', '.join(priors) or 'none'}, robust {settings.robust}",
        )
    )
    return lines


def _programs(origin: Mapping[str, Any], *, torch_used: bool) -> str:
    words = [origin["program"]]
    words += [f"{shown} {origin[key]}" for key, shown in (("python", "Python"), ("numpy", "numpy")) if key in origin]
    if "torch" in origin:
        words.append(f"torch {origin['torch']}")
    elif torch_used:
        words.append("torch in a version that was not noted")
    return ", ".join(words)


def _hashes(run: RunFile, readings: Mapping[str, Readings]) -> list[tuple[str, str]]:
    calibration = (run.folder / CALIBRATION_FILE).read_bytes()
    return [
        *((f"SHA-256 of the readings of arm {name}", _readings_hash(arm)) for name, arm in readings.items()),
        (f"SHA-256 of {CALIBRATION_FILE}", hashlib.sha256(calibration).hexdigest()),
    ]


def _readings_hash(readings: Readings) -> str:
    """Of the names and the numbers, little-endian, of every array that was measured; neither splits nor extras."""
    digest = hashlib.sha256()
    for entry in fields(readings):
        values = getattr(readings, entry.name)
        if isinstance(values, np.ndarray):
            digest.update(f"{entry.name} {values.shape}\n".encode())
            digest.update(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


# -- figures ----------------------------------------------------------------------------------------------------------


def _draw(
    results: _Results, model: CellModel, readings: Mapping[str, Readings], known: Mapping[str, Circumstances]
) -> _Drawings:
    from cellapp.reporting import figures  # loads matplotlib, which nothing else needs

    drawn = _Drawings([], _pair_drawings(results.calibrate), [], [], _cell_drawings(model, readings))
    for number, (name, arm) in enumerate(model.arms.items(), start=1):
        rows = readings[name].in_split("validate")
        held_out = readings[name].take(rows)
        calibrated = results.calibrate["arms"][name]
        with_effects = results.discover is not None
        errors = _errors_mm(arm, calibrated, held_out, known[name].take(rows), with_effects=with_effects)
        if "network" in calibrated["validate"] and "network" not in errors:
            stored = _stored_network_errors(results.calibrate["pair"], name, held_out)
            if stored is not None:
                errors["network"] = stored
        errors = {stage: errors[stage] for stage in _STAGE_WORDS if stage in errors}
        floor = _noise_floor_mm(held_out)
        floor_line = () if floor is None else (("floor", f"noise floor, {floor:.3f} mm"),)
        marked: tuple[tuple[str, str], ...] = floor_line
        legend = tuple((stage, _STAGE_WORDS[stage]) for stage in errors)
        if "network" in calibrated["validate"] and "network" not in errors:
            marked = (*marked, ("", "network: only in the table, the effects took its place"))
        if "effects" not in errors:
            why = "not looked for yet" if results.discover is None else "none was found"
            marked = (*marked, ("", f"no effects: {why}"))
        svg = figures.error_figure(f"errors{number}", held_out.configuration, errors, floor)
        caption = f"Arm {name}: position error of each held-out configuration"
        drawn.accuracy.append(Drawing(svg, caption, (*legend, *marked)))
        svg = figures.residual_figure(f"residuals{number}", errors, floor)
        caption = f"Arm {name}: how often which position error remains"
        drawn.accuracy.append(Drawing(svg, caption, (*legend, *marked)))
        drawn.vectors.extend(_vector_drawings(number, name, arm, calibrated, held_out))
        measured = [] if results.verify is None else _targets_of(results.verify, name)
        if measured:
            before = np.array([target["nominal_mm"] for target in measured])
            after = np.array([target["compensated_mm"] for target in measured])
            svg = figures.target_figure(f"targets{number}", before, after, floor)
            ways = (("before", "uncompensated"), ("effects", "compensated"))
            drawn.targets.append(Drawing(svg, f"Arm {name}: measured error at new targets", (*ways, *floor_line)))
    return drawn


def _pair_drawings(calibrate: Mapping[str, Any]) -> list[Drawing]:
    """Cooperative errors by method, of results that keep them stop by stop."""
    from cellapp.reporting import figures

    pair = calibrate["pair"]
    kept = {method: pair[method]["held_out"] for method in _METHOD_COLOURS if "held_out" in pair.get(method, {})}
    if not kept:
        return []
    errors = {_METHOD_COLOURS[method]: np.array(entry["cooperative_mm"]) for method, entry in kept.items()}
    stops = np.array(next(iter(kept.values()))["configuration"], dtype=np.int64)
    known = [arm.get("tracker_mm") for arm in calibrate["arms"].values()]
    floor = distance_mm(*known)
    legend = [(_METHOD_COLOURS[method], f"{method}: {_METHOD_WORDS[method]}") for method in kept]
    if floor is not None:
        legend.append(("floor", f"noise floor, {floor:.3f} mm"))
    label = "cooperative error [mm]"
    return [
        Drawing(
            figures.error_figure("pair-errors", stops, errors, floor, label),
            "Pair: cooperative error of each held-out stop",
            tuple(legend),
        ),
        Drawing(
            figures.residual_figure("pair-residuals", errors, floor, label),
            "Pair: how often which cooperative error remains",
            tuple(legend),
        ),
    ]


def _vector_drawings(
    number: int, name: str, arm: ArmModel, calibrated: Mapping[str, Any], held_out: Readings
) -> list[Drawing]:
    """What the identified geometry leaves, as vectors in the tracker frame and in the base frame."""
    from cellapp.reporting import figures

    shown = held_out.take(_thinned(len(held_out), _MOST_ARROWS))
    geometry = _geometry_stage(arm.nominal, calibrated["identified"])
    left_M = shown.p_M - smr_positions(geometry, shown.q)
    T_B_M = invert(geometry.T_M_B())
    left_B = left_M @ T_B_M[:3, :3].T
    length = figures.scale_length_mm(left_M)
    how_many = f"{len(shown)} of {len(held_out)} held-out configurations"
    legend = (("geometry", "measured less computed position"), ("", how_many))
    return [
        Drawing(
            figures.vector_figure(f"vectors-tracker{number}", shown.p_M, left_M, length),
            f"Arm {name}: residuals of the geometry in the tracker frame",
            legend,
        ),
        Drawing(
            figures.vector_figure(f"vectors-base{number}", apply(T_B_M, shown.p_M), left_B, length),
            f"Arm {name}: residuals of the geometry in its base frame",
            legend,
        ),
    ]


def _thinned(n: int, most: int) -> NDArray[np.intp]:
    """At most ``most`` of n rows, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))


def _cell_drawings(model: CellModel, readings: Mapping[str, Readings]) -> list[Drawing]:
    from cellapp.reporting import figures

    level = _levelled(next(iter(model.arms.values())).up_M)
    stops = _typical_rows(readings)
    arms = []
    for name, arm in model.arms.items():
        here = readings[name]
        typical = here.take([stops[name]])
        origins = frame_poses(arm.geometry, typical.q)[1][:, 0]
        arms.append(
            figures.ArmInCell(
                here.p_M[_thinned(len(here), _MOST_POINTS)] @ level.T,
                level @ origins[0],
                np.vstack([origins, smr_positions(arm.geometry, typical.q)]) @ level.T,
            )
        )
    sideways = np.abs(np.mean([arm.base for arm in arms], axis=0))
    across = int(np.argmax(sideways[:2]))  # from the side, the way from the tracker to the arms should be seen in full
    names = [(f"arm{1 + place % figures.ARM_COLOURS}", f"arm {name}") for place, name in enumerate(model.arms)]
    marks = "dots: measured SMR positions; squares: bases; triangle: tracker"
    if any(len(arm) > _MOST_POINTS for arm in readings.values()):
        marks += f"; {_MOST_POINTS} positions of an arm are drawn"
    legend = (*names, ("", marks))
    space = (*names, ("", f"lines: an arm's links at a measured stop, up to its SMR; dotted: line of sight; {marks}"))
    return [
        Drawing(figures.space_figure("cell-space", arms), "The cell in space", space, "wide"),
        Drawing(figures.cell_figure("cell-top", arms, 0, 1), "The cell from above", legend),
        Drawing(figures.cell_figure("cell-side", arms, across, 2), "The cell from the side", legend),
    ]


def _typical_rows(readings: Mapping[str, Readings]) -> dict[str, int]:
    """A row of each arm whose joints are near the middle of all; of one stop of all arms, if they share any."""
    off = {name: np.linalg.norm(arm.q - np.median(arm.q, axis=0), axis=1) for name, arm in readings.items()}
    rows = {name: int(np.argmin(values)) for name, values in off.items()}
    common = set.intersection(*(set(arm.configuration.tolist()) for arm in readings.values()))
    if not common:
        return rows
    places = {
        name: {stop: row for row, stop in enumerate(arm.configuration.tolist())} for name, arm in readings.items()
    }
    best = min(sorted(common), key=lambda stop: sum(float(off[name][places[name][stop]]) for name in off))
    return {name: places[name][best] for name in readings}


def _levelled(up_M: Array) -> Array:
    """The smallest rotation (3, 3) that turns the tracker frame so that ``up_M`` is its z."""
    x, y, z = up_M
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the rotation from up_M to z, with axis up_M x z.
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + z))


def _errors_mm(
    arm: ArmModel, calibrated: Mapping[str, Any], held_out: Readings, known: Circumstances, *, with_effects: bool
) -> dict[str, Array]:
    """Position errors (n,) [mm] by stage; network and effects only where the model has them."""
    computed = {
        "nominal": smr_positions(arm.nominal, held_out.q),
        "geometry": smr_positions(_geometry_stage(arm.nominal, calibrated["identified"]), held_out.q),
    }
    if arm.network is not None and not arm.effects:
        computed["network"] = arm.predict(held_out.q, known=known)
    if with_effects and arm.effects:
        computed["effects"] = arm.predict(held_out.q, known=known)
    return {stage: position_errors(held_out.p_M, points) * 1e3 for stage, points in computed.items()}


def _certainties(
    model: CellModel, readings: Mapping[str, Readings], known: Mapping[str, Circumstances]
) -> dict[str, tuple[Array, Array]]:
    """Predicted standard deviation of a coordinate and position error (n,) [mm] of arms whose model predicts one."""
    found = {}
    for name, arm in model.arms.items():
        rows = readings[name].in_split("validate")
        held_out = readings[name].take(rows)
        predicted = arm.uncertainty(held_out.q) * 1e3
        if predicted.any():
            errors = position_errors(held_out.p_M, arm.predict(held_out.q, known=known[name].take(rows))) * 1e3
            found[name] = (predicted, errors)
    return found


def _stored_network_errors(pair: Mapping[str, Any], name: str, held_out: Readings) -> Array | None:
    """Position errors (n,) [mm] with the network, which effects replace in the model, as the pair's stops keep them.

    None where those are not the arm's held-out configurations.
    """
    kept = pair.get("proposed", {}).get("held_out")
    if kept is None or sorted(kept["configuration"]) != sorted(held_out.configuration.tolist()):
        return None
    of_stop = dict(zip(kept["configuration"], kept["position_mm"][name], strict=True))
    return np.array([of_stop[stop] for stop in held_out.configuration.tolist()])


def _geometry_stage(nominal: Geometry, identified: Mapping[str, Mapping[str, Any]]) -> Geometry:
    """The geometry before effects: ``discover`` refits the one that is stored in ``calibration.json``."""
    values = dict(zip(parameter_names(nominal.joints), nominal.vector().tolist(), strict=True))
    values.update({name: entry["value"] for name, entry in identified.items()})
    return nominal.with_vector(np.array(list(values.values())))


def _noise_floor_mm(held_out: Readings) -> float | None:
    """Root mean square length of the noise that the readings state; None where they state none."""
    sigma = stated_uncertainty(held_out)
    if sigma is None:
        return None
    squares: Sequence[float] | Array = 3.0 * sigma**2 if sigma.ndim == 1 else np.trace(sigma, axis1=1, axis2=2)
    return math.sqrt(float(np.mean(squares))) * 1e3
