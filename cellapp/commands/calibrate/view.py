"""Accuracy tables of calibration and verification, for terminal, TUI and page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from cellapp.commands.calibrate.request import CalibrateRequest
from cellapp.commands.record import View
from cellapp.commands.view.table import Cell, Field, Interval, Table, table_of, table_of_cells, with_rows
from cellapp.commands.view.words import METHOD_WORDS, STAGE_WORDS, display_unit
from cellapp.estimation.calibration.records import (
    ArmCalibrationResult,
    ArmPriorResult,
    BatchesResult,
    CalibrateResult,
    PairMethodResult,
    ParameterEstimate,
    PartDrift,
)
from cellapp.ground.counting import counted
from cellapp.ground.results import METHODS, STAGES
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

_STATISTICS: Mapping[str, Field] = {
    name: (name, source, number_format)
    for name, source, number_format in (
        ("mean", lambda row: row[1].mean, MM),
        ("95 % of mean", lambda row: row[1].mean_ci95 and Interval(*row[1].mean_ci95), MM),
        ("rms", lambda row: row[1].rms, MM),
        ("std", lambda row: row[1].std, MM),
        ("median", lambda row: row[1].p50, MM),
        ("95 %", lambda row: row[1].p95, MM),
        ("max", lambda row: row[1].max, MM),
        ("n", lambda row: row[1].n, "d"),
        ("rms / tracker", lambda row: row[1].rms / row[2] if row[2] else None, ".1f"),
    )
}
"""Columns of rows (label, errors, rms error that the tracker's stated uncertainty alone would cause)."""
_SHORT = ("mean", "rms", "std", "max", "n")
_DETAILED = ("mean", "95 % of mean", "rms", "std", "median", "95 %", "max", "n")
_ROTATION = "orientation [mrad]"
_PAIR_TITLE = "Pair: held-out cooperative errors [mm]"


def view(result: CalibrateResult, request: CalibrateRequest | None = None) -> View:
    """Show held-out errors, parameters on request, beside them the tracker's own uncertainty, and what comes next."""
    shown = parameters_view(result).parts if request and request.parameters else ()
    onward = [f"next: cellapp discover {shell_word(request.folder)}"] if request else []
    return View((*calibration_tables(result), *shown, *tracker_sentences(result), *result.notes, *onward))


def parameters_view(result: CalibrateResult) -> View:
    """Show identified parameters, and which parameters were merged into others."""
    return View((*parameter_tables(result), PARAMETERS_ABOUT))


def calibration_tables(result: CalibrateResult) -> list[Table]:
    """Show held-out errors by stage of each arm and by method of the pair, further tables, priors and changes."""
    return _error_tables(result, {stage: stage for stage in STAGES}, _SHORT)


def error_table(title: str, what: str, rows: Iterable[Sequence[Any]], shown: Sequence[str] = _SHORT) -> Table:
    """Show statistics of errors; a row is (label, errors, noise), the noise only where the table has their ratio."""
    return table_of(title, rows, (what, itemgetter(0)), *(_STATISTICS[name] for name in shown))


def _error_tables(result: CalibrateResult, words: Mapping[str, str], shown: Sequence[str]) -> list[Table]:
    """Show errors of arms and pair, then results from recordings of motion, and the priors."""
    arms = (
        error_table(_arm_title(name, arm), "stage, measure", _stage_errors(arm, words), shown)
        for name, arm in result.arms.items()
    )
    pair = error_table(_PAIR_TITLE, "method", _pair_errors(result), shown)
    return [*arms, *with_rows(pair), *motion_tables(result), *prior_tables(result)]


def detailed_tables(result: CalibrateResult) -> list[Table]:
    """Build ``calibration_tables`` with percentiles, the 95 % interval of each mean, and the ratio to the tracker's
    noise.

    The ratio is the rms error over the rms error that the tracker's stated uncertainty alone would cause.
    """
    return _error_tables(result, STAGE_WORDS, (*_DETAILED, "rms / tracker"))


def transform_tables(result: CalibrateResult) -> list[Table]:
    """Show cooperative errors with either inter-base transform on the same held-out stops; empty without a pair."""
    rows = []
    for method in METHODS:
        if (own := result.pair.get(method)) is None:
            continue
        rotated = own.by_transform_mrad or {}
        for transform, summary in own.by_transform_mm.items():
            label = f"{METHOD_WORDS[method]}, by {transform_words(transform, own)}"
            rows.append((label, summary))
            if transform in rotated:
                rows.append((f"{label}, {_ROTATION}", rotated[transform]))
    title = "Pair: cooperative errors by either transform [mm]"
    return with_rows(error_table(title, "method, transform", rows, _DETAILED))


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
    columns = "parameter", *numbers, "unit", ("prior", ".4f"), "largest correlation, or merged into"
    tables = []
    for name, arm in result.arms.items():
        rows = [(parameter, *_parameter_cells(estimate)) for parameter, estimate in arm.identified.items()]
        merged = [(key, *[None] * 4, "", None, f"merged into {merged_words(its)}") for key, its in arm.merged.items()]
        held = {key: _parameter_cells(_fixed_at(key, value)) for key, value in (arm.fixed or {}).items()}
        fixed = [(key, *cells[:-1], "fixed") for key, cells in held.items()]
        tables.append(table_of_cells(f"Arm {name}: parameters", (*rows, *fixed, *merged), *columns))
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


def _stage_errors(arm: ArmCalibrationResult, words: Mapping[str, str]) -> Iterator[tuple[Any, ...]]:
    """Yield what is measured after each stage, its errors, and the noise to compare with."""
    for stage in STAGES:
        if (errors := arm.validate_.get(stage)) is not None:
            yield f"{words[stage]}, position", errors.position_mm, arm.tracker_mm
            if errors.orientation_mrad is not None:
                yield f"{words[stage]}, {_ROTATION}", errors.orientation_mrad, None
            if errors.distance_mm is not None:
                yield f"{words[stage]}, distance", errors.distance_mm, distance_mm(arm.tracker_mm, arm.tracker_mm)


def _pair_errors(result: CalibrateResult) -> Iterator[tuple[Any, ...]]:
    """Yield what is measured of the pair by each method, its errors, and the noise to compare with."""
    for method in METHODS:
        if (own := result.pair.get(method)) is not None:
            yield METHOD_WORDS[method], own.cooperative_mm, cooperative_noise_mm(result)
            if own.cooperative_mrad is not None:
                yield f"{METHOD_WORDS[method]}, {_ROTATION}", own.cooperative_mrad, cooperative_noise_mrad(result)


# -- Tables of an earlier calibration used as prior: how far it was believed, and what has changed since --------------


def prior_tables(result: CalibrateResult) -> list[Table]:
    """Show parts and changes of every arm that was calibrated with a prior; none without one."""
    priors = ((name, arm.prior) for name, arm in result.arms.items() if arm.prior is not None)
    return with_rows(
        *(table for name, prior in priors for table in (_part_table(name, prior), _change_table(name, prior)))
    )


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
    rows = (
        (part, one.parameters, *_drift(one), "yes" if one.used else "no: the readings contradict it")
        for part, one in prior.parts.items()
    )
    columns = "part", ("values", "d"), ("may have drifted", ".3g"), "unit", "believed"
    return table_of_cells(f"Arm {name}: earlier calibration of {prior.since}", rows, *columns)


def _drift(one: PartDrift) -> tuple[Cell, Cell]:
    if one.drift is None:
        return None, ""
    if one.unit == "m, rad":
        return one.drift * 1e6, "µm, µrad"
    return one.drift * 100.0, f"% {one.unit}"


def _change_table(name: str, prior: ArmPriorResult) -> Table:
    def scaled(one: Any, key: str) -> float | None:
        value: float | None = getattr(one, key)
        return None if value is None else value * (display_unit(one.unit)[0] if one.unit else 1.0)

    return table_of(
        f"Arm {name}: changed since {prior.since}",
        prior.changes,
        ("what", "what"),
        ("change", lambda one: scaled(one, "value"), "+.3f"),
        ("standard error", lambda one: scaled(one, "standard_error"), ".3f"),
        ("unit", lambda one: display_unit(one.unit)[1] if one.unit else ""),
        ("sigmas", "sigmas", ".1f"),
        ("evidence", "evidence", ".0f"),
        ("at the SMR", "moved_mm", ".3f", "mm"),
        ("as likely", lambda one: ", ".join(one.rivals)),
    )


# -- Results of recordings of motion for people: clocks, weight of the points, lost motion, what is not determined ----


_SURE = 2.0
"""Lost motion is shown as found from this many standard errors on."""


def motion_tables(result: CalibrateResult) -> list[Table]:
    """Show clocks, recordings and lost motion of all recorded arms; none without recordings."""
    moved = {name: arm.motion for name, arm in result.arms.items() if arm.motion is not None}
    named = (("arm", itemgetter(0)), ("recording", itemgetter(1)))
    clocks = table_of(
        "Clocks: the tracker's against the controller's",
        [(name, recording, its) for name in moved for recording, its in (result.arms[name].clocks or {}).items()],
        *named,
        ("offset [s]", lambda row: row[2].offset_s, ".6f"),
        ("standard error [ms]", lambda row: row[2].offset_standard_error_s * 1e3, ".4f"),
        ("rate [ppm]", lambda row: row[2].rate_ppm, ".3f"),
        ("standard error [ppm]", lambda row: row[2].rate_standard_error_ppm, ".3f"),
        ("clock steps", lambda row: len(row[2].steps_of_joints) + len(row[2].steps_of_points), "d"),
    )
    recordings = table_of(
        "Recordings: what their points are worth as independent ones",
        [(name, recording, its) for name, motion in moved.items() for recording, its in motion.recordings.items()],
        *named,
        ("points", lambda row: row[2].points, "d"),
        ("learnt", lambda row: row[2].learnt, "d"),
        ("worth", lambda row: row[2].effective_points, ".0f"),
        ("held out", lambda row: row[2].held_out, "d"),
        ("gross", lambda row: row[2].gross, "d"),
        ("in gaps", lambda row: row[2].in_gaps, "d"),
        ("scatter [mm]", lambda row: row[2].scatter_mm, ".4f"),
        ("held-out rms [mm]", lambda row: row[2].heldout_rms_mm, ".4f"),
    )
    of_blocks = {name: its.validate_ for name, its in moved.items() if result.arms[name].validate_ != its.validate_}
    in_motion = table_of(
        "In motion: errors of held-out blocks of time [mm]",
        [(name, errors.position_mm, stage) for name, its in of_blocks.items() for stage, errors in its.items()],
        ("arm", itemgetter(0)),
        ("stage", itemgetter(2)),
        *(_STATISTICS[name] for name in _SHORT),
    )
    plays = ((name, joint, its) for name, motion in moved.items() for joint, its in motion.half_play.items())
    lost = table_of(
        "Lost motion",
        [row for row in plays if row[2].value > _SURE * (row[2].standard_error or 0.0)],
        ("arm", itemgetter(0)),
        ("joint", itemgetter(1)),
        ("half play [urad]", lambda row: row[2].value * 1e6, ".1f"),
        ("standard error [urad]", lambda row: (row[2].standard_error or 0.0) * 1e6, ".1f"),
    )
    return with_rows(clocks, recordings, in_motion, lost)


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
