"""Arms whose masses nobody knows: which names elastic joints get from 304 poses of simulated arms with seven joints.

    python -m tests.trials.unknown_masses --seeds 10

Arms are an LBR iiwa 14; a Panda whose bodies are up to twice or half as heavy as stated; and such an iiwa with a tool
of 3 to 8 kg, its centre off the last axis, of which the profile says nothing. Hidden are joints that stiffen with the
load, masses 20 % off, and a scatter of 0.05 to 0.1 mm in each coordinate; nothing else. The profile has no masses,
wrong ones (0.4 to 2 times the true ones), or the true ones. The tracker states no uncertainty.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.profile.loader import arm_type_of_text
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.estimation.readings import Readings
from cellapp.ground.profile import Profile
from cellapp.ground.profile.schema import ArmType, GeometryErrors, Payload, Pose
from cellapp.ground.profile.schema import Plant as PlantSettings
from tests.trials.kinds import rows, run_of
from tests.twin import PROFILES

app = typer.Typer(add_completion=False)

STOPS = 304
SCATTER_M = (5e-5, 1e-4)
ARMS = {"iiwa": "lbr-iiwa14", "panda": "panda", "iiwa with a tool": "lbr-iiwa14"}
STIFFNESS = np.array([6e4, 4e4, 3e4, 2e4, 1e4, 8e3, 8e3])
KNEE_NM = (40.0, 40.0, 25.0, 15.0, 8.0, 4.0, 2.0)
OFFSET = (0.045, 0.02, 0.06)
CASES = ("none", "wrong", "stated")


@dataclass(frozen=True)
class Named:
    """What a search accepted, and the held-out rms errors [mm]."""

    names: tuple[str, ...]
    before_mm: float
    after_mm: float


def arm_profile(seed: int, which: str = "iiwa") -> Profile:
    """The cell of the arm, whose joints hide their elasticity."""
    profile = load_profile(PROFILES / "ur10-real.yaml")
    path = PROFILES / "arms" / f"{ARMS[which]}.yaml"
    arm_type = arm_type_of_text(path.read_text("utf-8"), path)
    rng = np.random.default_rng([seed, 77])
    stiff = rng.uniform(0.6, 1.4, 7) * STIFFNESS
    hidden: dict[str, Any] = {
        "joint_compliance": {
            "law": "stiffening",
            "stiffness": stiff.tolist(),
            "soft_stiffness": (0.5 * stiff).tolist(),
            "knee": list(KNEE_NM),
        }
    }
    smr = profile.arms["left"].smr.model_copy(update={"offset": OFFSET})
    changed: dict[str, Any] = {"type": arm_type, "smr": smr, "base": Pose(position=(0.0, 0.0, 0.8))}
    if which == "iiwa with a tool":
        center = rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.15])
        changed["payload"] = Payload(mass=rng.uniform(3.0, 8.0), center_of_mass=tuple(center.tolist()))
    if which != "iiwa":
        heavier = 2.0 ** rng.uniform(-1.0, 1.0, 7)
        changed["type"] = _heavier(arm_type, heavier)
    arm = profile.arms["left"].model_copy(update=changed)
    plant = PlantSettings(seed=seed, geometry=GeometryErrors(mass=0.2), repeatability=2e-5, effects={"left": hidden})
    tracker = profile.tracker.model_copy(update={"pose": Pose(position=(3.0, 0.0, 1.2))})
    splits = profile.splits.model_copy(update={"identify": 120, "train": 100})
    whole = {"seed": seed, "arms": {"left": arm}, "plant": plant, "tracker": tracker, "splits": splits}
    return profile.model_copy(update=whole)


def measured(profile: Profile, seed: int) -> Readings:
    """Readings at random configurations, without a stated uncertainty."""
    plant, rng = build_plant(profile), np.random.default_rng([seed, 78])
    low, high = 0.8 * np.array(profile.arms["left"].joint_limits).T
    q = rng.uniform(low, high, (STOPS, len(low)))
    p_M = plant.smr_positions("left", q, approach=np.zeros_like(q))
    return rows(q, p_M=p_M + rng.uniform(*SCATTER_M) * rng.standard_normal(p_M.shape))


def with_masses(profile: Profile, factors: NDArray[np.float64]) -> Profile:
    """The profile with the masses of its arm times ``factors`` (N,), and no simulated cell."""
    arm = profile.arms["left"]
    arm = arm.model_copy(update={"type": _heavier(arm.type, factors), "payload": Payload()})
    return profile.model_copy(update={"arms": {"left": arm}, "plant": None})


def _heavier(arm_type: ArmType, factors: NDArray[np.float64]) -> ArmType:
    joints = tuple(
        one.model_copy(update={"mass": one.mass * factor})
        for one, factor in zip(arm_type.joints, factors.tolist(), strict=True)
    )
    return arm_type.model_copy(update={"joints": joints})


def named(seed: int, case: str, which: str = "iiwa") -> Named:
    """What is found of an arm."""
    profile = arm_profile(seed, which)
    wrong = np.random.default_rng([seed, 79]).uniform(0.4, 2.0, 7)
    factors = {"none": np.zeros(7), "wrong": wrong, "stated": np.ones(7)}[case]
    with run_of(with_masses(profile, factors), measured(profile, seed)) as run:
        calibrate_run(run)
        found = discover_run(run).arms["left"]
    names = tuple(f"{one.effect} {one.law.name}".strip() for one in found.accepted)
    return Named(names, found.heldout_mm.before, found.heldout_mm.after)


def lines(found: Mapping[str, Sequence[Named]]) -> Iterator[str]:
    """The table, a line for each case."""
    yield "arm, masses | joint_compliance alone | other or further names | held out before [mm] | after [mm]"
    for case, its in found.items():
        alone = sum(len(one.names) == 1 and one.names[0].startswith("joint_compliance") for one in its)
        others = sorted({name for one in its for name in one.names if not name.startswith("joint_compliance")})
        before, after = (float(np.median([getattr(one, key) for one in its])) for key in ("before_mm", "after_mm"))
        yield f"{case} | {alone} of {len(its)} | {', '.join(others) or 'none'} | {before:.3f} | {after:.3f}"


@app.command()
def main(seeds: Annotated[int, typer.Option(min=1)] = 10, first: int = 1) -> None:
    """Print the table."""
    found: dict[str, list[Named]] = {}
    for seed in range(first, first + seeds):
        for which, case in itertools.product(ARMS, CASES):
            one = named(seed, case, which)
            found.setdefault(f"{which}, {case}", []).append(one)
            typer.echo(f"seed {seed}: {which}, {case}: {one}", err=True)
    typer.echo("\n".join(lines(found)))


if __name__ == "__main__":
    app()
