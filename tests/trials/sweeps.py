"""Sweeps against stops: the same simulated cells calibrated from both, judged by targets that are measured afterwards.

    python -m tests.trials.sweeps --seeds 10

Each seed is another cell: true geometry, and an effect of each arm, drawn by a law of another shape than the library's
(``other``), by the library's (``same``), or those of ``profiles/twin.yaml`` (``twin``). Everything is the product's
own: plan, collect, calibrate, discover, compensate, measure.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal

import numpy as np
import typer

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.targets.targets import Target
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.collect.run import collect_stops
from cellapp.commands.discover.run import discover_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.push.run import push_run
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of
from cellapp.commands.trials.blind import with_hidden
from cellapp.commands.trials.target_draws import draw_targets
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE
from cellapp.robot.model import CellModel
from drivers.plant import suggest, suggest_other_law
from tests.twin import whole_twin

app = typer.Typer(add_completion=False)
SHOWN_BY_BOTH = ("joint_compliance", "backlash", "friction_windup", "encoder_eccentricity", "transmission_error")
_EFFECT_SEED = 0x53EE
Laws = Literal["other", "same", "twin"]


@dataclass(frozen=True)
class Reached:
    """Of one arm: rms error at its targets [mm], and the effects that were named."""

    rms_mm: float
    names: tuple[str, ...]


def hidden_effects(seed: int, laws: Laws) -> dict[str, dict[str, Any]]:
    """An effect of each arm."""
    profile = whole_twin()
    assert profile.plant is not None
    if laws == "twin":
        return {name: dict(its) for name, its in profile.plant.effects.items()}
    draw, found = suggest_other_law if laws == "other" else suggest, {}
    for place, config in enumerate(build_plant(profile).config.arms):
        rng = np.random.default_rng([seed, _EFFECT_SEED, place])
        slug = SHOWN_BY_BOTH[(seed + 2 * place) % len(SHOWN_BY_BOTH)]
        found[config.name] = {slug: draw(slug, rng, config)}
    return found


class _Targets:
    """Targets that are drawn once, by the first model that asks for them."""

    def __init__(self, profile: Profile, count: int, seed: int) -> None:
        self._profile, self._count, self._seed = profile, count, seed
        self._drawn: list[Target] = []

    def of(self, model: CellModel) -> Sequence[Target]:
        """The targets."""
        self._drawn = self._drawn or draw_targets(self._profile, model, self._count, self._seed)
        return self._drawn


def reached(profile: Profile, sweeps: int | None, targets: _Targets) -> dict[str, Reached]:
    """Calibrate the cell of ``profile`` and measure ``targets``."""
    with TemporaryDirectory() as folder, new_planned_run(profile, Path(folder) / "run", sweeps=sweeps) as run:
        collect_stops(run)
        calibrate_run(run)
        found = discover_run(run)
        wanted = targets.of(model_of(run, read_stages(run).current[CALIBRATE]))
        measured = push_run(run, wanted, verify=True).targets
    errors = {name: [one.compensated_mm for one in measured if one.arm == name] for name in profile.arms}
    return {
        name: Reached(
            float(np.sqrt(np.mean(np.array([mm for mm in errors[name] if mm is not None]) ** 2))),
            tuple(sorted(one.effect for one in found.arms[name].accepted)),
        )
        for name in profile.arms
    }


@app.command()
def main(
    seeds: Annotated[int, typer.Option(min=1)] = 10,
    first: Annotated[int, typer.Option(min=0)] = 1,
    laws: Annotated[Laws, typer.Option(help="of the hidden effects")] = "other",
    stops: Annotated[int, typer.Option(min=20)] = 400,
    sweeps: Annotated[int, typer.Option(min=1, help="stops with a sweep of each arm")] = 20,
    targets: Annotated[int, typer.Option(min=1)] = 60,
) -> None:
    """Try cells one after the other and print each."""
    for seed in range(first, first + seeds):
        hidden = hidden_effects(seed, laws)
        profile = with_hidden(whole_twin(), hidden, seed)
        plan = profile.plan.model_copy(update={"stops": stops})
        began = time.process_time()
        wanted = _Targets(profile, targets, seed)
        by_stops = reached(profile.model_copy(update={"plan": plan}), None, wanted)
        middle = time.process_time()
        by_sweeps = reached(profile, sweeps, wanted)
        seconds = f"{middle - began:.0f} + {time.process_time() - middle:.0f} s"
        for name, stop in by_stops.items():
            sweep = by_sweeps[name]
            typer.echo(
                f"{seed:3d} {name:6s} hidden {'+'.join(hidden[name]):22s} stops {stop.rms_mm:.4f}"
                f" {'+'.join(stop.names):30s} sweeps {sweep.rms_mm:.4f} {'+'.join(sweep.names):30s}"
                f" ratio {sweep.rms_mm / stop.rms_mm:.3f}  {seconds}"
            )


if __name__ == "__main__":
    app()
