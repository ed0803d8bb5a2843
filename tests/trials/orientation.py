"""Blind trials of orientation: names, held-out errors and 95 % bounds of arms measured with and without it.

    python -m tests.trials.orientation FILE --seeds 10

The arms are those of ``kinds``: elastic joints and an eccentric encoder 1, geometry drawn by the seed. Errors and
bounds are at 300 configurations that no reading is of, against the truth: components of the rotation within 1.96
standard deviations of the model, and, as a target states it, angles of a further measurement within the 95 % bound.
FILE holds a line for each arm and kind: seeds that stand there are not done again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.prediction import predicted_turns
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.estimation.calibration.calibrate import calibrate_arm, profile_splits
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.kinematics.transforms import Array, rotation_vectors
from cellapp.robot.model import ArmModel
from tests.trials.kinds import EFFECTS, KINDS, PROBE, Bench, Truth

_TWO_SIDED_95 = 1.959964


def found_in(profile: Profile, measured: Readings) -> Discovery:
    """What ``calibrate`` and ``discover`` find of the arm."""
    one = replace(measured, split=profile_splits(profile, {"left": measured})[0]["left"])
    arm, _ = calibrate_arm(profile, "left", one)
    return discover_arm(profile, "left", arm.model, one)


def trial(seed: int, kind: str, stops: int) -> dict[str, Any]:
    """One arm with one kind of readings."""
    bench = Bench(seed, stops)
    profile = bench.profile(**KINDS[kind])
    measured = bench.measured(profile)
    found = found_in(profile, measured)
    names = sorted({one.effect for one in found.result.accepted})
    truth = bench.truth()
    held: dict[str, float] = {}
    if found.model.geometry.probe is not None:
        held = bounds(truth.q, *probe_turns(truth, np.random.default_rng([seed, 31])), found.model)
    return {"seed": seed, "kind": kind, "names": names, **vars(truth.errors(found.model)), **held}


def probe_turns(truth: Truth, rng: np.random.Generator) -> tuple[Array, Array]:
    """True and measured orientations (n, 3, 3) of the probe."""
    noise = Rotation.from_rotvec(PROBE["sigma"] * rng.standard_normal((len(truth.q), 3)))
    return truth.R_M_F, noise.as_matrix() @ truth.R_M_F


def bounds(q: Array, R_M_S: Array, measured: Array, model: ArmModel) -> dict[str, float]:
    """Shares of components of the true ``R_M_S`` (n, 3, 3) and of ``measured`` angles within what is stated."""
    conditions = MeasurementConditions(approach=np.zeros_like(q), R_M_S=R_M_S)
    off = model.predict(q, conditions=conditions)
    sd = model.uncertainty(q, conditions)
    angles = np.linalg.norm(rotation_vectors(model.orientation(q) @ measured.swapaxes(1, 2)), axis=1) * 1e3
    free = np.full((len(q), 3, 3), np.nan)
    stated = predicted_turns(
        model, q, q, MeasurementConditions(), free, [None] * len(q), np.zeros(6), ConditionRanges()
    )
    within = np.array([one.within_mrad for one in stated if one is not None])
    return {
        "true_within": float(np.mean(np.abs(off) <= _TWO_SIDED_95 * sd[:, None])),
        "measured_within": float(np.mean(angles <= within)),
    }


def lines(done: list[dict[str, Any]]) -> Iterator[str]:
    """The table, a line for each kind."""
    yield "kind | arms | exact | false | SMR [mm] | orientation [mrad] | true within 95 % | measured within 95 %"
    for kind in KINDS:
        own = [one for one in done if one["kind"] == kind]
        if not own:
            continue
        exact = sum(set(one["names"]) == set(EFFECTS) for one in own)
        false = sum(bool(set(one["names"]) - set(EFFECTS)) for one in own)
        smr, turned = (np.median([one[key] for one in own]) for key in ("smr_mm", "orientation_mrad"))
        held = [f"{np.mean([one[key] for one in own]):.3f}" if key in own[0] else "" for key in _HELD]
        yield f"{kind} | {len(own)} | {exact} | {false} | {smr:.3f} | {turned:.3f} | {' | '.join(held)}"


_HELD = ("true_within", "measured_within")
app = typer.Typer(add_completion=False)


@app.command()
def main(
    file: Path,
    seeds: Annotated[int, typer.Option(min=1)] = 10,
    first: Annotated[int, typer.Option(min=0)] = 1,
    stops: Annotated[int, typer.Option(min=40)] = 100,
) -> None:
    """Do what is not done yet, and print the table."""
    done = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    with file.open("a", encoding="utf-8") as out:
        for seed in range(first, first + seeds):
            for kind in KINDS:
                if any((one["seed"], one["kind"]) == (seed, kind) for one in done):
                    continue
                done.append(trial(seed, kind, stops))
                out.write(json.dumps(done[-1]) + "\n")
                out.flush()
    typer.echo("\n".join(lines(done)))


if __name__ == "__main__":
    app()
