"""Two simulated arms tied by sockets that both touched: what the tie is off by, and what it states.

    python -m tests.trials.touched_pair --seeds 8
    python -m tests.trials.touched_pair --seeds 8 --on-flange 40

With ``--on-flange`` no socket is common: the ball of the left arm rests in a socket on the right arm's flange instead.
The true tie of two models is that which lays their positions best onto the true ones, at 300 other postures.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.touching import both_reader
from cellapp.cell.run import RunFile
from cellapp.cell.run.distances import DISTANCES_RESULT, distances_text
from cellapp.cell.run.flange_touches import FLANGE_TOUCHES_RESULT, FlangeTouch, flange_touches_text
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.readings import Distance, Readings
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import apply, invert, register
from cellapp.robot.model import CellModel
from drivers.plant import Plant
from drivers.plant.sockets import touches
from tests.trials.kinds import SEATING_M, Array, rows
from tests.twin import small_twin

app = typer.Typer(add_completion=False)

TOUCHES = 20
OWN_B = np.array([[0.4, 0.3, 0.2], [-0.4, 0.3, 0.4], [0.3, -0.5, 0.3], [0.2, 0.4, 0.6]])
"""Sockets of one arm alone, in its base [m]; the last is held out."""
_OTHER = 300
_APART_M = 0.15


@dataclass(frozen=True, eq=False)
class Tied:
    """Error of x, y, z and their standard errors (3,), mean errors at left-out sockets and of the distance between both
    balls at other postures; all [mm]."""

    off_mm: Array
    stated_mm: Array
    at_sockets_mm: float
    nominal_mm: float
    at_other_postures_mm: float


def common_places(plant: Plant, count: int, rng: np.random.Generator) -> list[Array]:
    """Places (3,) [m] in M between both arms that each reaches in many postures."""
    T_M = {name: plant.true_T_M_B(name) for name in ("left", "right")}
    between, up = T_M["right"][:3, 3] - T_M["left"][:3, 3], T_M["left"][:3, 2]
    across = between / np.linalg.norm(between)
    ahead, found = np.cross(up, across), list[Array]()
    while len(found) < count:
        aside, front, height = rng.uniform([-0.2, -0.45, 0.1], [0.2, 0.45, 0.7])
        place = T_M["left"][:3, 3] + 0.5 * between + aside * across + front * ahead + height * up
        if all(np.linalg.norm(place - other) > _APART_M for other in found) and all(
            len(led_to(plant, name, place, 40, rng)) >= 8 for name in T_M
        ):
            found.append(place)
    return found


def led_to(plant: Plant, name: str, place_M: Array, starts: int, rng: np.random.Generator) -> Array:
    """Postures (n, 6) [rad] in which an arm rests in a socket."""
    return touches(plant, name, place_M, rng.uniform(-2.2, 2.2, (starts, 6)), seating_m=SEATING_M, rng=rng)


def touched(plant: Plant, name: str, common: list[Array], first: int, rng: np.random.Generator) -> Readings:
    """Touches of the common sockets and of the arm's own, with two known distances between these."""
    T_M_B = plant.true_T_M_B(name)
    places = {f"common {k}": place for k, place in enumerate(common)}
    share = 1.0 if name == "left" else 0.8
    places |= {f"{name} {k}": place for k, place in enumerate(apply(T_M_B, share * OWN_B))}
    q = {point: led_to(plant, name, place, 6 * TOUCHES, rng)[:TOUCHES] for point, place in places.items()}
    points = tuple(point for point, its in q.items() for _ in its)
    ends = [(f"{name} 0", f"{name} {k}") for k in (1, 2)]
    known = tuple(Distance(a, b, float(np.linalg.norm(places[a] - places[b])), 2e-5) for a, b in ends)
    all_q = np.concatenate(list(q.values()))
    found = rows(
        all_q,
        p_M=np.full((len(all_q), 3), np.nan),
        point=points,
        split=tuple("validate" if point == f"{name} 3" else "identify" for point in points),
    )
    return replace(found, configuration=first + np.arange(len(all_q)), distances=known)


def carried(profile: Profile, count: int) -> list[FlangeTouch]:
    """Touches of the left arm's ball in a socket that the right arm carries, as ``cellapp touch`` records them."""
    read = both_reader(profile, "left")
    return [FlangeTouch("left", "cup", *read("cup", number)) for number in range(count)]


def tied(seed: int, common: int = 5, on_flange: int = 0) -> Tied:
    """Both arms of the twin, calibrated and tied by their touches."""
    profile = small_twin(plant={"seed": seed, "effects": {}})
    plant, rng = build_plant(profile), np.random.default_rng([seed, 4])
    places = [] if on_flange else common_places(plant, common, rng)
    readings = {name: touched(plant, name, places, 1000 * k, rng) for k, name in enumerate(profile.arms)}
    with tempfile.TemporaryDirectory() as folder, RunFile.create(Path(folder) / "run", profile) as run:
        for name, its in readings.items():
            run.add_readings(name, its)
        run.write_result(DISTANCES_RESULT, distances_text(readings))
        if on_flange:
            run.write_result(FLANGE_TOUCHES_RESULT, flange_touches_text(carried(profile, on_flange)))
        pair = calibrate_run(run).pair
        model = model_of(run, stage_in_force(run, read_stages(run)))
    true_T_R_L, apart_mm = judged(plant, model, rng)
    axes = [pair["method_1"].identified[axis] for axis in "xyz"]
    return Tied(
        off_mm=1e3 * (np.array([axis.value for axis in axes]) - true_T_R_L[:3, 3]),
        stated_mm=1e3 * np.array([axis.standard_error or np.nan for axis in axes]),
        at_sockets_mm=pair["method_1"].cooperative_mm.mean,
        nominal_mm=pair["nominal"].cooperative_mm.mean,
        at_other_postures_mm=apart_mm,
    )


def judged(plant: Plant, model: CellModel, rng: np.random.Generator) -> tuple[Array, float]:
    """The true tie of both models, and the mean error of the distance between both balls with theirs [mm]."""
    true_M, p_B, T_M = [], [], []
    for name, arm in model.arms.items():
        q = rng.uniform(-2.0, 2.0, (_OTHER, 6))
        true_M.append(plant.smr_positions(name, q, approach=np.zeros_like(q)))
        p_B.append(apply(np.asarray(invert(arm.geometry.T_M_B())), arm.predict(q)))
        T_M.append(register(true_M[-1], p_B[-1]))
    assert model.T_R_L is not None
    true = np.linalg.norm(true_M[0] - true_M[1], axis=1)
    found = np.linalg.norm(apply(model.T_R_L, p_B[0]) - p_B[1], axis=1)
    return np.asarray(invert(T_M[1]) @ T_M[0]), 1e3 * float(np.mean(np.abs(found - true)))


def lines(found: list[Tied]) -> Iterator[str]:
    """The table."""
    off, stated = np.array([one.off_mm for one in found]), np.array([one.stated_mm for one in found])
    rms, size = (float(np.sqrt(np.mean(values**2))) for values in (off, stated))
    yield "x, y, z off by [mm rms] | stated [mm rms] | within 1.96 | left-out sockets | nominal | elsewhere [mm]"
    yield (
        f"{rms:.3f} | {size:.3f} | {np.mean(np.abs(off) <= 1.96 * stated):.3f} |"
        f" {np.mean([one.at_sockets_mm for one in found]):.4f} | {np.mean([one.nominal_mm for one in found]):.3f} |"
        f" {np.mean([one.at_other_postures_mm for one in found]):.4f}"
    )


@app.command()
def main(
    seeds: Annotated[int, typer.Option(min=1)] = 8,
    common: Annotated[int, typer.Option(min=3)] = 5,
    on_flange: Annotated[int, typer.Option(min=0)] = 0,
    first: int = 1,
) -> None:
    """Print the table."""
    found = []
    for seed in range(first, first + seeds):
        found.append(tied(seed, common, on_flange))
        typer.echo(f"seed {seed}: {found[-1]}", err=True)
    typer.echo("\n".join(lines(found)))


if __name__ == "__main__":
    app()
