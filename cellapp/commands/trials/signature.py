"""Gain by an arm's earlier calibration when it is calibrated again, on simulated cells and a real arm.

Simulated: a cell is calibrated from many stops. Then each arm gets another base and SMR mount and is calibrated again,
from few stops with the earlier calibration and from more stops without. Real: series C, then series D of a UR10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellapp.commands.trials.drawn_cell import calibrated_alone, drawn_cell, measured_stops, require_simulated
from cellapp.commands.trials.league.series import (
    Entrant,
    Rows,
    SeriesTexts,
    draw_rows,
    load_entrant,
    parse_entrants,
    series_texts,
)
from cellapp.commands.trials.skeleton import IN_PLACE, Work
from cellapp.commands.trials.target_records import mean_of
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.measurement_conditions import conditions_of_arms, measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.prior.calibrate import prior_result, stated_model, updated_arm
from cellapp.estimation.prior.discovery import SearchWithPriors
from cellapp.estimation.prior.earlier import Earlier, believed
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record, Result
from cellapp.ground.scale.task import Seed, TaskKind, as_given
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.model import ArmModel

_REMOUNT_SEED = 0x2E30
"""Mixed with the seed of a cell, so that the draw of new mounts is independent of all other draws."""
_BASE_M, _BASE_RAD, _SMR_M = 0.03, 0.02, 0.01
"""Standard deviations of a coordinate of the new base and SMR mounts: placed by hand, not by a fixture."""
_EXACT = 1e-6
"""Factor on the covariance of an earlier calibration that is taken as exact."""
_PLAN_SEED = 1000
"""Added to the seed of the second calibration's plan, so that its stops differ."""


_EARLIER, _LATER = "C", "D"
"""Series of one real arm; the earlier one is the prior of the later."""


class SignatureDraw(Record):
    """One arm calibrated again from some stops: mean held-out position errors [mm].

    ``alone_mm`` is what calibration and discovery reach without the earlier calibration, ``calibrated_mm`` calibration
    with it, ``discovered_mm`` discovery after that; ``exact_mm`` is the error where the earlier calibration is taken as
    exact and only base and tool are identified. ``drifts`` is how far each part was not believed, ``changes`` what was
    found to have changed.
    """

    cell: str
    seed: int
    arm: str
    stops: int
    held_out: int
    alone_mm: float
    calibrated_mm: float | None
    discovered_mm: float | None
    exact_mm: float | None = None
    drifts: Mapping[str, float] = {}
    changes: tuple[str, ...] = ()


class SignatureLine(Record):
    """Means over the draws of one cell and number of stops; ``worse`` counts draws that the prior made worse."""

    cell: str
    stops: int
    draws: int
    alone_mm: float
    calibrated_mm: float | None
    discovered_mm: float | None
    exact_mm: float | None = None
    worst_ratio: float | None
    worse: int


class SignatureBar(Record):
    """A bar and what was reached."""

    what: str
    most: float
    reached: float
    met: bool


class SignatureResult(Result, schema="cellapp-trials-signature"):
    """``trials signature``: a line for each cell and number of stops, the bars, and every draw."""

    earlier_stops: Mapping[str, int]
    lines: tuple[SignatureLine, ...]
    bars: tuple[SignatureBar, ...]
    draws: tuple[SignatureDraw, ...]
    failed: tuple[str, ...] = ()
    """Cells or draws that failed, and why."""

    def complaints(self) -> list[str]:
        """Say what failed and bars that are missed, in words."""
        return [
            *self.failed,
            *(f"{bar.what}: {bar.reached:.4g}, at most {bar.most:.4g}" for bar in self.bars if not bar.met),
        ]


class TwinPlan(Record):
    """What all simulated cells share: stops of the first calibration, of the second with and without it, and held-out
    stops; ``mix`` hides other effects than the profile's."""

    profile: Profile
    earlier: int = 400
    few: int = 30
    many: int = 150
    held_out: int = 120
    mix: bool = False


class RealSeries(Record):
    """Series of one arm: names of the earlier and of the later one, and both as text."""

    earlier: str
    later: str
    texts: SeriesTexts


class RealTask(Record):
    """How many rows of the later series are drawn by which seed."""

    rows: Rows
    seed: int


class Draws(Record):
    """The draws of one simulated cell."""

    draws: tuple[SignatureDraw, ...]


def twin_trials(
    plan: TwinPlan,
    seeds: Sequence[int],
    work: Work = IN_PLACE,
) -> SignatureResult:
    """Try simulated cells whose arms were remounted, one for each seed.

    Raises
    ------
    InputError
        If the profile has no plant.
    Cancelled
        On request.
    """
    require_simulated(plan.profile)
    gathered = work.gather(TWINS, "signature", plan, [Seed(seed=seed) for seed in seeds])
    draws = [draw for one in gathered.found for draw in one.draws]
    draws.sort(key=lambda draw: (draw.stops, draw.seed, draw.arm))
    few_draws = [draw for draw in draws if draw.stops == plan.few]
    many_mm = float(np.mean([draw.alone_mm for draw in draws if draw.stops == plan.many]))
    reached = float(np.mean([draw.discovered_mm for draw in few_draws if draw.discovered_mm is not None]))
    what = f"{plan.few} stops with [mm], {plan.many} without: {many_mm:.4f}"
    bar = SignatureBar(what=what, most=many_mm, reached=reached, met=reached <= many_mm)
    return SignatureResult(
        earlier_stops={draws[0].cell: plan.earlier},
        lines=lines_of(draws),
        bars=(bar,),
        draws=tuple(draws),
        failed=gathered.failed,
    )


def twin_draws(plan: TwinPlan, drawn: Seed) -> Draws:
    """Try both arms of one simulated cell, from few and from many stops."""
    seed = drawn.seed
    first = drawn_cell(plan.profile, seed, mix=plan.mix)
    known = measured_stops(first, plan.earlier, seed)
    models = calibrated_alone(first, known)
    again = remounted(first, seed)
    count = plan.many + plan.held_out
    measured = measured_stops(again, count, seed + _PLAN_SEED)
    draws = []
    for name in known:
        belief, readings = believed(first, name, models, known)
        since = Earlier(belief, Path("earlier"), "discover", "", "then", readings, None, (), ())
        for stops in (plan.few, plan.many):
            some = {arm: _first_learn(its, stops, plan.many) for arm, its in measured.items()}
            geometry = {arm: calibrate_arm(again, arm, its)[0].model for arm, its in some.items()}
            conditions = conditions_of_arms(geometry, some)[name]
            earlier = since if stops == plan.few else None
            draws.append(_draw(first.name, seed, again, name, some[name], conditions, geometry[name], earlier))
    return Draws(draws=tuple(draws))


TWINS = TaskKind("cellapp.commands.trials.signature:TWINS", TwinPlan, Seed, Draws, as_given, twin_draws)


def remounted(profile: Profile, seed: int) -> Profile:
    """Return the profile with every base and every SMR mount changed, drawn by ``seed``."""
    generator = np.random.default_rng([seed, _REMOUNT_SEED])
    arms = {}
    for name, arm in profile.arms.items():
        if arm.base is None or arm.smr.offset == "unknown":
            raise InputError(f"arms.{name}: a simulated arm needs 'base' and a known 'smr.offset'")
        position = (np.array(arm.base.position) + generator.normal(0.0, _BASE_M, 3)).tolist()
        rpy = (np.array(arm.base.rpy) + generator.normal(0.0, _BASE_RAD, 3)).tolist()
        offset = (np.array(arm.smr.offset) + generator.normal(0.0, _SMR_M, 3)).tolist()
        base = arm.base.model_copy(update={"position": tuple(position), "rpy": tuple(rpy)})
        smr = arm.smr.model_copy(update={"offset": tuple(offset)})
        arms[name] = arm.model_copy(update={"base": base, "smr": smr})
    return profile.model_copy(update={"arms": arms})


def real_trials(
    rows: Sequence[Rows],
    seeds: Sequence[int],
    work: Work = IN_PLACE,
    *,
    data: Path,
    profiles: Path,
) -> SignatureResult:
    """Calibrate a measured series of an arm with an earlier series of the same arm as prior.

    Raises
    ------
    InputError
        If a series is missing, or has fewer rows than requested.
    """
    series = RealSeries(earlier=_EARLIER, later=_LATER, texts=series_texts([_EARLIER, _LATER], data, profiles))
    tasks = [RealTask(rows=size, seed=seed) for size in rows for seed in seeds]
    gathered = work.gather(REAL, "signature", series, tasks, "{0.rows} rows, seed {0.seed}")
    draws = sorted(gathered.found, key=lambda draw: (draw.stops, draw.seed))
    count = len(load_entrant(_EARLIER, data, profiles).readings)
    lines = lines_of(draws)
    bars = [
        SignatureBar(
            what=f"series {line.cell}, {line.stops} rows: worst ratio",
            most=1.0,
            reached=line.worst_ratio or 1.0,
            met=line.worse == 0,
        )
        for line in lines
    ]
    return SignatureResult(
        earlier_stops={_EARLIER: count}, lines=lines, bars=tuple(bars), draws=tuple(draws), failed=gathered.failed
    )


@dataclass(frozen=True, eq=False)
class RealArm:
    """The later series of an arm, and its calibration from the earlier one."""

    entrant: Entrant
    earlier: Earlier


def calibrated_earlier(series: RealSeries) -> RealArm:
    """Calibrate and search the whole earlier series."""
    entrants = parse_entrants(series.texts)
    before = entrants[series.earlier]
    whole = replace(before.readings, split=("identify",) * (len(before.readings) - 1) + ("validate",))
    models = calibrated_alone(before.profile, {before.arm: whole})
    belief, count = believed(before.profile, before.arm, models, {before.arm: whole})
    known = Earlier(belief, Path(series.earlier), "discover", "", f"series {series.earlier}", count, None, (), ())
    return RealArm(entrants[series.later], known)


def real_draw(arm: RealArm, task: RealTask) -> SignatureDraw:
    """Calibrate one draw of rows with and without the earlier series."""
    entrant = arm.entrant
    readings = draw_rows(entrant, task.rows, task.seed).split(entrant.readings)
    profile = entrant.profile.model_copy(update={"seed": task.seed})
    conditions = measurement_conditions(readings)
    model = calibrate_arm(profile, entrant.arm, readings)[0].model
    return _draw(entrant.name, task.seed, profile, entrant.arm, readings, conditions, model, arm.earlier)


REAL = TaskKind(
    "cellapp.commands.trials.signature:REAL", RealSeries, RealTask, SignatureDraw, calibrated_earlier, real_draw
)


def lines_of(draws: Sequence[SignatureDraw]) -> tuple[SignatureLine, ...]:
    """Average the draws by cell and number of stops."""
    groups = grouped(((draw.cell, draw.stops), draw) for draw in draws)
    return tuple(_line(cell, stops, some) for (cell, stops), some in groups.items())


def _line(cell: str, stops: int, draws: Sequence[SignatureDraw]) -> SignatureLine:
    ratios = [draw.discovered_mm / draw.alone_mm for draw in draws if draw.discovered_mm is not None]
    return SignatureLine(
        cell=cell,
        stops=stops,
        draws=len(draws),
        alone_mm=float(np.mean([draw.alone_mm for draw in draws])),
        calibrated_mm=mean_of(draw.calibrated_mm for draw in draws),
        discovered_mm=mean_of(draw.discovered_mm for draw in draws),
        exact_mm=mean_of(draw.exact_mm for draw in draws),
        worst_ratio=max(ratios, default=None),
        worse=sum(ratio > 1.0 for ratio in ratios),
    )


def _first_learn(readings: Readings, stops: int, learnable: int) -> Readings:
    """Split the readings: the first ``stops`` for learning, those from ``learnable`` on held out."""
    count = len(readings)
    words = ["identify" if k < stops else "validate" if k >= learnable else None for k in range(count)]
    return replace(readings, split=tuple(words))


def _draw(
    cell: str,
    seed: int,
    profile: Profile,
    name: str,
    readings: Readings,
    conditions: MeasurementConditions,
    geometry: ArmModel,
    earlier: Earlier | None,
) -> SignatureDraw:
    """Calibrate one arm without and, if ``earlier`` is given, with its earlier calibration."""
    rows = readings.in_split("validate")
    held_out, its = readings.take(rows), conditions.take(rows)

    def error_mm(model: ArmModel) -> float:
        return float(np.linalg.norm(held_out.p_M - model.predict(held_out.q, conditions=its), axis=1).mean()) * 1e3

    alone = discover_arm(profile, name, geometry, readings, conditions=conditions).model
    draw = SignatureDraw(
        cell=cell,
        seed=seed,
        arm=name,
        stops=len(readings.in_split("identify")),
        held_out=len(rows),
        alone_mm=error_mm(alone),
        calibrated_mm=None,
        discovered_mm=None,
    )
    if earlier is None:
        return draw
    outcome = updated_arm(profile, name, readings, conditions, earlier)
    model = stated_model(outcome.found, profile.seed) if outcome.used else geometry
    found = SearchWithPriors({name: earlier})(profile, name, model, readings, conditions=conditions)
    prior = prior_result(name, earlier, outcome)
    exact = replace(earlier, belief=replace(earlier.belief, covariance=_EXACT * earlier.belief.covariance))
    return draw.model_copy(
        update={
            "calibrated_mm": error_mm(model),
            "discovered_mm": error_mm(found.model),
            "exact_mm": error_mm(updated_arm(profile, name, readings, conditions, exact).found.model),
            "drifts": {part: one.drift for part, one in prior.parts.items() if one.drift is not None},
            "changes": tuple(change.sentence for change in prior.changes),
        }
    )
