"""Fitted at some loads, predicted at another: errors of simulated UR10s, and the share within the stated bounds.

    python -m tests.trials.loads --stops 100 --seeds 10 --first 1

Every arm has an eccentric encoder and elastic joints whose stiffness is drawn: as that of strain-wave drives of this
size, in proportion to the torque; or softer under small torques; or in proportion, with masses that are 15 % off. It is
calibrated and searched from readings with the first load alone, or with as many of which half have the second one.
Errors are those of predictions with a third load at 300 other configurations against the truth; a coordinate is within
its bound if it is off by at most 1.96 of its standard uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.targets.prediction import spread_of
from cellapp.cell.targets.ranges import ConditionRanges
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.robot.effects import MeasurementConditions
from tests.trials.kinds import EFFECTS, Array, Bench, fitted, rows, run_of

app = typer.Typer(add_completion=False)

LOADS_KG = (0.3, 5.0)
OTHER_KG = 10.0
CENTER_F = (0.0, 0.0, 0.06)
LAWS = ("straight", "stiffening", "masses")
STIFFNESS = np.array([[4e4, 4e4, 2e4, 1e4, 1e4, 1e4], [1e5, 1e5, 6e4, 4e4, 4e4, 4e4]])
"""Least and largest stiffness of each joint [Nm/rad]."""
KNEE_NM = (40.0, 40.0, 20.0, 5.0, 5.0, 5.0)
_OTHER = 300
_WITHIN = 1.96


@dataclass(frozen=True)
class Found:
    """Rms error and rms standard uncertainty of a coordinate [mm], share of coordinates within their bounds."""

    rms_mm: float
    stated_mm: float
    within: float


def arm(bench: Bench, law: str) -> Profile:
    """The cell of an arm with a law of elasticity of its own."""
    profile = bench.profile()
    assert profile.plant is not None
    low, high = np.log(STIFFNESS)
    stiff = np.exp(np.random.default_rng([bench.seed, 55]).uniform(low, high))
    joints: dict[str, Any] = {"stiffness": stiff.tolist()}
    if law == "stiffening":
        joints |= {"law": law, "soft_stiffness": (0.6 * stiff).tolist(), "knee": list(KNEE_NM)}
    errors = profile.plant.geometry.model_copy(update={"mass": 0.15 if law == "masses" else 0.0})
    hidden = {"left": {**EFFECTS, "joint_compliance": joints}}
    plant = profile.plant.model_copy(update={"effects": hidden, "geometry": errors})
    return profile.model_copy(update={"plant": plant})


def measured(bench: Bench, profile: Profile, loads_kg: Sequence[float]) -> Readings:
    """Readings at the bench's configurations, as many with each load."""
    plant, q = build_plant(profile), bench.q(bench.stops, 1)
    rng, at_rest = np.random.default_rng([bench.seed, 2]), np.zeros_like(q)
    load_kg = np.resize(np.array(loads_kg), len(q))
    center_F = np.tile(CENTER_F, (len(q), 1))
    exact = plant.smr_positions("left", q, approach=at_rest, payload=load_kg, payload_center=center_F)
    points, covariance = plant.measure_positions(exact, rng)
    return rows(q, p_M=points, covariance_M=covariance, payload_kg=load_kg, payload_center_F=center_F)


def predicted(bench: Bench, law: str, loads_kg: Sequence[float]) -> Found:
    """What the model of readings with some loads is worth under the other one."""
    profile, q = arm(bench, law), bench.q(_OTHER, 9)
    load_kg, center_F, at_rest = np.full(len(q), OTHER_KG), np.tile(CENTER_F, (len(q), 1)), np.zeros_like(q)
    true_M = build_plant(profile).smr_positions("left", q, approach=at_rest, payload=load_kg, payload_center=center_F)
    with run_of(profile, measured(bench, profile, loads_kg)) as run:
        model = fitted(run, discover=True).arms["left"]
        ranges = ConditionRanges.of(run.readings("left"), model)
    conditions = MeasurementConditions(approach=at_rest, payload_kg=load_kg, payload_center_F=center_F)
    off_mm = 1e3 * (model.predict(q, conditions=conditions) - true_M)
    covariance = spread_of(model, q, conditions, ranges).of_model
    stated_mm = 1e3 * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return Found(_rms(off_mm), _rms(stated_mm), float(np.mean(np.abs(off_mm) <= _WITHIN * stated_mm)))


def lines(found: Mapping[str, Sequence[Found]]) -> Iterator[str]:
    """The table, a line for each case: medians over the arms, and the share over all of them."""
    yield f"law, fitted with | off at {OTHER_KG:g} kg [mm] | stated [mm] | within 95 % bounds | least of an arm | arms"
    for case, its in found.items():
        within = [one.within for one in its]
        yield (
            f"{case} | {np.median([one.rms_mm for one in its]):.3f} | {np.median([one.stated_mm for one in its]):.3f}"
            f" | {np.mean(within):.3f} | {min(within):.3f} | {len(its)}"
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@app.command()
def main(
    stops: Annotated[int, typer.Option(min=40)] = 100, seeds: Annotated[int, typer.Option(min=1)] = 10, first: int = 1
) -> None:
    """Print the table."""
    found: dict[str, list[Found]] = {}
    for seed in range(first, first + seeds):
        for law in LAWS:
            for loads_kg in (LOADS_KG[:1], LOADS_KG):
                case = f"{law}, {' and '.join(f'{kg:g}' for kg in loads_kg)} kg"
                one = predicted(Bench(seed, stops), law, loads_kg)
                found.setdefault(case, []).append(one)
                typer.echo(f"seed {seed}: {case}: {one}", err=True)
    typer.echo("\n".join(lines(found)))


if __name__ == "__main__":
    app()
