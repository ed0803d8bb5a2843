"""What the sweeps of the twin show of effects that stops hardly show or not at all, and of the clocks.

    python -m tests.trials.sweep_effects --seeds 10
    python -m tests.trials.sweep_effects --seeds 10 --known

The right arm has lines of 40 cycles a turn in joints 1 to 3 and 20 urad of play on each side of every joint; the left
one is elastic, swings on its joints and follows late. Each seed is another cell; 20 stops, a sweep of each arm about
every one. ``--known`` fits the right arm with the laws that are hidden, instead of a search for them: a fifth of the
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import numpy as np
import typer

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.run import RunFile
from cellapp.cell.run.recordings import read_recordings_of
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.collect.run import collect_stops
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.trials.blind import with_hidden
from cellapp.estimation.motion.calibrate import recorded_arm
from cellapp.estimation.motion.discrepancy import allow_for_missing
from cellapp.estimation.motion.effects import effects_in_motion
from cellapp.estimation.motion.fit import solve
from cellapp.estimation.motion.identify import motion_fit, motion_problem
from cellapp.estimation.motion.records import ClockFit, MotionFit
from cellapp.estimation.motion.steps import MotionEffect
from cellapp.estimation.motion.terms import JointTerm, Law, of_all_joints
from cellapp.ground.progress import ignore_words
from drivers.plant import Plant
from drivers.plant.effects.drive_lag import DriveLag
from drivers.plant.mechanism import Mechanism
from drivers.plant.sweep import Recorder, recorder_of
from tests.twin import whole_twin

app = typer.Typer(add_completion=False)
CYCLES, PLAY_RAD = 40, 40e-6
STIFFNESS = [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]


def hidden_effects(seed: int) -> dict[str, dict[str, Any]]:
    """Effects of both arms, with random sizes."""
    rng = np.random.default_rng([seed, 0x40])
    zero = [0.0, 0.0, 0.0]
    lines = {
        "mode": "meshing",
        "joints": [1, 2, 3],
        "ratio": [float(CYCLES)] * 3,
        "line": rng.uniform(20e-6, 50e-6, 3).tolist(),
        "line_phase": rng.uniform(0.0, 6.28, 3).tolist(),
        "depth": zero,
        "depth_phase": zero,
        "second_cycles": [7.0] * 3,
        "second": zero,
        "second_phase": zero,
    }
    return {
        "right": {"transmission_error": lines, "backlash": {"play": [PLAY_RAD] * 6}},
        "left": {
            "joint_compliance": {"stiffness": STIFFNESS},
            "joint_vibration": {"stiffness": STIFFNESS, "damping": float(rng.uniform(0.03, 0.06))},
            "drive_lag": {"time_constant": rng.uniform(0.01, 0.03, 6).tolist()},
        },
    }


def late_s(hidden: Mapping[str, Any], mechanism: Mechanism, effects: Sequence[MotionEffect]) -> float:
    """What the drives of an arm are late in the mean, beyond the time constants that were found [s]: nothing tells it
    from a delay between the clocks."""
    if "drive_lag" not in hidden:
        return 0.0
    effect = DriveLag(np.array(hidden["drive_lag"]["time_constant"]), np.zeros(6))
    time_s = np.arange(0.0, 1.0, 1e-3)
    change = effect.response(time_s, np.tile(time_s[:, None], 6), mechanism)
    assert change is not None
    found = [effect.values for effect in effects if effect.slug == Law.TIME_CONSTANT.value]
    return float(-np.mean(change[-1])) - (float(np.sum(found[0])) / 6 if found else 0.0)


def clock_errors(clock: ClockFit, recorder: Recorder, late_s: float = 0.0) -> tuple[float, float, bool, bool]:
    """Errors of delay [ms] and rate [ppm] of one recording of an arm that is late, and whether their 95 % intervals
    hold the truth."""
    rate = 1e-6 * recorder.rate_ppm
    controller_s = (clock.middle_s - recorder.offset_s) / (1.0 + rate)
    delay, rate_ppm = clock.middle_s - controller_s + late_s, 1e6 * rate / (1.0 + rate)
    low, high = clock.rate_interval_ppm
    first, last = clock.offset_interval_s
    return 1e3 * (clock.offset_s - delay), clock.rate_ppm - rate_ppm, first <= delay <= last, low <= rate_ppm <= high


def lines_against(found: Mapping[str, float], lines: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Relative errors of amplitudes, and errors of phases [rad], of the lines of joints 1 to 3."""
    errors = []
    for joint, amplitude, phase in zip((1, 2, 3), lines["line"], lines["line_phase"], strict=True):
        measured = complex(found.get(f"sin{CYCLES}q{joint}", 0.0), found.get(f"cos{CYCLES}q{joint}", 0.0))
        true = amplitude * np.exp(1j * phase)
        errors.append((abs(measured) / amplitude - 1.0, float(np.angle(measured / true)) if measured else np.nan))
    return errors


def _shown(run: RunFile, seed: int, name: str, hidden: Mapping[str, Any], plant: Plant) -> None:
    arm = recorded_arm(run.profile, name, run.readings(name), read_recordings_of(run, name))
    discovery = effects_in_motion(arm)
    _clocks(seed, name, discovery.fit, plant, late_s(hidden, plant.true_mechanism(name), discovery.effects))
    for effect in discovery.effects:
        found = dict(zip(effect.names, effect.values.tolist(), strict=True))
        if effect.slug == "transmission_error":
            errors = lines_against(found, hidden["transmission_error"])
            text = "; ".join(f"{100 * size:+.1f} %, {phase:+.3f} rad" for size, phase in errors)
            text += f", standard errors {[f'{one:.2g}' for one in effect.standard_errors.tolist()]}"
            text += f" beside {[one for one in found if f'{CYCLES}q' not in one]}"
        else:
            text = ", ".join(f"{key} {value:.4g}" for key, value in found.items())
        typer.echo(f"{seed:3d} {name:5s} {effect.slug:20s} {text}")


def _fitted(run: RunFile, seed: int, plant: Plant) -> None:
    """Clocks and play of the right arm by a fit with all laws that are hidden in it."""
    arm = recorded_arm(run.profile, "right", run.readings("right"), read_recordings_of(run, "right"))
    problem, rows = motion_problem(arm, ignore_words)
    lines = tuple(JointTerm(Law.LINE, joint, CYCLES, sine) for joint in range(3) for sine in (False, True))
    known = problem.without_terms().with_terms((*of_all_joints(Law.PLAY, 6), *lines))
    fit = motion_fit(known, allow_for_missing(known, solve(known, rows)))
    _clocks(seed, "right", fit, plant, 0.0)
    play = ", ".join(f"{1e6 * half:.1f}" for half in fit.half_play.tolist())
    typer.echo(f"{seed:3d} right half play {play} urad")


def _clocks(seed: int, name: str, fit: MotionFit, plant: Plant, late: float) -> None:
    for clock in fit.clocks.values():
        delay, rate, delay_holds, rate_holds = clock_errors(clock, recorder_of(plant), late)
        typer.echo(
            f"{seed:3d} {name:5s} delay {delay:+.4f} +- {1e3 * clock.offset_standard_error_s:.4f} ms {delay_holds},"
            f" rate {rate:+.3f} +- {clock.rate_standard_error_ppm:.3f} ppm {rate_holds}"
        )


@app.command()
def main(
    seeds: Annotated[int, typer.Option(min=1)] = 10,
    first: Annotated[int, typer.Option(min=0)] = 1,
    arm: Annotated[Literal["left", "right"] | None, typer.Option(help="one arm only")] = None,
    sweeps: Annotated[int, typer.Option(min=1, help="stops with a sweep of each arm")] = 20,
    known: Annotated[bool, typer.Option(help="fit the right arm with its hidden laws")] = False,
) -> None:
    """Try cells one after the other and print what each arm shows."""
    for seed in range(first, first + seeds):
        hidden = hidden_effects(seed)
        profile = with_hidden(whole_twin(), hidden, seed)
        plant = build_plant(profile)
        with TemporaryDirectory() as folder, new_planned_run(profile, Path(folder) / "run", sweeps=sweeps) as run:
            collect_stops(run)
            calibrate_run(run)  # draws the splits
            if known:
                _fitted(run, seed, plant)
                continue
            for name in [arm] if arm else profile.arms:
                _shown(run, seed, name, hidden[name], plant)


if __name__ == "__main__":
    app()
