"""One self-contained HTML page of a run."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import cellapp
from cellapp.calibration.calibrate import CALIBRATION_FILE, RESULT
from cellapp.calibration.evaluation import position_errors
from cellapp.calibration.setup import stated_uncertainty
from cellapp.discovery.discover import DISCOVER_RESULT
from cellapp.errors import InputError
from cellapp.kinematics.chain import Geometry, parameter_names, smr_positions
from cellapp.kinematics.transforms import Array
from cellapp.model import ArmModel, CellModel
from cellapp.profile import Profile
from cellapp.reporting.tables import (
    METHODS,
    Table,
    calibration_tables,
    discovery_tables,
    parameter_tables,
    verification_tables,
)
from cellapp.run import Readings, RunFile

PAGE_FILE = "report.html"

_VERIFY_RESULT = "verify"  # as in cellapp.whole, which imports this module
_NO_PAIR = "pair: skipped"
_MOST_EVENTS = 100
_FOR_EYES = {"rad": (1e6, "µrad"), "rad/Nm": (1e6, "µrad/Nm"), "m": (1e6, "µm")}
_STAGE_WORDS = {"nominal": "nominal", "geometry": "identified geometry", "effects": "geometry and effects"}
_METHOD_WORDS = {
    "nominal": "the nominal cell",
    "method_1": "geometry alone",
    "method_2": "geometry and a network in the tracker frame",
    "proposed": "geometry and a network in the base frame",
    "effects": "geometry and effects",
}


@dataclass(frozen=True)
class _Drawing:
    """A figure as SVG with its caption; ``legend`` pairs the name of a colour of the style sheet with a text."""

    svg: str
    caption: str
    legend: tuple[tuple[str, str], ...]


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
    accuracy, targets, cell = _draw(results, model, readings)
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
        accuracy=accuracy,
        accuracy_tables=calibration_tables(results.calibrate),
        methods=[(method, words) for method, words in _METHOD_WORDS.items() if method in results.calibrate["pair"]],
        discovery_tables=[] if discover is None else [*discovery_tables(discover), *_effect_tables(discover)],
        doubts=[] if discover is None else _doubts(discover),
        targets=targets,
        verification_tables=[] if verify is None else verification_tables(verify),
        target_tables=[] if verify is None else _target_tables(verify),
        cell=cell,
        cell_table=_base_table(model),
        parameter_tables=[*parameter_tables(results.calibrate), *_pair_tables(results.calibrate)],
        merged_tables=_merged_tables(results.calibrate),
        provenance=_provenance(run.profile, results, readings),
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
    elif any("effects" not in arm["validate"] for arm in calibrate["arms"].values()):
        discover = None
        missing.append(
            ("Missing effects", "the run was calibrated again since they were found; run anew: cellapp discover DIR")
        )
    if verify is None or not verify["arms"]:
        why = "measure targets with: cellapp push DIR TARGETS --verify"
        if verify is not None:
            why = "targets were pushed, but none was measured with both commands; " + why
        elif all(arm.driver.kind == "none" for arm in run.profile.arms.values()):
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
            reason = found["sentence"].removeprefix(f"arm {name}: ")
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


def _doubts(discover: Mapping[str, Any]) -> list[str]:
    """What else fits nearly as well, and what these data cannot show at all."""
    lines = []
    for name, arm in discover["arms"].items():
        for found in arm["accepted"]:
            for rival in found["runners_up"]:
                word = "tell" if rival["told_apart"] else "cannot tell"
                lines.append(
                    f"Arm {name}: {rival['effect']} fits nearly as well as {found['effect']};"
                    f" these data {word} the two apart."
                )
        for entry in arm["invisible"]:
            sizes = entry["smallest_seen"]
            if sizes is None:
                lines.append(f"Arm {name}: {entry['effect']}: {entry['reason']}.")
            elif any(size["value"] is None for size in sizes.values()):
                lines.append(f"Arm {name}: {entry['effect']}: not every joint's part can be seen in these data.")
    return lines


# -- tables that only the page has ------------------------------------------------------------------------------------


def _right_aligned(table: Table) -> list[bool]:
    """For each column whether it holds numbers: they are read by their last digits."""
    return [
        place > 0 and all(_is_number(row[place]) for row in table.rows if row[place])
        for place in range(len(table.columns))
    ]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _effect_tables(discover: Mapping[str, Any]) -> list[Table]:
    """Parameters of the effects that were found, and how small the others could have been."""
    worth: list[Table] = []
    unseen: list[Table] = []
    for name, arm in discover["arms"].items():
        found = [
            (entry["effect"], parameter, *_with_unit(value["unit"], value["value"], value["standard_error"]))
            for entry in arm["accepted"]
            for parameter, value in entry["parameters"].items()
        ]
        if found:
            columns = ("effect", "parameter", "value", "standard error", "unit")
            worth.append(Table(f"Arm {name}: size of the effects", columns, tuple(found)))
        others = []
        for entry in arm["invisible"]:
            sizes = list((entry["smallest_seen"] or {}).values())
            seen = [size["value"] for size in sizes if size["value"] is not None]
            if seen:
                others.append((entry["effect"], *_with_unit(sizes[0]["unit"], min(seen), max(seen))))
        if others:
            heads = ("effect", "best joint", "worst joint", "unit")
            unseen.append(Table(f"Arm {name}: not found; smallest sizes that would show", heads, tuple(others)))
    return worth + unseen


def _with_unit(unit: str, *values: float) -> tuple[str, ...]:
    factor, shown = _FOR_EYES.get(unit, (1.0, unit))
    return (*(f"{value * factor:.2f}" for value in values), shown)


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
            rows.append((name, f"{entry['value'] * factor:.5f}", f"{entry['standard_error'] * factor:.5f}", unit))
        if rows:
            first, second = calibrate["arms"]
            title = f"Pair: base of {first} in the base of {second}, with {_METHOD_WORDS[method]}"
            tables.append(Table(title, ("parameter", "value", "standard error", "unit"), tuple(rows)))
    return tables


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
    origin = results.calibrate["provenance"]
    settings = profile.calibration
    lines = [
        ("Profile", profile.name),
        ("Seed of splits and draws", str(origin["seed"])),
        *([] if profile.plant is None else [("Seed of the simulated cell", str(profile.plant.seed))]),
        ("Calibrated by", f"{origin['program']}, numpy {origin['numpy']}"),
        ("Calibrated at", origin["written"]),
        ("Page made by", f"cellapp {cellapp.__version__}"),
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


# -- figures ----------------------------------------------------------------------------------------------------------


def _draw(
    results: _Results, model: CellModel, readings: Mapping[str, Readings]
) -> tuple[list[_Drawing], list[_Drawing], list[_Drawing]]:
    """Figures of accuracy, of targets and of the cell."""
    from cellapp.reporting import figures  # loads matplotlib, which nothing else needs

    accuracy, targets = [], []
    for number, (name, arm) in enumerate(model.arms.items(), start=1):
        held_out = readings[name].take(readings[name].in_split("validate"))
        errors = _errors_mm(arm, results.calibrate["arms"][name], held_out, with_effects=results.discover is not None)
        floor = _noise_floor_mm(held_out)
        floor_line = () if floor is None else (("floor", f"noise floor, {floor:.3f} mm"),)
        marked: tuple[tuple[str, str], ...] = floor_line
        legend = tuple((stage, _STAGE_WORDS[stage]) for stage in errors)
        if "effects" not in errors:
            why = "not looked for yet" if results.discover is None else "none was found"
            marked = (*floor_line, ("", f"no effects: {why}"))
        svg = figures.error_figure(f"errors{number}", held_out.configuration, errors, floor)
        accuracy.append(_Drawing(svg, f"Arm {name}: position error of each held-out configuration", (*legend, *marked)))
        fitted = {stage: values for stage, values in errors.items() if stage != "nominal"}
        svg = figures.residual_figure(f"residuals{number}", fitted, floor)
        caption = f"Arm {name}: how large the remaining errors are"
        accuracy.append(_Drawing(svg, caption, (*legend[1:], *marked)))
        measured = [] if results.verify is None else _targets_of(results.verify, name)
        if measured:
            before = np.array([target["nominal_mm"] for target in measured])
            after = np.array([target["compensated_mm"] for target in measured])
            svg = figures.target_figure(f"targets{number}", before, after, floor)
            ways = (("before", "uncompensated"), ("effects", "compensated"))
            targets.append(_Drawing(svg, f"Arm {name}: measured error at new targets", (*ways, *floor_line)))
    return accuracy, targets, _cell_drawings(model, readings)


def _cell_drawings(model: CellModel, readings: Mapping[str, Readings]) -> list[_Drawing]:
    from cellapp.reporting import figures

    level = _levelled(next(iter(model.arms.values())).up_M)
    arms = [
        figures.ArmInCell(readings[name].p_M @ level.T, level @ arm.geometry.T_M_B()[:3, 3])
        for name, arm in model.arms.items()
    ]
    sideways = np.abs(np.mean([arm.base for arm in arms], axis=0))
    across = int(np.argmax(sideways[:2]))  # from the side, the way from the tracker to the arms should be seen in full
    legend = (
        *((f"arm{1 + place % figures.ARM_COLOURS}", f"arm {name}") for place, name in enumerate(model.arms)),
        ("", "dots: measured SMR positions; squares: bases; triangle: tracker"),
    )
    return [
        _Drawing(figures.cell_figure("cell-top", arms, 0, 1), "The cell from above", legend),
        _Drawing(figures.cell_figure("cell-side", arms, across, 2), "The cell from the side", legend),
    ]


def _levelled(up_M: Array) -> Array:
    """The smallest rotation (3, 3) that turns the tracker frame so that ``up_M`` is its z."""
    x, y, z = up_M
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the rotation from up_M to z, with axis up_M x z.
    skew = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + z))


def _errors_mm(
    arm: ArmModel, calibrated: Mapping[str, Any], held_out: Readings, *, with_effects: bool
) -> dict[str, Array]:
    """Position errors (n,) [mm] by stage; effects only where some were found."""
    computed = {
        "nominal": smr_positions(arm.nominal, held_out.q),
        "geometry": smr_positions(_geometry_stage(arm.nominal, calibrated["identified"]), held_out.q),
    }
    if with_effects and arm.effects:
        computed["effects"] = arm.predict(held_out.q, held_out.approach, held_out.payload_kg)
    return {stage: position_errors(held_out.p_M, points) * 1e3 for stage, points in computed.items()}


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
