"""Accuracy tables of calibration and verification, for terminal, TUI and page."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cellapp.commands.calibrate.request import CalibrateRequest
from cellapp.commands.record import Request, View
from cellapp.commands.view.table import Cell, Interval, Table, columns_of
from cellapp.commands.view.words import METHOD_WORDS, STAGE_WORDS, display_unit
from cellapp.estimation.calibration.records import (
    ArmCalibrationResult,
    ArmPriorResult,
    BatchesResult,
    CalibrateResult,
    ClockResult,
    PairMethodResult,
    ParameterEstimate,
    PartDrift,
)
from cellapp.ground.counting import counted
from cellapp.ground.results import METHODS, STAGES, ErrorSummary
from cellapp.ground.shell import shell_word
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import parameter_unit

MM = ".4f"
"""Number format of errors in mm: a tenth of a micrometre, below the tracker's resolution."""

_MOST_SHARES = 3
PARAMETERS_ABOUT = (
    "prior: standard deviation about the nominal value that holds a parameter beside the readings; free without one."
    " A merged parameter keeps its nominal value: these data cannot separate it from others"
)

ERROR_COLUMNS = (*((title, MM) for title in ("mean", "rms", "std", "max")), ("n", "d"))
_DETAILED = ("mean", "95 % of mean", "rms", "std", "median", "95 %", "max")
_DETAILED_COLUMNS = (*((title, MM) for title in _DETAILED), ("n", "d"))
_PAIRS = "between arms"
_ROTATION = "orientation [mrad]"
_PAIR_TITLE = "Pair: held-out cooperative errors [mm]"


def view(result: CalibrateResult, request: Request | None = None) -> View:
    """Show held-out errors, parameters on request, beside them the tracker's own uncertainty, and what comes next."""
    asked = request if isinstance(request, CalibrateRequest) else None
    shown = parameters_view(result).parts if asked and asked.parameters else ()
    onward = [f"next: cellapp discover {shell_word(asked.folder)}"] if asked else []
    return View((*calibration_tables(result), *shown, *tracker_sentences(result), *result.notes, *onward))


def parameters_view(result: CalibrateResult) -> View:
    """Show identified parameters, and which parameters were merged into others."""
    return View((*parameter_tables(result), PARAMETERS_ABOUT))


def calibration_tables(result: CalibrateResult) -> list[Table]:
    """Show held-out errors by stage of each arm and by method of the pair, further tables, priors and changes."""
    tables = []
    for name, arm in result.arms.items():
        rows = [(label, *error_cells(summary)) for label, _, summary in _stage_summaries(arm)]
        tables.append(Table(_arm_title(name, arm), columns_of("stage, measure", *ERROR_COLUMNS), tuple(rows)))
    if result.pair:
        rows = [(label, *error_cells(errors)) for label, _, errors in _pair_summaries(result)]
        tables.append(Table(_PAIR_TITLE, columns_of("method", *ERROR_COLUMNS), tuple(rows)))
    return [*tables, *_tables_of_kinds(result)]


def _tables_of_kinds(result: CalibrateResult) -> list[Table]:
    """Show results from recordings of motion, and the priors."""
    return [*motion_tables(result), *prior_tables(result)]


def detailed_tables(result: CalibrateResult) -> list[Table]:
    """Build ``calibration_tables`` with percentiles, the 95 % interval of each mean, and the ratio to the tracker's
    noise.

    The ratio is the rms error over the rms error that the tracker's stated uncertainty alone would cause.
    """
    columns = (*_DETAILED_COLUMNS, ("rms / tracker", ".1f"))
    tables = []
    for name, arm in result.arms.items():
        noise_mm = {"position": arm.tracker_mm or None, "distance": distance_mm(arm.tracker_mm, arm.tracker_mm)}
        rows = [
            (_in_full(label), *_detailed_cells(summary), _ratio(summary, noise_mm.get(measure)))
            for label, measure, summary in _stage_summaries(arm)
        ]
        tables.append(Table(_arm_title(name, arm), columns_of("stage, measure", *columns), tuple(rows)))
    if result.pair:
        noise = {"distance": cooperative_noise_mm(result), "orientation": cooperative_noise_mrad(result)}
        rows = [
            (label, *_detailed_cells(errors), _ratio(errors, noise[measure]))
            for label, measure, errors in _pair_summaries(result)
        ]
        tables.append(Table(_PAIR_TITLE, columns_of("method", *columns), tuple(rows)))
    return [*tables, *_tables_of_kinds(result)]


def transform_tables(result: CalibrateResult) -> list[Table]:
    """Show cooperative errors with either inter-base transform on the same held-out stops; empty without a pair."""
    rows = []
    for method in METHODS:
        if (own := result.pair.get(method)) is None:
            continue
        rotated = own.by_transform_mrad or {}
        for transform, summary in own.by_transform_mm.items():
            label = f"{METHOD_WORDS[method]}, by {transform_words(transform, own)}"
            rows.append((label, *_detailed_cells(summary)))
            if transform in rotated:
                rows.append((f"{label}, {_ROTATION}", *_detailed_cells(rotated[transform])))
    if not rows:
        return []
    columns = columns_of("method, transform", *_DETAILED_COLUMNS)
    return [Table("Pair: cooperative errors by either transform [mm]", columns, tuple(rows))]


def transform_words(transform: str, method: PairMethodResult) -> str:
    """Say what the inter-base transform rests on."""
    if transform == "distances":
        return "distances alone" if method.cooperative_mrad is None else "distances and relative rotations"
    return "the tracker frame"


def parameter_tables(result: CalibrateResult) -> list[Table]:
    """Show identified parameters with nominal value, difference, standard error, prior and largest correlation, and
    the parameters that were merged into them; one table for each arm.
    """
    numbers = (("nominal", ".4f"), ("value", ".4f"), ("difference", "+.4f"), ("standard error", ".4f"))
    columns = columns_of("parameter", *numbers, "unit", ("prior", ".4f"), "largest correlation, or merged into")
    tables = []
    for name, arm in result.arms.items():
        rows = [(parameter, *_parameter_cells(estimate)) for parameter, estimate in arm.identified.items()]
        merged = [(key, *[None] * 4, "", None, f"merged into {merged_words(its)}") for key, its in arm.merged.items()]
        held = {key: _parameter_cells(_fixed_at(key, value)) for key, value in (arm.fixed or {}).items()}
        fixed = [(key, *cells[:-1], "fixed") for key, cells in held.items()]
        tables.append(Table(f"Arm {name}: parameters", columns, (*rows, *fixed, *merged)))
    return tables


def _fixed_at(parameter: str, value: float) -> ParameterEstimate:
    return ParameterEstimate(value=value, nominal=value, standard_error=None, unit=parameter_unit(parameter))


def _parameter_cells(estimate: ParameterEstimate) -> tuple[Cell, ...]:
    unit, nominal = {"m": "mm", "rad": "mrad"}.get(estimate.unit, estimate.unit), estimate.nominal
    difference = None if nominal is None else estimate.value - nominal
    if difference is not None and estimate.unit == "rad":
        difference = math.remainder(difference, math.tau)
    values = (nominal, estimate.value, difference, estimate.standard_error, estimate.prior_sigma)
    *shown, prior = (None if one is None else one * (1.0 if unit == estimate.unit else 1e3) for one in values)
    largest = next((f"{other} {rho:+.2f}" for other, rho in estimate.correlations.items()), "")
    if estimate.at_bound or estimate.tied_to:
        largest = "at its bound" if estimate.at_bound else f"tied to {estimate.tied_to}"
    return (*shown, unit, prior, largest)


def merged_words(shares: Mapping[str, float]) -> str:
    """List the parameters that stand for a merged one, with their shares; of many the largest."""
    largest = sorted(shares.items(), key=lambda one: -abs(one[1]))[:_MOST_SHARES]
    words = ", ".join(f"{share:+.4g} {kept}" for kept, share in largest) or "nothing (no effect)"
    return f"{words} and {len(shares) - len(largest)} more" if len(shares) > len(largest) else words


def tracker_sentences(result: CalibrateResult) -> list[str]:
    """State the error of each arm's last stage beside the tracker's uncertainty; notes on networks, motion, priors."""
    sentences = []
    for name, arm in result.arms.items():
        if arm.tracker_mm is None:
            sentences.append(f"arm {name}: the readings state no uncertainty to compare with")
            continue
        rms = arm.validate_[arm.best_stage].position_mm.rms
        sentences.append(
            f"arm {name}: {arm.best_stage} leaves {rms:.4f} mm rms, {rms / arm.tracker_mm:.1f} times the tracker's own"
            f" {arm.tracker_mm:.4f} mm"
        )
    more = (*network_sentences(result), *motion_sentences(result))
    return [*sentences, *more, *prior_sentences(result)]


def distance_mm(first: float | None, second: float | None) -> float | None:
    """Return the rms error [mm] of the distance of two points, from the rms lengths of their noise [mm].

    A distance has the noise of each point along one direction of three: sqrt((a^2 + b^2) / 3). None if either length
    is not known.
    """
    return None if not first or not second else math.sqrt((first**2 + second**2) / 3.0)


def cooperative_noise_mm(result: CalibrateResult) -> float | None:
    """Return the rms cooperative error [mm] that the stated uncertainty of the tracker alone would cause."""
    lengths = [arm.tracker_mm for arm in result.arms.values()]
    return distance_mm(lengths[0], lengths[1]) if len(lengths) == 2 else None


def cooperative_noise_mrad(result: CalibrateResult) -> float | None:
    """Return the rms angle [mrad] between two flanges that the stated uncertainty of both probes alone would cause."""
    lengths = [arm.probe_mrad for arm in result.arms.values() if arm.probe_mrad]
    return math.hypot(*lengths) if len(lengths) == 2 else None


def _arm_title(name: str, arm: ArmCalibrationResult) -> str:
    return (
        f"Arm {name}: held-out errors [mm] ({counted(arm.rank, 'parameter')}, {counted(arm.iterations, 'iteration')})"
    )


def _stage_summaries(arm: ArmCalibrationResult) -> list[tuple[str, str, ErrorSummary]]:
    """Return the label, measure (position, orientation or distance) and errors of each stage."""
    found = []
    for stage in STAGES:
        if stage in arm.validate_:
            errors = arm.validate_[stage]
            found.append((f"{stage}, position", "position", errors.position_mm))
            if errors.orientation_mrad is not None:
                found.append((f"{stage}, {_ROTATION}", "orientation", errors.orientation_mrad))
            if errors.distance_mm is not None:
                found.append((f"{stage}, distance", "distance", errors.distance_mm))
    return found


def _in_full(label: str) -> str:
    """Return the label of a stage's measure as charts and sentences name it."""
    stage, _, measure = label.partition(", ")
    return f"{STAGE_WORDS[stage]}, {measure}"


def _pair_summaries(result: CalibrateResult) -> list[tuple[str, str, ErrorSummary]]:
    """Return the label, measure (distance or orientation) and errors of each method of the pair."""
    found = []
    for method in METHODS:
        if (own := result.pair.get(method)) is not None:
            found.append((METHOD_WORDS[method], "distance", own.cooperative_mm))
            if own.cooperative_mrad is not None:
                found.append((f"{METHOD_WORDS[method]}, {_ROTATION}", "orientation", own.cooperative_mrad))
    return found


def error_cells(summary: ErrorSummary) -> tuple[Cell, ...]:
    """Return the cells of ``ERROR_COLUMNS``."""
    return summary.mean, summary.rms, summary.std, summary.max, summary.n


def _detailed_cells(summary: ErrorSummary) -> tuple[Cell, ...]:
    interval = None if summary.mean_ci95 is None else Interval(*summary.mean_ci95)
    return summary.mean, interval, summary.rms, summary.std, summary.p50, summary.p95, summary.max, summary.n


def _ratio(summary: ErrorSummary, noise_mm: float | None) -> float | None:
    return None if noise_mm is None else summary.rms / noise_mm


# -- Tables of an earlier calibration used as prior: how far it was believed, and what has changed since --------------


def prior_tables(result: CalibrateResult) -> list[Table]:
    """Show parts and changes of every arm that was calibrated with a prior; none without one."""
    tables = []
    for name, arm in result.arms.items():
        if arm.prior is not None:
            tables.append(_part_table(name, arm.prior))
            if arm.prior.changes:
                tables.append(_change_table(name, arm.prior))
    return tables


def prior_sentences(result: CalibrateResult) -> list[str]:
    """Say where the prior of each arm comes from, and whether the arm has changed since."""
    said = []
    for name, arm in result.arms.items():
        if (prior := arm.prior) is None:
            continue
        effects = ", ".join(EFFECTS[slug].title for slug in prior.effects if slug in EFFECTS)
        dropped = ", ".join(EFFECTS[slug].title for slug in prior.left_behind if slug in EFFECTS)
        said.append(
            f"arm {name}: {prior.run} ({prior.since}, {counted(prior.readings, 'reading')}) is the prior; carried over:"
            f" geometry{f', {effects}' if effects else ''}"
            + (f"; of the earlier installation, not carried over: {dropped}" if dropped else "")
        )
        if not prior.changes:
            said.append(f"arm {name}: no change of a single parameter is proven ({prior.tested} were tested)")
    return said


def _part_table(name: str, prior: ArmPriorResult) -> Table:
    columns = columns_of("part", ("values", "d"), ("may have drifted", ".3g"), "unit", "believed")
    rows = [
        (part, one.parameters, *_drift(one), "yes" if one.used else "no: the readings contradict it")
        for part, one in prior.parts.items()
    ]
    return Table(f"Arm {name}: earlier calibration of {prior.since}", columns, tuple(rows))


def _drift(one: PartDrift) -> tuple[Cell, Cell]:
    if one.drift is None:
        return None, ""
    if one.unit == "m, rad":
        return one.drift * 1e6, "µm, µrad"
    return one.drift * 100.0, f"% {one.unit}"


def _change_table(name: str, prior: ArmPriorResult) -> Table:
    columns = columns_of(
        "what",
        ("change", "+.3f"),
        ("standard error", ".3f"),
        "unit",
        ("sigmas", ".1f"),
        ("evidence", ".0f"),
        ("at the SMR", ".3f", "mm"),
        "as likely",
    )
    rows: list[tuple[Cell, ...]] = []
    for one in prior.changes:
        factor, unit = display_unit(one.unit) if one.unit else (1.0, "")
        scaled = (None if value is None else value * factor for value in (one.value, one.standard_error))
        likely = ", ".join(one.rivals)
        rows.append((one.what, *scaled, unit, one.sigmas, one.evidence, one.moved_mm, likely))
    return Table(f"Arm {name}: changed since {prior.since}", columns, tuple(rows))


# -- Results of recordings of motion for people: clocks, weight of the points, lost motion, what is not determined ----


_CLOCKS = columns_of(
    "arm",
    "recording",
    ("offset [s]", ".6f"),
    ("standard error [ms]", ".4f"),
    ("rate [ppm]", ".3f"),
    ("standard error [ppm]", ".3f"),
    ("clock steps", "d"),
)
_RECORDINGS = columns_of(
    "arm",
    "recording",
    ("points", "d"),
    ("learnt", "d"),
    ("worth", ".0f"),
    ("held out", "d"),
    ("gross", "d"),
    ("in gaps", "d"),
    ("scatter [mm]", ".4f"),
    ("held-out rms [mm]", ".4f"),
)
_PLAY = columns_of("arm", "joint", ("half play [urad]", ".1f"), ("standard error [urad]", ".1f"))
_SURE = 2.0
"""Lost motion is shown as found from this many standard errors on."""


def motion_tables(result: CalibrateResult) -> list[Table]:
    """Show clocks, recordings and lost motion of all recorded arms; none without recordings."""
    moved = {name: arm for name, arm in result.arms.items() if arm.motion is not None}
    if not moved:
        return []
    clocks: list[tuple[Cell, ...]] = []
    recordings: list[tuple[Cell, ...]] = []
    for name, arm in moved.items():
        clocks += [(name, recording, *_clock(clock)) for recording, clock in (arm.clocks or {}).items()]
        for recording, one in arm.motion.recordings.items() if arm.motion else ():
            counts = (one.points, one.learnt, one.effective_points, one.held_out, one.gross, one.in_gaps)
            recordings.append((name, recording, *counts, one.scatter_mm, one.heldout_rms_mm))
    return [
        Table("Clocks: the tracker's against the controller's", _CLOCKS, tuple(clocks)),
        Table("Recordings: what their points are worth as independent ones", _RECORDINGS, tuple(recordings)),
        *_in_motion(moved),
        *_play(moved),
    ]


def motion_sentences(result: CalibrateResult) -> list[str]:
    """State steps of the clocks, and what the data cannot determine."""
    said = []
    for name, arm in result.arms.items():
        for recording, clock in (arm.clocks or {}).items():
            for device, steps in (("controller", clock.steps_of_joints), ("tracker", clock.steps_of_points)):
                said += [
                    f"arm {name}: recording '{recording}': the {device}'s clock steps by {by:+.4g} s at {at:.4f} s"
                    for at, by in steps
                ]
        if arm.motion is not None:
            said += [f"arm {name}: not determined: {sentence}" for sentence in arm.motion.undetermined]
    return said


def _clock(clock: ClockResult) -> tuple[Cell, ...]:
    steps = len(clock.steps_of_joints) + len(clock.steps_of_points)
    errors = clock.offset_standard_error_s * 1e3, clock.rate_standard_error_ppm
    return clock.offset_s, errors[0], clock.rate_ppm, errors[1], steps


def _in_motion(moved: dict[str, ArmCalibrationResult]) -> list[Table]:
    """Show errors of held-out blocks of motion, for arms whose held-out errors are those of stops."""
    rows: list[tuple[Cell, ...]] = []
    for name, arm in moved.items():
        if arm.motion is not None and arm.validate_ != arm.motion.validate_:
            for stage, errors in arm.motion.validate_.items():
                its = errors.position_mm
                rows.append((name, stage, its.mean, its.rms, its.std, its.max, its.n))
    columns = columns_of("arm", "stage", *((title, ".4f") for title in ("mean", "rms", "std", "max")), ("n", "d"))
    return [Table("In motion: errors of held-out blocks of time [mm]", columns, tuple(rows))] if rows else []


def _play(moved: dict[str, ArmCalibrationResult]) -> list[Table]:
    """Show the joints whose lost motion is larger than chance would give."""
    rows: list[tuple[Cell, ...]] = []
    for name, arm in moved.items():
        for joint, found in arm.motion.half_play.items() if arm.motion else ():
            error = found.standard_error or 0.0
            if found.value > _SURE * error:
                rows.append((name, joint, found.value * 1e6, error * 1e6))
    return [Table("Lost motion", _PLAY, tuple(rows))] if rows else []


# -- Comparison of a network from all readings with the committee, in words -------------------------------------------


def network_sentences(result: CalibrateResult) -> list[str]:
    """Return one sentence for each arm for which a network from all readings was requested."""
    said = []
    for name, arm in result.arms.items():
        if arm.network is not None and arm.network.batches is not None:
            said.append(f"arm {name}: a network {batches_words(arm.network.batches)}")
    return said


def batches_words(found: BatchesResult) -> str:
    """Say how the network compared with the committee, and whether it is used."""
    compared = (
        f"{found.left_out_rms_mm:.4f} mm rms on {found.blocks} left-out blocks of time, the committee"
        f" {found.committee_rms_mm:.4f} mm ({found.sigmas:.1f} standard errors)"
    )
    used = "it is the network" if found.used else "it is not used: it is not surely better"
    return f"from {counted(found.readings, 'reading')} in batches leaves {compared}; {used}"
