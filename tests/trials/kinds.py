"""What each kind of reading is worth: errors of one simulated UR10 that is calibrated from each, and of a real one.

    python -m tests.trials.kinds --stops 100 --seeds 3
    python -m tests.trials.kinds --data FOLDER --profile profiles/ur10-6d.yaml

The arm is elastic and encoder 1 is eccentric; errors are those of predictions at 300 other configurations against the
truth. "Further out" is a point 200 mm beyond the SMR on the flange's axis.
Of real arms the folder has readings with orientation, a file for each; held-out ones stand for the truth. Three SMRs on
a real flange were not measured: they are made from the measured poses, each with noise of its own, so that only what
the arm does is real.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, read_readings_csv
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.readings import Readings, joined
from cellapp.estimation.readings.several_smrs import one_pose_a_stop
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Smr
from cellapp.robot.model import ArmModel, CellModel
from tests.twin import small_twin

Array = NDArray[np.float64]
app = typer.Typer(add_completion=False)

EFFECTS: dict[str, Any] = {
    "joint_compliance": {"stiffness": [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]},
    "encoder_eccentricity": {"joints": [1], "eccentricity": [2.0e-6], "radius": [0.025], "phase": [0.3]},
}
OFFSET = (0.045, 0.020, 0.060)
PROBE: dict[str, Any] = {"rpy": (0.0, 0.0, 0.3), "sigma": 4e-5}
KINDS: dict[str, dict[str, Any]] = {"one SMR": {}, "6-D probe": {"probe": PROBE}}
"""What the tracker measures, and the keys of the SMR for it."""
FURTHER_M = 0.2
PLACES_S = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0))
"""Where three SMRs stand in the probe's frame [m]."""
MADE_NOISE_M = 1.5e-5
"""Of the two SMRs that are made from a measured pose, in each coordinate."""
_RANGE_RAD = 2.2
_TRUE = 300


@dataclass(frozen=True)
class Errors:
    """Mean errors of the SMR and of a point further out [mm], and of the orientation [mrad]; NaN where not known."""

    smr_mm: float
    further_mm: float
    orientation_mrad: float


@dataclass(frozen=True, eq=False)
class Truth:
    """Where SMRs really are, and how flanges are really turned, at joint positions ``q`` (n, N) [rad].

    ``R_M_F`` (n, 3, 3) may be turned by a constant rotation on the right, as by how a probe is mounted.
    """

    q: Array
    p_M: Array
    R_M_F: Array

    def errors(self, arm: ArmModel) -> Errors:
        """Errors of a model."""
        p_M, R_M_F = arm.predict(self.q), arm.flange(self.q)[0]
        found, true = Rotation.from_matrix(R_M_F), Rotation.from_matrix(self.R_M_F)
        mounted = (true.inv() * found).mean()
        turned = found * mounted.inv() * true.inv()
        off_M = p_M - self.p_M
        further_M = off_M + turned.apply(FURTHER_M * R_M_F[:, :, 2]) - FURTHER_M * R_M_F[:, :, 2]
        return Errors(_mean_mm(off_M), _mean_mm(further_M), 1e3 * float(turned.magnitude().mean()))


@dataclass(frozen=True, eq=False)
class Bench:
    """A simulated arm; readings of ``stops`` configurations."""

    seed: int
    stops: int

    def profile(self, **smr: Any) -> Profile:
        """The left arm of the twin alone, with further keys of its SMR."""
        whole = small_twin(plant={"seed": self.seed, "effects": {"left": EFFECTS}})
        arm = whole.arms["left"].model_copy(update={"smr": Smr.model_validate({"offset": OFFSET, **smr})})
        share = self.stops // 4
        sizes = {"identify": 2 * share, "train": share, "validate_": self.stops - 3 * share}
        splits = whole.splits.model_copy(update=sizes)
        return whole.model_copy(update={"arms": {"left": arm}, "splits": splits})

    def q(self, count: int, stream: int) -> Array:
        """Joint positions (count, 6) [rad]."""
        return np.random.default_rng([self.seed, stream]).uniform(-_RANGE_RAD, _RANGE_RAD, (count, 6))

    def truth(self, profile: Profile | None = None) -> Truth:
        """The true arm at configurations that no reading is of; ``profile`` is that of a cell with other errors."""
        probed = self.profile(probe=PROBE)
        if profile is not None:
            probed = probed.model_copy(update={"plant": profile.plant})
        plant, q = build_plant(probed), self.q(_TRUE, 9)
        at_rest = np.zeros_like(q)
        return Truth(
            q,
            plant.smr_positions("left", q, approach=at_rest),
            plant.probe_rotations("left", q, approach=at_rest),
        )

    def measured(self, profile: Profile) -> Readings:
        """What the tracker measures: the SMR, and the orientation of a probe."""
        plant, q, probe = build_plant(profile), self.q(self.stops, 1), profile.arms["left"].smr.probe
        rng, at_rest = np.random.default_rng([self.seed, 2]), np.zeros_like(q)
        points, covariance = plant.measure_positions(plant.smr_positions("left", q, approach=at_rest), rng)
        more: dict[str, Any] = {}
        if probe is not None:
            turns = Rotation.from_matrix(plant.probe_rotations("left", q, approach=at_rest))
            noise = Rotation.from_rotvec(probe.sigma * rng.standard_normal((len(q), 3)))
            more["quaternion_M"] = np.roll((noise * turns).as_quat(), 1, axis=1)
            more["sigma_rad"] = np.full(len(q), probe.sigma)
        return rows(q, p_M=points, covariance_M=covariance, **more)

    def of_three_smrs(self) -> Readings:
        """What an import makes of three SMRs on the flange, which the tracker measures one after another."""
        plant, q = build_plant(self.profile(probe=PROBE)), self.q(self.stops, 1)
        rng, at_rest = np.random.default_rng([self.seed, 2]), np.zeros_like(q)
        p_M, R_M_S = (f("left", q, approach=at_rest) for f in (plant.smr_positions, plant.probe_rotations))
        found = [plant.measure_positions(p_M + R_M_S @ np.array(place), rng) for place in PLACES_S]
        parts = [
            rows(q, p_M=points, covariance_M=covariance, smr=(name,) * len(q))
            for name, (points, covariance) in zip("ABC", found, strict=True)
        ]
        return one_pose_a_stop(joined(parts))[0]


def rows(q: Array, **quantities: Any) -> Readings:
    """Readings at ``q`` (n, N) [rad], one a stop."""
    n = len(q)
    return Readings(
        configuration=np.arange(n), time_s=np.full(n, np.nan), q=q, approach=np.zeros(q.shape, np.int8), **quantities
    )


@contextmanager
def run_of(profile: Profile, measured: Readings) -> Iterator[RunFile]:
    """A run, in a folder of its own, with the readings of the only arm."""
    (name,) = profile.arms
    with tempfile.TemporaryDirectory() as folder, RunFile.create(Path(folder) / "run", profile) as run:
        run.add_readings(name, measured)
        yield run


def calibrated(profile: Profile, measured: Readings, *, discover: bool) -> ArmModel:
    """The model of the arm that ``calibrate``, and ``discover`` if asked, make of readings."""
    (name,) = profile.arms
    with run_of(profile, measured) as run:
        return fitted(run, discover=discover).arms[name]


def fitted(run: RunFile, *, discover: bool) -> CellModel:
    """The model in force of a run that is calibrated, and searched if asked."""
    calibrate_run(run)
    if discover:
        discover_run(run)
    return model_of(run, stage_in_force(run, read_stages(run)))


def simulated(seed: int, stops: int, *, discover: bool) -> Iterator[tuple[str, Errors]]:
    """Each kind with its errors, of one arm."""
    bench = Bench(seed, stops)
    truth = bench.truth()
    for kind, smr in KINDS.items():
        profile = bench.profile(**smr)
        yield kind, truth.errors(calibrated(profile, bench.measured(profile), discover=discover))
    yield "three SMRs", truth.errors(calibrated(bench.profile(), bench.of_three_smrs(), discover=discover))


def real(profile: Profile, measured: Readings, *, discover: bool) -> Iterator[tuple[str, Errors]]:
    """The same of readings with orientation of a real arm: positions alone, and both; a quarter is the truth."""
    assert measured.quaternion_M is not None
    measured = replace(measured, split=None)
    drawn = np.random.default_rng(profile.seed).permutation(len(measured))
    held_out = measured.take(np.sort(drawn[: len(measured) // 4]))
    learn = measured.take(np.sort(drawn[len(measured) // 4 :]))
    assert held_out.quaternion_M is not None
    turns = Rotation.from_quat(np.roll(held_out.quaternion_M, -1, axis=1)).as_matrix()
    truth = Truth(held_out.q, held_out.p_M, turns)
    made, _, _ = one_pose_a_stop(smrs_of_poses(learn, np.random.default_rng([profile.seed, 7])))
    yield (
        "one SMR",
        truth.errors(calibrated(profile, replace(learn, quaternion_M=None, sigma_rad=None), discover=discover)),
    )
    yield "three SMRs, made from poses", truth.errors(calibrated(profile, made, discover=discover))
    yield "6-D probe", truth.errors(calibrated(profile, learn, discover=discover))


def smrs_of_poses(measured: Readings, rng: np.random.Generator) -> Readings:
    """Three SMRs made from measured poses: one where the probe is, two beside it, with noise of their own."""
    assert measured.quaternion_M is not None
    turns = Rotation.from_quat(np.roll(measured.quaternion_M, -1, axis=1))
    plain = replace(measured, quaternion_M=None, sigma_rad=None)
    parts = []
    for name, offset_S in zip("ABC", PLACES_S, strict=True):
        noise = MADE_NOISE_M * rng.standard_normal(measured.p_M.shape) if any(offset_S) else 0.0
        p_M = measured.p_M + turns.apply(offset_S) + noise
        parts.append(replace(plain, p_M=p_M, smr=(name,) * len(p_M)))
    return joined(parts)


def lines(found: Mapping[str, list[Errors]]) -> Iterator[str]:
    """The table, a line for each kind: medians over the arms."""
    yield "kind | SMR [mm] | 200 mm further out [mm] | orientation [mrad] | arms"
    for kind, errors in found.items():
        smr, further, turned = np.median([(e.smr_mm, e.further_mm, e.orientation_mrad) for e in errors], axis=0)
        yield f"{kind} | {smr:.3f} | {further:.3f} | {turned:.3f} | {len(errors)}"


def _mean_mm(vectors: Array) -> float:
    return 1e3 * float(np.linalg.norm(vectors, axis=1).mean())


def of_folder(profile: Profile, folder: Path, *, discover: bool) -> Iterator[tuple[str, Errors]]:
    """Each kind with its errors, of the real arms in a folder."""
    (name,) = profile.arms
    for path in sorted(folder.glob("*.csv")):
        readings, _ = read_readings_csv(path, {name: len(profile.arms[name].type.joints)})
        for kind, errors in real(profile, readings[name], discover=discover):
            yield f"{kind}, {path.stem}", errors


@app.command()
def main(
    stops: Annotated[int, typer.Option(min=40)] = 100,
    seeds: Annotated[int, typer.Option(min=1)] = 3,
    geometry: Annotated[bool, typer.Option("--geometry", help="without effects")] = False,
    data: Annotated[Path | None, typer.Option(help="folder with readings of real arms")] = None,
    profile: Annotated[Path | None, typer.Option(help="profile of the real arm")] = None,
) -> None:
    """Print the table."""
    found: dict[str, list[Errors]] = {}
    each: Iterator[Iterator[tuple[str, Errors]]]
    if data is None or profile is None:
        each = (simulated(seed, stops, discover=not geometry) for seed in range(1, seeds + 1))
    else:
        each = iter([of_folder(load_profile(profile), data, discover=not geometry)])
    for kinds in each:
        for kind, errors in kinds:
            found.setdefault(kind, []).append(errors)
            typer.echo(f"{kind}: {errors}", err=True)
    typer.echo("\n".join(lines(found)))


if __name__ == "__main__":
    app()
