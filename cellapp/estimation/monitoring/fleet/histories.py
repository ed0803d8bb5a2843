"""The histories of all arms of a fleet, from the records of its runs: what has changed, what drifts, how sure that is.

Many parameters of many runs are tested. All differences from the first runs share one half of the false alarm rate by
Bonferroni's inequality, which holds however they depend on each other; all trends share the other half.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from cellapp.estimation.monitoring.fleet.condition import condition_of
from cellapp.estimation.monitoring.fleet.effects import UNKNOWN, EffectComparison, compare_effects, is_of_arm
from cellapp.estimation.monitoring.fleet.parameters import (
    Comparison,
    Determined,
    compare,
    compared_parameters,
    is_angle,
    is_installation,
)
from cellapp.estimation.monitoring.fleet.record import ArmRecord, RunRecord
from cellapp.estimation.monitoring.fleet.records import (
    ARM_CONDITIONS,
    ArmHistory,
    Change,
    CheckPoint,
    DatedValue,
    EffectHistory,
    EffectSize,
    Figure,
    FleetResult,
    FleetRun,
    IsoPoint,
    PairHistory,
    ParameterHistory,
)
from cellapp.estimation.monitoring.fleet.trends import ArmTrends, draft_trends, trend_results
from cellapp.ground.results import BEST_METHODS, Estimate

FALSE_ALARM = 0.01
"""Largest chance that anything at all is said to have changed or to drift in a fleet where nothing has."""


@dataclass(frozen=True)
class _Measured:
    """One arm in one run."""

    run: RunRecord
    name: str
    arm: ArmRecord


@dataclass(frozen=True)
class _Parameter:
    """A parameter of one arm or pair before its chances are corrected."""

    name: str
    unit: str
    tested: bool
    lever: float | None
    first: DatedValue
    rows: tuple[tuple[RunRecord, Comparison], ...]

    @property
    def tests(self) -> int:
        return sum(row.p_value is not None for _, row in self.rows)

    def history(self, level: _Level) -> ParameterHistory:
        return ParameterHistory(
            name=self.name,
            unit=self.unit,
            part="arm" if self.tested else "installation",
            moved_mm_per_unit=None if self.lever is None else 1e3 * self.lever,
            first=self.first,
            changes=tuple(_change(run, row, level) for run, row in self.rows),
        )


@dataclass(frozen=True)
class _Level:
    """Corrects a chance for the number of tests that share a false alarm rate."""

    tests: int
    rate: float = FALSE_ALARM / 2.0

    def corrected(self, p_value: float | None) -> float | None:
        return None if p_value is None else min(1.0, p_value * max(1, self.tests))

    def proves(self, p_value: float | None) -> bool:
        corrected = self.corrected(p_value)
        return corrected is not None and corrected <= self.rate


@dataclass(frozen=True)
class _Draft:
    """Everything of one arm before its chances are corrected."""

    measured: tuple[_Measured, ...]
    compared: tuple[str, ...]
    parameters: tuple[_Parameter, ...]
    effects: tuple[EffectComparison, ...]
    trends: ArmTrends

    @property
    def tests(self) -> int:
        return sum(one.tests for one in self.parameters) + sum(one.tests for one in self.effects)


def fleet_result(
    records: Sequence[RunRecord], folders: Sequence[str] = (), *, notes: Sequence[str] = ()
) -> FleetResult:
    """Histories of every arm in the records; the first record that has an arm is what its later ones are compared with.

    Parameters
    ----------
    records : sequence
        In the order in which they are compared, usually of time.
    """
    drafts = {key: _draft(measured) for key, measured in _by_arm(records).items()}
    pairs = _pair_drafts(records)
    changes = _Level(
        sum(draft.tests for draft in drafts.values())
        + sum(one.tests for parameters in pairs.values() for one in parameters)
    )
    trends = _Level(sum(len(draft.trends.lines) for draft in drafts.values()))
    arms = {key: _history(draft, changes, trends) for key, draft in drafts.items()}
    worst_first = sorted(arms, key=lambda key: (ARM_CONDITIONS.index(arms[key].condition), key))
    return FleetResult(
        folders=tuple(folders),
        runs=tuple(map(FleetRun.like, records)),
        arms={key: arms[key] for key in worst_first},
        pairs=tuple(_pair(key, parameters, changes) for key, parameters in pairs.items()),
        false_alarm=FALSE_ALARM,
        comparisons=changes.tests,
        trends_tested=trends.tests,
        notes=(*notes, *_identity_notes(records)),
    )


# -- arms -------------------------------------------------------------------------------------------------------------


def _by_arm(records: Sequence[RunRecord]) -> dict[str, list[_Measured]]:
    """Measured arms by what identifies them; two arms of one run with one serial number stay apart."""
    found: dict[str, list[_Measured]] = {}
    for run in records:
        keys = [arm.key for arm in run.arms.values()]
        for name, arm in run.arms.items():
            key = arm.key if keys.count(arm.key) == 1 else f"{arm.key} ({name})"
            found.setdefault(key, []).append(_Measured(run, name, arm))
    return found


def _draft(measured: Sequence[_Measured]) -> _Draft:
    modelled = [one for one in measured if one.arm.geometry is not None]
    parameters = _parameters(modelled)
    searched = [one for one in measured if one.arm.effects is not None]
    effects = compare_effects(searched[0].arm, searched[-1].arm) if len(searched) > 1 else ()
    return _Draft(
        measured=tuple(measured),
        compared=tuple(one.run.run for one in modelled),
        parameters=parameters,
        effects=effects,
        trends=draft_trends(_figures(measured), _drifts(parameters), _tolerance(measured)),
    )


def _parameters(modelled: Sequence[_Measured]) -> tuple[_Parameter, ...]:
    if not modelled:
        return ()
    compared = compared_parameters([one.arm for one in modelled])
    levers = {} if modelled[0].arm.geometry is None else modelled[0].arm.geometry.levers
    return tuple(
        _Parameter(
            name=name,
            unit="rad" if is_angle(name) else "m",
            tested=not is_installation(name),
            lever=levers.get(name),
            first=_dated(modelled[0].run, first.value, first.standard_error),
            rows=tuple((modelled[place].run, row) for place, row in rows),
        )
        for name, (first, rows) in compared.items()
    )


def _drifts(parameters: Sequence[_Parameter]) -> dict[str, tuple[DatedValue, ...]]:
    """Displacement of the SMR [mm] by every tested parameter over time, from its value in the first run."""
    found = {}
    for one in parameters:
        if one.tested and one.lever and one.rows:
            scale = 1e3 * one.lever
            moved = [(one.first.run, one.first.time, 0.0, one.first.standard_error or 0.0)]
            moved += [
                (run.run, run.began, row.difference, math.hypot(row.standard_error, row.growth))
                for run, row in one.rows
                if row.p_value is not None
            ]
            found[one.name] = tuple(
                DatedValue(run=run, time=time, value=scale * value, standard_error=scale * error)
                for run, time, value, error in moved
            )
    return found


def _figures(measured: Sequence[_Measured]) -> dict[Figure, tuple[DatedValue, ...]]:
    """Every figure over all runs, by time."""
    found: dict[Figure, list[DatedValue]] = {}
    for one in measured:
        for figure, values in one.arm.figures.items():
            found.setdefault(figure, []).extend(values)
    return {figure: tuple(sorted(values, key=lambda value: value.time)) for figure, values in found.items()}


def _tolerance(measured: Sequence[_Measured]) -> float | None:
    given = [one.run.tolerance_mm for one in measured if one.run.tolerance_mm is not None]
    return given[-1] if given else None


def _history(draft: _Draft, changes: _Level, trends: _Level) -> ArmHistory:
    newest = draft.measured[-1]
    checks: list[CheckPoint] = [point for one in draft.measured for point in one.arm.checks]
    tests: list[IsoPoint] = [point for one in draft.measured for point in one.arm.iso9283]
    history = ArmHistory(
        type=newest.arm.type,
        runs=tuple(one.run.run for one in draft.measured),
        known_by=newest.arm.known_by,
        serial=newest.arm.serial,
        names=tuple(dict.fromkeys(f"{one.run.profile}, {one.name}" for one in draft.measured)),
        compared=draft.compared,
        tolerance_mm=_tolerance(draft.measured),
        parameters=tuple(one.history(changes) for one in draft.parameters),
        effects=tuple(_effect(one, draft.measured, changes) for one in draft.effects),
        figures=_figures(draft.measured),
        trends=trend_results(draft.trends, trends.corrected, trends.proves),
        checks=tuple(sorted(checks, key=lambda point: point.time)),
        iso9283=tuple(sorted(tests, key=lambda point: point.time)),
        notes=_type_notes(draft.measured),
    )
    condition, reasons = condition_of(history)
    return history.model_copy(update={"condition": condition, "reasons": reasons})


def _effect(found: EffectComparison, measured: Sequence[_Measured], level: _Level) -> EffectHistory:
    known = found.last or found.first
    assert known is not None
    sizes = tuple(_size(found.effect, one) for one in measured)
    state = found.state
    if state in ("appeared", "vanished", "grew", "shrank") and not level.proves(found.p_value):
        state = "stays" if found.first is not None and found.last is not None else "not judged"
    return EffectHistory.like(
        found,
        title=known.title,
        where=known.where,
        part="arm" if is_of_arm(known) else "installation",
        state=state,
        sizes=sizes,
        first_found=next((size.time for size in sizes if size.found), ""),
        p_value=level.corrected(found.p_value),
    )


def _size(slug: str, one: _Measured) -> EffectSize:
    own = [effect for effect in one.arm.effects or () if effect.effect == slug]
    sizes = [effect.size_mm for effect in own if effect.size_mm is not None]
    return EffectSize(
        run=one.run.run,
        time=one.run.began,
        found=bool(own),
        searched=one.arm.effects is not None,
        size_mm=max(sizes) if sizes else None,
    )


def _change(run: RunRecord, row: Comparison, level: _Level) -> Change:
    p_value, proven = level.corrected(row.p_value), level.proves(row.p_value)
    return Change.like(row, run=run.run, time=run.began, p_value=p_value, proven=proven)


def _dated(run: RunRecord, value: float, standard_error: float | None) -> DatedValue:
    return DatedValue(run=run.run, time=run.began, value=value, standard_error=standard_error)


# -- pairs ------------------------------------------------------------------------------------------------------------


def _pair_drafts(records: Sequence[RunRecord]) -> dict[tuple[str, str], tuple[_Parameter, ...]]:
    by_pair: dict[tuple[str, str], list[RunRecord]] = {}
    for run in records:
        keys = [arm.key for arm in run.arms.values()]
        if run.transforms and len(keys) == 2 and keys[0] != keys[1]:
            by_pair.setdefault((keys[0], keys[1]), []).append(run)
    return {pair: _transform_parameters(runs) for pair, runs in by_pair.items() if len(runs) > 1}


def _transform_parameters(runs: Sequence[RunRecord]) -> tuple[_Parameter, ...]:
    first = runs[0]
    common = [
        (run, method)
        for run in runs[1:]
        if (method := next((one for one in BEST_METHODS if one in run.transforms and one in first.transforms), None))
    ]
    if not common:
        return ()
    best = first.transforms[common[-1][1]]
    return tuple(
        _Parameter(
            name=name,
            unit=value.unit,
            tested=True,
            lever=None,
            first=_dated(first, value.value, value.standard_error),
            rows=tuple(
                (run, _transform_change(run.transforms[method][name], first.transforms[method][name], tested=known))
                for run, method in common
                for known in (not _has_unknown(run) and not _has_unknown(first),)
                if name in run.transforms[method] and name in first.transforms[method]
            ),
        )
        for name, value in best.items()
    )


def _has_unknown(run: RunRecord) -> bool:
    """Whether an arm has an effect that no law describes: what it does elsewhere is not known, nor to the transform."""
    return any(effect.effect == UNKNOWN for arm in run.arms.values() for effect in arm.effects or ())


def _transform_change(value: Estimate, first: Estimate, *, tested: bool) -> Comparison:
    known = tested and value.standard_error is not None and first.standard_error is not None
    return compare(
        Determined(value.value, value.standard_error or 0.0),
        Determined(first.value, first.standard_error or 0.0),
        None,
        angle=value.unit == "rad",
        tested=known,
    )


def _pair(arms: tuple[str, str], parameters: Sequence[_Parameter], level: _Level) -> PairHistory:
    histories = tuple(one.history(level) for one in parameters)
    by_run: dict[str, tuple[str, float]] = {}
    for one in histories:
        if one.unit == "m":
            for change in one.changes:
                _, square = by_run.get(change.run, (change.time, 0.0))
                by_run[change.run] = (change.time, square + change.difference**2)
    return PairHistory(
        arms=arms,
        parameters=histories,
        distances_mm=tuple(DatedValue(run=run, time=time, value=1e3 * s**0.5) for run, (time, s) in by_run.items()),
        moved=any(one.last is not None and one.last.proven for one in histories),
    )


# -- runs and notes ---------------------------------------------------------------------------------------------------


def _type_notes(measured: Sequence[_Measured]) -> tuple[str, ...]:
    types = list(dict.fromkeys(one.arm.type for one in measured))
    if len(types) < 2:
        return ()
    return (f"its runs name the types {', '.join(types)}; check the serial number and the profiles",)


def _identity_notes(records: Sequence[RunRecord]) -> list[str]:
    """Arms of one name in one profile that are different ones, or that may be one but are known differently."""
    keys: dict[str, dict[str, str]] = {}
    for run in records:
        for name, arm in run.arms.items():
            keys.setdefault(f"{run.profile}, {name}", {}).setdefault(arm.key, run.run)
    return [
        f"'{names}' is not one arm in all runs: "
        + "; ".join(f"{key} in {run}" for key, run in found.items())
        + ". Their parameters are not compared"
        for names, found in keys.items()
        if len(found) > 1
    ]
