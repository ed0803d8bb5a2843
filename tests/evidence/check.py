"""How often a check finds a change, and finds one where there is none: simulated cells with three hidden effects on
each arm, whose joints repeat to 20 µrad, are calibrated with a model of the geometry, with a network, or with the
effects that `discover` finds. Then they are checked by the verb as they are, and with one change each, three times as
large as the size that the check states as visible. *Named*: stated first, or as inseparable from that."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import Cell, open_cell, plant_arm
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.estimation.monitoring.records import TRACKER, CheckResult
from cellapp.estimation.prior.update import parameter_words
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import parameter_names
from drivers.plant.random_effects import suggest
from tests.evidence.shared.cells import TWIN
from tests.evidence.shared.changes import Changed, parameter_plant, shifted_plant, worn_plant
from tests.evidence.skeleton import Evidence, Limit, Share, Table
from tests.twin import altered
from tests.verbs import check_run, opened_by

TITLE = "Check"
MODELS = ("geometry", "network", "effects")
LEAST_VALID, LEAST_FOUND, TIMES = 0.95, 0.95, 3.0
"""Limits of the shares of unchanged cells that are valid, and of changes that are found; their size in visible ones."""
HIDDEN = (
    *("joint_axis_wobble", "transmission_error", "joint_coupling", "link_bending", "friction_windup", "elbow_hose"),
    *("joint_compliance", "backlash", "encoder_eccentricity"),
)
"""Effects of which three are hidden on each arm: none depends on the day."""
REPEATABILITY_RAD = 2e-5
"""Of each joint: what is new at every visit, some 0.03 mm at the SMR."""
WORN = {"stiffness": "joint_compliance", "backlash": "backlash", "eccentricity": "encoder_eccentricity"}
PARAMETERS = {"theta": "joint zero", "d": "length", "a": "length", "alpha": "twist", "beta": "twist"}
UNCHANGED, KINDS = "nothing", (*dict.fromkeys(PARAMETERS.values()), *WORN, "tool", "base", TRACKER)
_SHIFTS = 2
"""Random shifts of each SMR, each base, and the tracker that are drawn from."""
FOUND = ("tracker moved", "base moved", "smr moved", "arm changed", "not explained")
OPTIONS = {"seeds": 3, "first": 600, "unchanged": 20, "each": 2, "stops": 100, "models": ",".join(MODELS)}
"""``unchanged``: checks of each cell as it was; ``each``: changes of each kind in each cell; ``stops``: calibrated."""


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    shared = {key: getattr(asked, key) for key in ("unchanged", "each", "stops")}
    return {
        f"{model} seed {seed}": {"model": model, "seed": seed, **shared}
        for seed in range(asked.first, asked.first + asked.seeds)
        for model in asked.models.split(",")
    }


@dataclass(frozen=True)
class Change:
    """A change of the plant: its kind, its name in the check, and the changed plant of a profile."""

    kind: str
    what: str
    made: Changed

    def opened(self, profile: Profile, **options: Any) -> AbstractContextManager[Cell]:
        """Open the changed cell."""
        return open_cell(profile, plant=self.made(profile), **options)


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Calibrate one cell, and check it as it is and after each change."""
    with TemporaryDirectory() as folder, new_planned_run(_cell(case), Path(folder) / "run") as run:
        collect_run(run)
        calibrate_run(run)
        if case["model"] == "effects":
            discover_run(run)
        return {"model": case["model"], "checks": checks_of(run, case)}


def checks_of(run: RunFile, case: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Check a calibrated run."""
    same = [check_run(run) for _ in range(case["unchanged"])]
    checks = [_fact(UNCHANGED, "", its) for its in same]
    rng = np.random.default_rng([case["seed"], 0xC4A6])
    possible = changes(run.profile, same[0].visible, rng)
    for kind in KINDS:
        of_kind = [one for one in possible if one.kind == kind]
        for place in rng.permutation(len(of_kind))[: case["each"]].tolist():
            change = of_kind[place]
            with opened_by(change.opened):
                checks.append(_fact(kind, change.what, check_run(run)))
    return checks


def _cell(case: Mapping[str, Any]) -> Profile:
    """Return the twin with hidden effects, geometry and noise drawn by the seed."""
    twin, stops, seed = load_profile(TWIN), case["stops"], case["seed"]
    rng = np.random.default_rng([seed, 0x41D])
    hidden = {
        name: {
            slug: suggest(slug, rng, plant_arm(name, arm, {})) for slug in rng.choice(HIDDEN, 3, replace=False).tolist()
        }
        for name, arm in twin.arms.items()
    }
    quarter = stops // 4
    train = 2 * quarter if case["model"] == "network" else 1
    splits = {"identify": 3 * quarter - train, "train": train, "validate_": stops - 3 * quarter}
    return altered(
        twin,
        seed=seed,
        plan={"stops": stops},
        plant={"seed": seed, "effects": hidden, "repeatability": REPEATABILITY_RAD},
        splits={**splits, "pair_identify": quarter, "pair_validate": quarter},
        network={"kind": "mlp" if case["model"] == "network" else "none"},
    )


def changes(profile: Profile, visible: Mapping[str, Mapping[str, float]], rng: np.random.Generator) -> list[Change]:
    """List the changes that a check states as visible, three times as large, with random signs and directions."""
    found: list[Change] = []

    def shifts(kind: str, moved: str, what: str, arm: str, words: str) -> Iterator[Change]:
        sizes = [size for one, size in visible.get(arm, {}).items() if one.startswith(words)]
        for _ in range(_SHIFTS if sizes else 0):
            shift = rng.standard_normal(3)
            shift *= TIMES * max(sizes) / np.linalg.norm(shift)
            yield Change(kind, what, partial(shifted_plant, what=moved, shift=shift))

    found += shifts(TRACKER, TRACKER, TRACKER, TRACKER, "tracker along")
    for arm, its in profile.arms.items():
        found += shifts("tool", f"smr {arm}", f"SMR of arm {arm}", arm, "smr t")
        found += shifts("base", f"base {arm}", f"base of arm {arm}", arm, "base x0")
        sizes = {what: TIMES * size for what, size in visible.get(arm, {}).items()}
        joints = len(its.type.joints)
        for name in parameter_names(joints):
            kind, words = PARAMETERS.get(name.rstrip("0123456789"), ""), parameter_words(name)
            if kind and words in sizes:
                size = sizes[words] * float(rng.choice([-1.0, 1.0]))
                made = partial(parameter_plant, arm=arm, name=name, change=size)
                found.append(Change(kind, f"{words}, arm {arm}", made))
        for kind, slug in WORN.items():
            for joint in range(joints):
                words = f"{EFFECTS[slug].title}, joint {joint + 1}"
                if words in sizes:
                    size = sizes[words] * (2.0 if slug == "backlash" else 1.0)  # the plant states the whole play
                    made = partial(worn_plant, arm=arm, effect=slug, joint=joint, size=size)
                    found.append(Change(kind, f"{words}, arm {arm}", made))
    return found


def _fact(kind: str, what: str, found: CheckResult) -> dict[str, Any]:
    named = [name for one in found.changes[:1] for name in (one.what, f"{one.what}, arm {one.arm}", *one.rivals)]
    return {"kind": kind, "what": what, "verdict": found.verdict, "stops": len(found.stops), "named": what in named}


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    checks = [{**one, "model": its["model"]} for its in results for one in its["checks"]]
    rows = [_row(kind, [one for one in checks if one["kind"] == kind]) for kind in (UNCHANGED, *KINDS)]
    same, changed = ([one for one in checks if (one["kind"] == UNCHANGED) is same] for same in (True, False))
    figures = {"valid": str(_right(same)), "found": str(_right(changed))}
    figures |= {"named": str(Share.of(one["named"] for one in changed)), "found_stops": _mean_stops(changed)}
    shares = (("unchanged cells valid", LEAST_VALID, same), ("changes found", LEAST_FOUND, changed))
    limits = [
        Limit(f"{words}, {model}", share.hits / share.n, least=least)
        for words, least, some in shares
        for model in MODELS
        if (share := _right([one for one in some if one["model"] == model])).n
    ]
    return Evidence(figures, [Table("", ["changed", *MODELS, "named", "mean stops"], rows)], limits)


def _row(kind: str, some: Sequence[Mapping[str, Any]]) -> list[str]:
    named = "" if kind == UNCHANGED else str(Share.of(one["named"] for one in some))
    return [
        kind,
        *(str(_right([one for one in some if one["model"] == model])) for model in MODELS),
        named,
        _mean_stops(some),
    ]


def _mean_stops(some: Sequence[Mapping[str, Any]]) -> str:
    return f"{sum(one['stops'] for one in some) / max(len(some), 1):.1f}"


def _right(some: Sequence[Mapping[str, Any]]) -> Share:
    """Share of unchanged cells that are valid, of changed ones that are found changed."""
    return Share.of(one["verdict"] == "valid" if one["kind"] == UNCHANGED else one["verdict"] in FOUND for one in some)
