"""Rounds of blind trials of planned stops, at sizes that earlier trials suggest, and their joint result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import zip_longest
from pathlib import Path

import numpy as np

from cellapp.cell.planning.plan import make_stops
from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.planning.view import required_plan
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.trials.power.result import (
    POWER_RESULT,
    SHARE,
    ArmPower,
    EffectPower,
    NamedSize,
    NamingTrial,
    PowerResult,
)
from cellapp.commands.trials.power.trial import PlannedCell, TrialCell, naming_trial, trial_cell
from cellapp.estimation.calibration.quantities import conditions_of_arms
from cellapp.estimation.discovery.records import SmallestSize
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.estimation.uncertainty.naming_curve import NamingCurve
from cellapp.ground.executors import TimeLimit, Work, gather
from cellapp.ground.version import __version__
from cellapp.robot.effects import EFFECTS
from drivers.plant import REALISTIC

_FIRST = (0.5, 1.0, 2.0, 4.0)
"""Sizes of the first trials, in rms lengths of the tracker's noise."""
_LOWEST, _HIGHEST = 0.2, 40.0
"""Range of sizes, in the same unit: 0.005 to 1 mm with a common tracker."""
_LIMITS = (0.05, 0.5, 0.95)
_ENOUGH = 8
"""Trials after which an effect that was never named is given up."""
_FOLLOWED = 0.3
"""Share absorbed by geometry from which that is stated as the limit of naming."""


def power_at(where: Path, trials: int, seed: int, work: Work, limit: TimeLimit) -> PowerResult:
    """Try the stops that a profile would plan, or those that are planned in a run, which keeps the result.

    Raises as ``make_stops`` and ``power_of`` do, and ``InputError`` if the run has no plan.
    """
    if not where.is_dir():
        profile = load_profile(where)
        stops, _ = make_stops(profile, work.listener, work.cancel)
        return power_of(PlannedCell.of(profile, stops), trials, seed, work, limit)
    with RunFile.open(where, write=True) as run:
        required_plan(run)
        result = power_of(PlannedCell.of(run.profile, read_planned_stops(run)), trials, seed, work, limit)
        run.write_result(POWER_RESULT, result.to_json())
        return result


def power_of(planned: PlannedCell, trials: int, seed: int, work: Work, limit: TimeLimit) -> PowerResult:
    """Make ``trials`` trials of each effect in each arm, in rounds; ``seed`` draws them all.

    The time limit is shared among the effects; the intervals state the remaining uncertainty.

    Raises
    ------
    InputError
        If the profile does not describe the cell.
    Cancelled
        On request; a results file keeps the trials that were made.
    """
    cell = trial_cell(planned)
    lacking = _lacking(cell)
    tried = [
        _Tried(arm, effect, seed, 1e3 * cell.noise_rms_m(arm))
        for (arm, effect), reason in lacking.items()
        if not reason
    ]
    failed: list[str] = []
    allowed = len(tried)  # the first trial of each shows its duration
    while asked := _round(tried, trials)[:allowed]:
        began_s = limit.now()
        job, begun = f"power, {limit.words()}", any(one.trials for one in tried)
        given = {f"arm {one.arm}, {one.effect}, {one.size_mm:.3f} mm, seed {one.seed}": one for one in asked}
        prepare = partial(trial_cell, planned)
        gathered = gather(naming_trial, prepare, given, NamingTrial, job, work, all_may_fail=begun)
        failed += gathered.failed
        tried = [one.with_trials(asked, gathered.results) for one in tried]
        allowed = limit.allowed((limit.now() - began_s) / len(asked), 2 * len(tried))
    powers = {(one.arm, one.effect): one.power() for one in tried}
    return PowerResult(
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"cellapp {__version__}",
        profile=planned.profile.name,
        trials_of_each=trials,
        seed=seed,
        share=SHARE,
        arms={
            name: ArmPower(
                stops=len(planned.time_s),
                noise_rms_mm=1e3 * cell.noise_rms_m(name),
                effects=tuple(
                    powers.get((arm, effect), EffectPower(effect=effect, title=EFFECTS[effect].title, limit=reason))
                    for (arm, effect), reason in lacking.items()
                    if arm == name
                ),
            )
            for name in planned.q
        },
        trials=tuple(trial for one in tried for trial in one.trials),
        failed=tuple(failed),
        ended_by_time=bool(_round(tried, trials)),
    )


# -- inside -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Tried:
    """One effect in one arm and its trials so far; ``noise_mm`` is the rms length of the noise.

    ``failed`` counts trials that could not be computed: they are not repeated.
    """

    arm: str
    effect: str
    seed: int
    noise_mm: float
    trials: tuple[NamingTrial, ...] = ()
    failed: int = 0

    @property
    def belief(self) -> NamingCurve:
        """Estimate of the share that is named, over the size [mm]."""
        sizes = [trial.size_mm for trial in self.trials]
        named = [trial.named is not None for trial in self.trials]
        return NamingCurve.of(_LOWEST * self.noise_mm, _HIGHEST * self.noise_mm, sizes, named)

    @property
    def is_hopeless(self) -> bool:
        """Whether enough trials at large sizes named nothing, or the effect does not act at these stops."""
        acts = not self.trials or any(trial.visible for trial in self.trials)
        return not acts or (len(self.trials) >= _ENOUGH and not any(trial.named for trial in self.trials))

    def next_trials(self, most: int) -> Iterator[NamingTrial]:
        """Yield the trials of the next round, at most up to ``most`` in all."""
        if self.is_hopeless:
            return
        made = len(self.trials) + self.failed
        sizes = [size * self.noise_mm for size in _FIRST[made:]] or self.belief.next_sizes(SHARE)
        for place, size in enumerate(sizes[: most - made], start=made):
            rng = np.random.default_rng([self.seed, place, *f"{self.arm} {self.effect}".encode()])
            yield NamingTrial(arm=self.arm, effect=self.effect, size_mm=size, seed=int(rng.integers(2**31)))

    def with_trials(self, asked: Sequence[NamingTrial], found: Sequence[NamingTrial | None]) -> _Tried:
        """Add those of the trials ``asked`` that are of this effect and arm; the result of a failed one is None."""
        own = [
            result
            for trial, result in zip(asked, found, strict=True)
            if (trial.arm, trial.effect) == (self.arm, self.effect)
        ]
        done = [result for result in own if result is not None]
        return replace(self, trials=(*self.trials, *done), failed=self.failed + len(own) - len(done))

    def power(self) -> EffectPower:
        """Summarize the trials."""
        low, middle, high = self.belief.size_at(SHARE, _LIMITS)
        largest = max((trial.size_mm for trial in self.trials), default=0.0)
        shown = middle <= largest and any(trial.named for trial in self.trials)
        named = [trial for trial in self.trials if trial.named is not None]
        return EffectPower(
            effect=self.effect,
            title=EFFECTS[self.effect].title,
            named_from=NamedSize(
                value_mm=middle,
                low_mm=low,
                high_mm=high if np.isfinite(high) else None,
                size=_in_its_unit(named, middle),
            )
            if shown
            else None,
            not_up_to_mm=None if shown or not largest else largest,
            visible_share=float(np.median([trial.visible for trial in self.trials])) if self.trials else None,
            trials=len(self.trials),
            named=len(named),
            with_others=sum(len(set(trial.accepted)) > 1 for trial in named),
            limit=_limit(self.trials, 0.5 * middle if shown else 0.25 * largest),
        )


def _round(tried: Sequence[_Tried], most: int) -> list[NamingTrial]:
    """Return the next trials, the first of each effect before the second of any; at most ``most`` of each."""
    each = [list(one.next_trials(most)) for one in tried]
    return [trial for together in zip_longest(*each) for trial in together if trial is not None]


def _lacking(cell: TrialCell) -> dict[tuple[str, str], str]:
    """Return (arm, effect) -> why its data cannot show it, for effects that cannot be shown."""
    conditions = conditions_of_arms(cell.models, cell.readings)
    return {
        (name, slug): EFFECTS[slug].missing_data(model.context(cell.readings[name].q, conditions=conditions[name]))
        for name, model in cell.models.items()
        for slug in REALISTIC
        if slug in EFFECTS
    }


def _in_its_unit(named: Sequence[NamingTrial], size_mm: float) -> SmallestSize | None:
    """Convert a size [mm] to an effect's largest value, by the trials that named it; None if their units differ."""
    ratios = [(trial.named.value / trial.size_mm, trial.named.unit) for trial in named if trial.named is not None]
    ((unit, count),) = Counter(unit for _, unit in ratios).most_common(1)
    if 2 * count <= len(ratios):
        return None
    ratio = float(np.median([value for value, its in ratios if its == unit]))
    return SmallestSize(value=size_mm * ratio, unit=unit)


def _limit(trials: Sequence[NamingTrial], from_mm: float) -> str:
    """Say what limits naming, from the trials with sizes from ``from_mm`` [mm] on."""
    if not any(trial.visible for trial in trials):
        return "it does not move the SMR at these stops"
    said = []
    followed = 1.0 - float(np.median([trial.visible for trial in trials]))
    if followed > _FOLLOWED:
        said.append(f"geometry follows {followed:.0%} of it")
    missed = [trial for trial in trials if trial.size_mm >= from_mm and trial.named is None]
    instead = Counter(_name(slug) for trial in missed for slug in dict.fromkeys(trial.accepted))
    for name, count in instead.most_common(1):
        said.append(f"taken for {name} in {count} of {len(missed)} misses")
    nothing = sum(not trial.accepted for trial in missed)
    if nothing:
        said.append(f"nothing accepted in {nothing} of {len(missed)} misses")
    return "; ".join(said) or "noise"


def _name(slug: str) -> str:
    return "an unknown effect" if slug == UNKNOWN else EFFECTS[slug].title.lower()
