"""Recordings of strangers, imitated: files, from `init` by `import` and `calibrate` to the page, and what was hidden.

    python -m tests.trials.stranger --kind ur5 --seeds 5

``ur5``: a UR5 that goes between a few places of a small volume again and again and rests at each, joints 125 times a
second with the names and blanks of RTDE's recorder, points 100 times a second. ``seven``: an arm of seven joints at
0.18 rad/s at most, joints 125 times a second without speeds, 3 % lost and 7 % two or three times, with stamps of
milliseconds that are up to 4 ms late; a probe with an orientation, 60 or 250 times a second, 2 % lost. Tool and base
are known in neither.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import numpy as np
import typer

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.import_.run import import_new_run
from cellapp.commands.init.own_data import OwnData, write_own_data
from tests.arms import UR5
from tests.estimation.motion.simulated import SEVEN, Arm, Corners, record, sweep, true_arm

app = typer.Typer(add_completion=False)
Kind = Literal["ur5", "seven"]
OFFSET_S = {"ur5": 0.0178, "seven": 1.6e9}
LATE_S = {"ur5": 0.0, "seven": 0.002}
"""How late the stamps of joints are in the mean."""
RATE_PPM = {"ur5": -18.0, "seven": 12.0}


@dataclass(frozen=True)
class Rests:
    """Ways between places, with a rest at each."""

    moving: Corners
    rest_s: float

    def _share(self, t):
        each = self.moving.each_s + self.rest_s
        whole = np.floor(np.asarray(t) / each)
        return whole * self.moving.each_s + np.minimum(np.asarray(t) - whole * each, self.moving.each_s * (1 - 1e-9))

    def at(self, t):
        return self.moving.at(self._share(t))

    def speed(self, t):
        return self.moving.speed(self._share(t))


@dataclass(frozen=True)
class Strangers:
    """Files of a recording, and the delay [s] and rate [ppm] of its clocks."""

    joints: Path
    points: Path
    rows: Path
    offset_s: float
    rate_ppm: float


def write_strangers(folder: Path, kind: Kind, seed: int, seconds: float) -> Strangers:
    """The files of one recording."""
    rng = np.random.default_rng([seed, 0x57A6])
    nominal = UR5 if kind == "ur5" else SEVEN
    n = len(nominal)
    arm = true_arm(rng, nominal, tool=rng.normal(0.0, 0.06, 3), half_play=np.abs(rng.normal(0.0, 30e-6, n)))
    arm = replace(arm, cycles=2.0, amplitude=rng.normal(0.0, 40e-6, 7), phase=rng.uniform(0.0, 6.28, 7))
    write = _write_ur5 if kind == "ur5" else _write_seven
    joints, points = write(folder, rng, arm, seconds)
    rows = dict(zip(("theta_rad", "d_m", "a_m", "alpha_rad"), nominal.T, strict=True))
    delay = OFFSET_S[kind] - LATE_S[kind]
    return Strangers(joints, points, _written(folder / "rows.csv", rows, ","), delay, RATE_PPM[kind])


def _write_ur5(folder: Path, rng: np.random.Generator, arm: Arm, seconds: float) -> tuple[Path, Path]:
    places = rng.uniform(-1.0, 1.0, 6) + rng.uniform(-0.35, 0.35, (8, 6))
    rounds = math.ceil(seconds / (8 * 3.1)) + 6
    motion = Rests(Corners(places[np.append(np.tile(np.arange(8), rounds), 0)], 2.5), 0.6)
    clocks = {"offset": OFFSET_S["ur5"], "rate_ppm": RATE_PPM["ur5"]}
    recording = record(rng, arm, motion, seconds=seconds, start_s=60.0, **clocks)
    samples, seen = recording.joints, recording.points
    columns = {"timestamp": samples.time_s}
    columns |= {f"target_q_{j}": samples.q[:, j] + 1e-4 for j in range(6)}
    columns |= {f"actual_q_{j}": samples.q[:, j] for j in range(6)}
    columns |= {f"actual_qd_{j}": samples.qd[:, j] for j in range(6)}
    table = dict(zip(("time [s]", "X [mm]", "Y [mm]", "Z [mm]"), (seen.time_s, *(1e3 * seen.p_M.T)), strict=True))
    return _written(folder / "ur5_joints.csv", columns, " "), _written(folder / "ur5_points.csv", table, ";")


def _write_seven(folder: Path, rng: np.random.Generator, arm: Arm, seconds: float) -> tuple[Path, Path]:
    motion = sweep(rng, 7, base_hz=0.02, reach=0.5, speed=0.18)
    clocks = {"offset": OFFSET_S["seven"], "rate_ppm": RATE_PPM["seven"]}
    recording = record(
        rng, arm, motion, seconds=seconds, start_s=5.0, point_hz=250.0 if rng.random() < 0.5 else 60.0,
        with_speeds=False, **clocks,
    )  # fmt: skip
    samples, seen = recording.joints, recording.points
    late = np.maximum.accumulate(samples.time_s + rng.uniform(0.0, 2.0 * LATE_S["seven"], len(samples)))
    rows = np.flatnonzero(rng.random(len(samples)) > 0.03)
    rows = rows.repeat(rng.choice([1, 2, 3], len(rows), p=[0.93, 0.05, 0.02]))
    columns = {"time_s": np.round(late[rows], 3)} | {f"q{j + 1}": samples.q[rows, j] for j in range(7)}
    kept = rng.random(len(seen)) > 0.02
    stamps, turned = seen.time_s[kept], np.tile([1.0, 0.0, 0.0, 0.0], (kept.sum(), 1))
    names = ("time_s", "x_m", "y_m", "z_m", "quat_w", "quat_x", "quat_y", "quat_z")
    table = dict(zip(names, np.column_stack([stamps, seen.p_M[kept], turned]).T, strict=True))
    return _written(folder / "seven_joints.csv", columns, ","), _written(folder / "seven_points.csv", table, ",")


def _written(path: Path, columns: dict[str, np.ndarray], separator: str) -> Path:
    rows = [separator.join(map(repr, row)) for row in np.column_stack(list(columns.values())).tolist()]
    path.write_text("\n".join([separator.join(columns), *rows]) + "\n", "utf-8")
    return path


@dataclass(frozen=True)
class Found:
    """Errors of delay [ms] and rate [ppm], whether 95 % intervals hold them, held-out rms [mm] of the nominal and the
    identified arm, and the time it took [s]."""

    delay_ms: float
    rate_ppm: float
    delay_holds: bool
    rate_holds: bool
    nominal_mm: float
    heldout_mm: float
    seconds: float


def one_stranger(kind: Kind, seed: int, seconds: float) -> Found:
    """From the files by ``init``, ``import`` and ``calibrate`` to what they found."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        files, began = write_strangers(folder, kind, seed, seconds), time.monotonic()
        profile = load_profile(write_own_data(OwnData(files.joints, str(files.rows)), folder).profile)
        import_new_run(profile, None, folder / "run", recordings=([files.joints], [files.points]))
        with RunFile.open(folder / "run", write=True) as run:
            result = calibrate_run(run)
        took = time.monotonic() - began
    (arm,) = result.arms.values()
    (clock,) = (arm.clocks or {}).values()
    errors = {stage: its.position_mm.rms for stage, its in arm.validate_.items()}
    rate, delay = files.rate_ppm, files.offset_s
    return Found(
        1e3 * (clock.offset_s - delay),
        clock.rate_ppm - rate,
        clock.offset_interval_s[0] <= delay <= clock.offset_interval_s[1],
        clock.rate_interval_ppm[0] <= rate <= clock.rate_interval_ppm[1],
        errors["nominal"],
        errors["geometry"],
        took,
    )


@app.command()
def main(
    kind: Annotated[Kind, typer.Option()] = "ur5",
    seeds: Annotated[int, typer.Option(min=1)] = 5,
    first: Annotated[int, typer.Option(min=0)] = 1,
    seconds: Annotated[float, typer.Option(min=20.0)] = 300.0,
) -> None:
    """Imitate recordings one after the other and print what is found."""
    for seed in range(first, first + seeds):
        one = one_stranger(kind, seed, seconds)
        typer.echo(
            f"{seed:3d} {kind:5s} delay {one.delay_ms:+.3f} ms {one.delay_holds}, rate {one.rate_ppm:+.2f} ppm"
            f" {one.rate_holds}, held out {one.nominal_mm:.3f} -> {one.heldout_mm:.3f} mm, {one.seconds:.1f} s"
        )


if __name__ == "__main__":
    app()
