"""How often a check finds a change, names it, and finds one where there is none: simulated cells, calibrated from 400
stops, are checked as they are, with other noise, and with one change: each parameter of the geometry by 0.05 mm or 50
µrad; stiffness, play and eccentricity so that the SMR moves by 0.05 mm; tracker, bases and SMRs by 0.1 to 10 mm. A
change is *visible* if it moves the SMR by at least one standard deviation of a coordinate. *Named*: stated first;
*listed*: that, or stated as inseparable from it. `--real C,D,UR5` checks measured series, `--mix` hides effects on the
arms, with `--anew` the tracker was set up anew."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.monitoring.check import CheckBelief, check_belief, choose_stops
from cellapp.estimation.monitoring.check.belief import LENGTH_M, TRACKER, TURN_RAD
from cellapp.estimation.monitoring.check.linear import StopRows, stop_rows
from cellapp.estimation.monitoring.check.naming import Cause, Design, with_station
from cellapp.estimation.monitoring.check.sequential import design_of, judgement
from cellapp.estimation.prior.belief import is_own
from cellapp.estimation.prior.update import parameter_words
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import parameter_names, parameter_unit
from cellapp.robot.kinematics.transforms import Array, apply
from cellapp.robot.model import CellModel
from drivers.plant import Plant
from tests.evidence.shared.cells import TWIN, calibrated_alone, drawn_cell, measured_by, measured_stops
from tests.evidence.shared.changes import PlantChange, effect_changes, parameter_plant, rigid_changes
from tests.evidence.shared.estimates import decided_prefix
from tests.evidence.shared.series import load_entrant
from tests.evidence.skeleton import Evidence, Limit, Share, Table

TITLE = "Check"
MOST_FALSE, LEAST_FOUND = 0.01, 0.95
"""Limits of the shares of false alarms, and of visible changes of parameters that are detected."""
GROUPS = {
    "unchanged": "nothing",
    "parameter": "a parameter by 0.05 mm or 50 µrad",
    "effect": "stiffness, play or eccentricity",
    "tracker": "tracker",
    "base": "base of an arm",
    "smr": "SMR",
}
_AMONG, _HELD_OUT_EVERY = 4, 4
"""Of a measured series: candidate rows for each stop of a check, and which of the calibration's rows are held out."""
_RIGID_M = (1e-4, 1e-3, 1e-2)
"""Motions of tracker, bases and SMRs [m, rad]."""
_CHANGE_SEED = 0xC4A6
"""Added to the seed of a cell, so that the draw of changes is independent of all other draws."""
_NOISE_SEED = 10_000
"""Factor on the seed of a cell, so that no two checks have the same noise."""
_PLANS, _NEXT_PLAN = 4, 100_000
"""Most plans that are tried, and the step of the seed between them: one seed in some hundred finds no path."""


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=500)
    parser.add_argument("--unchanged", type=int, default=60, help="checks of each cell as it was")
    parser.add_argument("--earlier", type=int, default=400, help="stops of the calibration")
    parser.add_argument("--stops", type=int, default=20, help="stops of a check at most")
    parser.add_argument("--mix", action="store_true")
    parser.add_argument("--anew", action="store_true")
    parser.add_argument("--real", default="", help="measured series instead, as C,D,UR5")


def cases(asked: argparse.Namespace) -> dict[str, dict[str, Any]]:
    shared = {key: getattr(asked, key) for key in ("unchanged", "earlier", "stops", "mix", "anew")}
    return {
        f"{series} seed {seed}".strip(): {"series": series, "seed": seed, **shared}
        for series in asked.real.split(",")
        for seed in range(asked.first, asked.first + asked.seeds)
    }


def one(case: dict[str, Any]) -> dict[str, Any]:
    """Calibrate one cell, or rows of a series, and check it as it is and after each change."""
    if case["series"]:
        return {"checks": _real_checks(case)}
    seed = case["seed"]
    profile = drawn_cell(load_profile(TWIN), seed, mix=case["mix"])
    known = _calibration_readings(profile, case["earlier"], seed)
    model = CellModel(calibrated_alone(profile, known))
    belief = check_belief(profile, model, known, station_free=case["anew"])
    homes = home_positions(profile)
    chosen = choose_stops(belief, {name: its.q for name, its in known.items()}, case["stops"], start=homes)
    q = {name: its.q[chosen.order] for name, its in known.items()}
    trial = _Trial(profile, design_of(belief), q, homes, seed)
    return {"checks": [trial.check(number, change) for number, change in enumerate(trial.changes(case["unchanged"]))]}


def _real_checks(case: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows are drawn: some for the calibration, the others for checks. Correlated errors would appear as a change."""
    entrant = load_entrant(case["series"])
    readings = entrant.readings
    rng = np.random.default_rng([case["seed"], 0xC4EC])
    rows = rng.permutation(len(readings))
    learned = np.sort(rows[: case["earlier"]])
    words = tuple("validate" if k % _HELD_OUT_EVERY == 0 else "identify" for k in range(len(learned)))
    known, others = replace(readings.take(learned), split=words), rows[case["earlier"] :]
    profile = entrant.profile.model_copy(update={"seed": case["seed"]})
    model = calibrate_arm(profile, entrant.arm, known)[0].model
    model = discover_arm(profile, entrant.arm, model, known, conditions=measurement_conditions(known)).model
    belief = check_belief(profile, CellModel({entrant.arm: model}), {entrant.arm: known})
    design, found = design_of(belief), []
    for _ in range(case["unchanged"]):
        some = rng.permutation(others)[: _AMONG * case["stops"]]
        order = choose_stops(belief, {entrant.arm: readings.q[some]}, case["stops"]).order
        stops = stop_rows(belief, {entrant.arm: readings.take(some[order])}, design.directions)
        measured, state = decided_prefix(design, stops)
        alarm = judgement(design, measured, state)[0] not in ("valid", "cannot say")
        found.append({"group": "unchanged", "what": "", "visible": False, "alarm": alarm, "stops": state.stops})
    return found


def _calibration_readings(profile: Profile, stops: int, seed: int) -> dict[str, Readings]:
    """Simulate readings at a plan of the cell's own; try another seed if the planner finds too few stops."""
    for number in range(_PLANS - 1):
        with contextlib.suppress(InputError):
            return measured_stops(profile, stops, seed + _NEXT_PLAN * number)
    return measured_stops(profile, stops, seed + _NEXT_PLAN * (_PLANS - 1))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A calibrated cell whose checks stop at ``q``, arm -> (n, N) [rad]."""

    profile: Profile
    design: Design
    q: Mapping[str, Array]
    homes: Mapping[str, Array]
    seed: int

    @cached_property
    def before(self) -> Array:
        """Positions (m, 3) [m] of all SMRs at the stops before any change, without noise."""
        return self.points(build_plant(self.profile))

    @property
    def belief(self) -> CheckBelief:
        return self.design.belief

    def changes(self, unchanged: int) -> Iterator[PlantChange]:
        """Yield the unchanged cell, several times, then the cell with each change."""
        before = build_plant(self.profile)
        for _ in range(unchanged):
            yield PlantChange("unchanged", "", "", before)
        rng = np.random.default_rng([self.seed, _CHANGE_SEED])
        for arm, its in self.belief.arms.items():
            joints = its.model.geometry.joints
            for column in its.columns:
                name = parameter_names(joints)[column]
                if is_own(column, joints):
                    size = float(rng.choice([-1.0, 1.0])) * (LENGTH_M if parameter_unit(name) == "m" else TURN_RAD)
                    yield PlantChange("parameter", arm, name, parameter_plant(self.profile, arm, name, size))
        yield from effect_changes(self.profile, LENGTH_M, self.points)
        yield from rigid_changes(self.profile, _RIGID_M, rng)

    def points(self, plant: Plant) -> Array:
        """Compute the positions (m, 3) [m] of all SMRs at the stops, arm by arm, without noise."""
        exact = measured_by(plant, self.homes, self.q, 0, noise=False)
        return np.concatenate([its.p_M for its in exact.values()])

    def check(self, number: int, change: PlantChange) -> dict[str, Any]:
        """Check a changed plant once."""
        readings = self._readings(change.plant, number)
        stops = stop_rows(self.belief, readings, self.design.directions)
        some, state = decided_prefix(self.design, stops)
        here, _ = with_station(self.design, some)
        verdict, found, _, _ = judgement(self.design, here, state)
        moved = self.points(change.plant) - self.before
        count = len(stops.measured) / (1 if change.arm in ("", TRACKER) else len(self.q))
        what, visible = self._words(change)
        first = found.causes[0] if found.causes else None
        named = first is not None and (first.alternative.arm, self.design.name_of(first.alternative)) == (
            change.arm,
            what,
        )
        return dict[str, Any](
            group=change.group,
            what=what,
            visible=visible,
            moved_mm=float(np.sqrt(np.sum(moved**2) / count)) * 1e3,
            alarm=verdict not in ("valid", "cannot say"),
            cannot_say=verdict == "cannot say",
            stops=state.stops,
            named=named,
            listed=named or (first is not None and what in first.rivals),
            solved_mm=None if first is None or not named else _solved_mm(self.design, change, first, stops),
        )

    def _readings(self, plant: Plant, number: int) -> dict[str, Readings]:
        return measured_by(plant, self.homes, self.q, _NOISE_SEED * (self.seed + 1) + number)

    def _words(self, change: PlantChange) -> tuple[str, bool]:
        """Return the name of a change in the check, and whether it is visible."""
        if change.group == "unchanged":
            return "", False
        if change.group in ("parameter", "effect"):
            what = words_of(change)
            places = [k for k, one in enumerate(self.design.directions) if (one.arm, one.what) == (change.arm, what)]
            its = what if len(self.q) == 1 else f"{what}, arm {change.arm}"
            return its, bool(np.any(self.design.visible[places]))
        return change.what, change.group != "tracker" or not self.belief.station_free


def words_of(change: PlantChange) -> str:
    """Return the name of a change of a parameter or effect in the check."""
    if change.group == "parameter":
        return parameter_words(change.what)
    slug, joint = change.what.split()
    return f"{EFFECTS[slug].title}, joint {joint}"


def _solved_mm(design: Design, change: PlantChange, cause: Cause, stops: StopRows) -> float | None:
    """Return the largest error [mm] of a solved motion at the points that it moves; None without a motion."""
    if change.motion is None or cause.motion is None:
        return None
    names = list(design.belief.arms)
    p_M = stops.expected if change.arm == TRACKER else stops.expected[stops.arm_of == names.index(change.arm)]
    off = apply(cause.motion, p_M) - apply(change.motion, p_M)
    return float(np.linalg.norm(off, axis=1).max()) * 1e3


def summary(results: list[dict[str, Any]], asked: argparse.Namespace) -> Evidence:
    checks = [one for its in results for one in its["checks"]]
    rows = []
    for group, title in GROUPS.items():
        for visible in (True, False):
            some = [one for one in checks if one["group"] == group and one["visible"] == visible]
            if some:
                rows.append(_row(title if visible or group == "unchanged" else f"{title}, not visible", some))
    false = Share.of(one["alarm"] for one in checks if one["group"] == "unchanged")
    found = Share.of(one["alarm"] for one in checks if one["group"] == "parameter" and one["visible"])
    limits = [Limit("false alarms", false.hits / max(false.n, 1), MOST_FALSE)]
    if found.n:
        limits.append(Limit("visible changes of parameters detected", found.hits / found.n, least=LEAST_FOUND))
    changed = [one["stops"] for one in checks if one["group"] == "parameter" and one["visible"]]
    figures = {"false": f"{false.hits} of {false.n}", "found": f"{found.hits} of {found.n}"}
    figures["stops"] = f"{np.mean(changed):.1f}" if changed else ""
    columns = ["changed", "detected (95 %)", "named", "listed", "cannot say", "mean stops", "largest error of a motion"]
    return Evidence(figures, [Table("", columns, rows)], limits)


def _row(title: str, some: Sequence[dict[str, Any]]) -> list[str]:
    def percent(key: str) -> str:
        return "" if some[0]["group"] == "unchanged" else f"{100 * np.mean([one[key] for one in some]):.0f} %"

    off = max((one["solved_mm"] for one in some if one.get("solved_mm") is not None), default=None)
    return [
        *(title, str(Share.of(one["alarm"] for one in some)), percent("named"), percent("listed")),
        *(str(sum(one.get("cannot_say", False) for one in some)), f"{np.mean([one['stops'] for one in some]):.1f}"),
        "" if off is None else f"{off:.3f} mm",
    ]
