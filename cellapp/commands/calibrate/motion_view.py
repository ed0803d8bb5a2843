"""Results of recordings of motion for people: clocks, weight of the points, lost motion, what is not determined."""

from __future__ import annotations

from cellapp.commands.view.table import Cell, Column, Table, number_column
from cellapp.estimation.calibration.records import ArmCalibrationResult, CalibrateResult, ClockResult, TriggerResult

_CLOCKS = (
    Column("arm"),
    Column("recording"),
    number_column("offset [s]", ".6f"),
    number_column("standard error [ms]", ".4f"),
    number_column("rate [ppm]", ".3f"),
    number_column("standard error [ppm]", ".3f"),
    number_column("clock steps", "d"),
)
_RECORDINGS = (
    Column("arm"),
    Column("recording"),
    number_column("points", "d"),
    number_column("learnt", "d"),
    number_column("worth", ".0f"),
    number_column("held out", "d"),
    number_column("gross", "d"),
    number_column("in gaps", "d"),
    number_column("scatter [mm]", ".4f"),
    number_column("held-out rms [mm]", ".4f"),
)
_PLAY = (
    Column("arm"),
    Column("joint"),
    number_column("half play [urad]", ".1f"),
    number_column("standard error [urad]", ".1f"),
)
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
            if clock.trigger is not None:
                said.append(f"arm {name}: recording '{recording}': {_trigger(clock.trigger)}")
        if arm.motion is not None:
            said += [f"arm {name}: not determined: {sentence}" for sentence in arm.motion.undetermined]
    return said


def _clock(clock: ClockResult) -> tuple[Cell, ...]:
    steps = len(clock.steps_of_joints) + len(clock.steps_of_points)
    errors = clock.offset_standard_error_s * 1e3, clock.rate_standard_error_ppm
    return clock.offset_s, errors[0], clock.rate_ppm, errors[1], steps


def _trigger(found: TriggerResult) -> str:
    text = (
        f"by {found.pulses} pulses of the trigger the offset is {found.offset_s:.6f} s with a standard error of"
        f" {found.standard_error_s * 1e3:.2f} ms; that of the motion is {found.difference_s * 1e3:+.2f} ms from it"
    )
    return text if found.agrees else f"{text}: they do not agree; look at the wiring and at driver.trigger_output"


def _in_motion(moved: dict[str, ArmCalibrationResult]) -> list[Table]:
    """Show errors of held-out blocks of motion, for arms whose held-out errors are those of stops."""
    rows: list[tuple[Cell, ...]] = []
    for name, arm in moved.items():
        if arm.motion is not None and arm.validate_ != arm.motion.validate_:
            for stage, errors in arm.motion.validate_.items():
                its = errors.position_mm
                rows.append((name, stage, its.mean, its.rms, its.std, its.max, its.n))
    columns = (
        Column("arm"),
        Column("stage"),
        *(number_column(title, ".4f") for title in ("mean", "rms", "std", "max")),
        number_column("n", "d"),
    )
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
