"""Blind trials of measured torques: names and errors of arms with and without them.

    python -m tests.trials.quantities --seeds 10

Arms are those of ``kinds``: elastic joints and an eccentric encoder 1, geometry drawn by the seed. Torques: masses are
30 % off what the profile states, points are measured with or without the torques of the drives (0.5 Nm of noise); the
compliance of joint 2 is judged against the true one. Errors are means at 300 configurations that no reading is of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer

from cellapp.cell.driving.cell import build_plant
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from drivers.plant.mechanism import STANDARD_GRAVITY, Posture
from tests.trials.kinds import EFFECTS, Array, Bench, Truth, run_of

app = typer.Typer(add_completion=False)

MASSES, NOISE_NM = 0.3, 0.5


@dataclass(frozen=True)
class Found:
    """Effects that were named, mean error at other configurations and held out [mm], compliance of joint 2 over the
    true one; NaN where it was not found by that name."""

    names: tuple[str, ...]
    off_mm: float
    held_out_mm: float
    compliance: float

    @property
    def exact(self) -> bool:
        """Whether the hidden effects were named, and no other."""
        return set(self.names) == set(EFFECTS)


def held_torques(profile: Profile, q: Array, seed: int) -> Array:
    """Torques (n, N) [Nm] with which the drives of the true arm hold it, with noise."""
    plant = build_plant(profile)
    gravity = plant.true_T_C_B("left")[:3, :3].T @ np.array([0.0, 0.0, -STANDARD_GRAVITY])
    held = -Posture(plant.true_mechanism("left"), q, gravity).torques
    return np.asarray(held + NOISE_NM * np.random.default_rng([seed, 41]).standard_normal(q.shape))


def found_in(profile: Profile, measured: Readings, truth: Truth) -> Found:
    """What ``calibrate`` and ``discover`` make of readings."""
    with run_of(profile, measured) as run:
        calibrate_run(run)
        its = discover_run(run).arms["left"]
        model = model_of(run, stage_in_force(run, read_stages(run))).arms["left"]
    true = 1.0 / EFFECTS["joint_compliance"]["stiffness"][1]
    values = [one.parameters["compliance2"].value for one in its.accepted if "compliance2" in one.parameters]
    return Found(
        names=tuple(sorted({one.effect for one in its.accepted})),
        off_mm=truth.errors(model).smr_mm,
        held_out_mm=its.heldout_mm.after,
        compliance=values[0] / true if values else float("nan"),
    )


def trials(seed: int, stops: int) -> Iterator[tuple[str, Found]]:
    """Each case of one arm."""
    bench = Bench(seed, stops)
    plain = bench.profile()
    assert plain.plant is not None
    off = plain.plant.geometry.model_copy(update={"mass": MASSES})
    profile = plain.model_copy(update={"plant": plain.plant.model_copy(update={"geometry": off})})
    measured, truth = bench.measured(profile), bench.truth(profile=profile)
    yield "points, masses 30 % off", found_in(profile, measured, truth)
    with_torques = replace(measured, tau_nm=held_torques(profile, measured.q, seed))
    yield "points and torques, masses 30 % off", found_in(profile, with_torques, truth)
    truth = bench.truth()
    yield "points", found_in(plain, bench.measured(plain), truth)


def lines(found: Mapping[str, Sequence[Found]]) -> Iterator[str]:
    """The table, a line for each case."""
    yield "readings | arms | exact | with a false name | other configurations [mm] | held out [mm] | compliance 2 off"
    for case, its in found.items():
        false = sum(bool(set(one.names) - set(EFFECTS)) for one in its)
        off, held_out = (np.median([getattr(one, key) for one in its]) for key in ("off_mm", "held_out_mm"))
        known = [abs(one.compliance - 1.0) for one in its if np.isfinite(one.compliance)]
        compliance = f"{np.median(known):.1%}" if known else ""
        exact = sum(one.exact for one in its)
        yield f"{case} | {len(its)} | {exact} | {false} | {off:.3f} | {held_out:.3f} | {compliance}"


@app.command()
def main(
    stops: Annotated[int, typer.Option(min=40)] = 200, seeds: Annotated[int, typer.Option(min=1)] = 10, first: int = 1
) -> None:
    """Print the table."""
    found: dict[str, list[Found]] = {}
    for seed in range(first, first + seeds):
        for case, one in trials(seed, stops):
            found.setdefault(case, []).append(one)
            typer.echo(f"seed {seed}: {case}: {one}", err=True)
    typer.echo("\n".join(lines(found)))


if __name__ == "__main__":
    app()
