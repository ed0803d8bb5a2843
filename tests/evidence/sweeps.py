"""Sweeps against stops: the same simulated cells calibrated from both, judged by targets that are measured afterwards.
Each seed is another cell: true geometry, and an effect of each arm, drawn by a law of another shape than the library's.
Everything is the product's own: plan, collect, calibrate, discover, compensate, measure."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

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
from cellapp.ground.profile import Profile
from cellapp.ground.results import CALIBRATE
from cellapp.robot.model import CellModel
from drivers.plant import suggest, suggest_other_law
from tests.evidence.shared.target_draws import draw_targets
from tests.evidence.skeleton import Evidence, Table
from tests.twin import whole_twin

TITLE = "Sweeps against stops"
SHOWN_BY_BOTH = ("joint_compliance", "backlash", "friction_windup", "encoder_eccentricity", "transmission_error")
_EFFECT_SEED = 0x53EE


@dataclass(frozen=True)
class Reached:
    """Of one arm: rms error at its targets [mm], and the effects that were named."""

    rms_mm: float
    names: tuple[str, ...]

    def as_list(self) -> list[Any]:
        return [self.rms_mm, "+".join(self.names)]


def hidden_effects(seed: int, laws: str) -> dict[str, dict[str, Any]]:
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


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=73)
    parser.add_argument("--laws", default="other", choices=("other", "same", "twin"))
    parser.add_argument("--stops", type=int, default=400)
    parser.add_argument("--sweeps", type=int, default=20, help="stops with a sweep of each arm")
    parser.add_argument("--targets", type=int, default=60)


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    shared = {key: getattr(asked, key) for key in ("laws", "stops", "sweeps", "targets")}
    return {f"seed {seed}": {"seed": seed, **shared} for seed in range(asked.first, asked.first + asked.seeds)}


def one(case: dict[str, Any]) -> dict[str, Any]:
    seed, hidden = case["seed"], hidden_effects(case["seed"], case["laws"])
    profile = with_hidden(whole_twin(), hidden, seed)
    plan, wanted = profile.plan.model_copy(update={"stops": case["stops"]}), _Targets(profile, case["targets"], seed)
    by_stops = reached(profile.model_copy(update={"plan": plan}), None, wanted)
    by_sweeps = reached(profile, case["sweeps"], wanted)
    return {
        "arms": [
            [seed, name, "+".join(hidden[name]), *(part for one in (stop, by_sweeps[name]) for part in one.as_list())]
            for name, stop in by_stops.items()
        ]
    }


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    arms = [arm for its in results for arm in its["arms"]]
    rows = [
        [str(seed), name, hidden, f"{stops:.4f} mm", first, f"{sweeps:.4f} mm", second]
        for seed, name, hidden, stops, first, sweeps, second in arms
    ]
    stops, sweeps = np.array([arm[3] for arm in arms]), np.array([arm[5] for arm in arms])
    said = f"Sweeps over stops: median {np.median(sweeps / stops):.2f}, worst {max(sweeps / stops):.2f}."
    columns = ["seed", "arm", "hidden", "rms at targets from stops", "named", "from sweeps", "named"]
    return Evidence({"ratio": f"{np.median(sweeps / stops):.2f}"}, [Table("", columns, rows)], said=[said])
