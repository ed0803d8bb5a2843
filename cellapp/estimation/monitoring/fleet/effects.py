"""Effects of one arm that appear, vanish, grow or shrink from the first run to another.

An effect that was not found in one run may have been there below what that run could see. It has appeared only if it is
now proven larger than the smallest size that the first run would have found, and likewise for one that vanished.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from scipy.special import fdtrc

from cellapp.estimation.monitoring.fleet.parameters import MODEL_CHOICE, two_sided
from cellapp.estimation.monitoring.fleet.record import ArmRecord, EffectRecord
from cellapp.estimation.monitoring.fleet.records import EffectState
from cellapp.ground.grouping import grouped
from cellapp.ground.results import Estimate
from cellapp.robot.effects import EFFECTS

UNKNOWN = "unknown"
"""Slug of the effects that no physical law describes."""
BESIDE_OTHERS = 2.0
"""Further factor on standard uncertainties where each run has parameters of an effect that the other lacks: those that
both have then stand beside others, and take over a part of what these do not explain. Over unchanged twins such
differences scatter up to twice as widely."""
SEEN_FROM = 6.0
"""Standard errors from which on the search names a parameter, where the run does not state a smallest size: its own
statements are 5 to 6."""


@dataclass(frozen=True)
class EffectComparison:
    """An effect in the newest run against the first.

    ``parameter`` is the one with the smallest chance ``p_value`` (None: not tested) of ``tests`` that were made.
    """

    effect: str
    first: EffectRecord | None
    last: EffectRecord | None
    state: EffectState
    tests: int = 0
    parameter: str = ""
    unit: str = ""
    difference: float | None = None
    standard_uncertainty: float | None = None
    p_value: float | None = None
    instead_of: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Test:
    """One test of a parameter; ``excess`` is what exceeds the difference that may be there unseen."""

    parameter: str
    unit: str
    difference: float
    standard_uncertainty: float
    p_value: float
    state: EffectState


def compare_effects(first: ArmRecord, last: ArmRecord) -> tuple[EffectComparison, ...]:
    """Every effect of either run; empty where one of them was not searched."""
    if first.effects is None or last.effects is None:
        return ()
    before, after = ({one.effect: one for one in _joined(run.effects or ())} for run in (first, last))
    return tuple(
        _compared(slug, before.get(slug), after.get(slug), first, last) for slug in dict.fromkeys([*before, *after])
    )


def is_of_arm(found: EffectRecord) -> bool:
    """Whether an effect belongs to the arm: a drift of the base or of the tracker is of the day, and no change of it.

    An unknown effect belongs to the arm if it acts on joints; so does one that this version does not know.
    """
    known = EFFECTS.get(found.effect)
    return known is None or known.arm_bound or (known.slug == UNKNOWN and bool(found.where.joints))


def _joined(effects: tuple[EffectRecord, ...]) -> Iterator[EffectRecord]:
    """One record for each effect: terms of one effect at several places have parameters of their own."""
    by_slug = grouped((one.effect, one) for one in effects)
    for same in by_slug.values():
        parameters: dict[str, Estimate] = {}
        for one in same:
            parameters |= one.parameters
        sizes = [one.size_mm for one in same if one.size_mm is not None]
        yield same[0].model_copy(update={"parameters": parameters, "size_mm": math.hypot(*sizes) if sizes else None})


def _compared(
    slug: str, before: EffectRecord | None, after: EffectRecord | None, first: ArmRecord, last: ArmRecord
) -> EffectComparison:
    known = after or before
    if known is not None and not is_of_arm(known):
        return EffectComparison(slug, before, after, "not judged")
    instead = _instead_of(slug, before, after, first, last)
    if instead:
        return EffectComparison(slug, before, after, "renamed", instead_of=instead)
    if before is not None and after is not None:
        return _of_tests(slug, before, after, "stays", [*_sizes(before, after), *_new_parameters(before, after)])
    found, other = (after, first) if after is not None else (before, last)
    state: EffectState = "appeared" if after is not None else "vanished"
    assert found is not None
    if slug in other.unseen:
        return EffectComparison(slug, before, after, "not judged")
    tests = list(_against_nothing(found, other, state))
    return _of_tests(slug, before, after, "not judged", tests)


def _of_tests(
    slug: str, before: EffectRecord | None, after: EffectRecord | None, otherwise: EffectState, tests: list[_Test]
) -> EffectComparison:
    """The comparison with its most telling test; its state holds if that test is significant, else ``otherwise``."""
    if not tests:
        return EffectComparison(slug, before, after, otherwise)
    best = min(tests, key=lambda test: test.p_value)
    return EffectComparison(slug, before, after, tests=len(tests), **vars(best))


def _instead_of(
    slug: str, before: EffectRecord | None, after: EffectRecord | None, first: ArmRecord, last: ArmRecord
) -> tuple[str, ...]:
    """Effects of the other run that the data cannot tell from this one."""
    if before is not None and after is not None:
        return ()
    own, others = (before, last.effects or ()) if before is not None else (after, first.effects or ())
    assert own is not None
    return tuple(
        dict.fromkeys(
            other.effect
            for other in others
            if other.effect != slug and (slug in other.answer_set or other.effect in own.answer_set)
        )
    )


def _sizes(before: EffectRecord, after: EffectRecord) -> Iterator[_Test]:
    """Parameters that both runs have."""
    gone, new = before.parameters.keys() - after.parameters.keys(), after.parameters.keys() - before.parameters.keys()
    factor = MODEL_CHOICE * (BESIDE_OTHERS if gone and new else 1.0)
    for name, value in after.parameters.items():
        earlier = before.parameters.get(name)
        if earlier is None or earlier.unit != value.unit or not _known(earlier, value):
            continue
        difference = value.value - earlier.value
        uncertainty = factor * math.hypot(value.standard_error or 0.0, earlier.standard_error or 0.0)
        state: EffectState = "grew" if abs(value.value) > abs(earlier.value) else "shrank"
        yield _Test(name, value.unit, difference, uncertainty, two_sided(difference / uncertainty, None), state)


def _new_parameters(before: EffectRecord, after: EffectRecord) -> Iterator[_Test]:
    """Parameters that only one of the runs has.

    Where each run has some that the other lacks, they are other words for the same: the moment of a link, say, in place
    of the compliance of its joint. Nothing is said of them: the share of the error that an effect removes, which both
    runs state, depends on the order in which the search found them.
    """
    gone, new = (
        {name: value for name, value in own.parameters.items() if name not in other.parameters}
        for own, other in ((before, after), (after, before))
    )
    if gone and new:
        return
    for name, value in new.items():
        yield from _exceeding(name, value, None, 1.0, "grew")
    for name, value in gone.items():
        yield from _exceeding(name, value, None, -1.0, "shrank")


def _against_nothing(found: EffectRecord, other: ArmRecord, state: EffectState) -> Iterator[_Test]:
    """Parameters against the smallest sizes that the other run would have found; a free curve by its rms size."""
    smallest: Mapping[str, float] = other.smallest.get(found.effect, {})
    sign = 1.0 if state == "appeared" else -1.0
    for name, value in found.parameters.items():
        yield from _exceeding(name, value, smallest.get(name), sign, state)
    if not found.parameters and found.size_mm is not None and found.n and other.heldout_n and other.heldout_rms_mm:
        # All that was left unexplained in the other run is an upper limit of what this effect was there.
        ratio = (found.size_mm / other.heldout_rms_mm) ** 2
        chance = float(fdtrc(3.0 * found.n, 3.0 * other.heldout_n, ratio))
        yield _Test("rms size", "mm", sign * found.size_mm, other.heldout_rms_mm, chance, state)


def _exceeding(name: str, value: Estimate, smallest: float | None, sign: float, state: EffectState) -> Iterator[_Test]:
    """The size of a parameter beyond what the other run may have had unseen; both count with the same uncertainty."""
    if not _known(value):
        return
    error = value.standard_error or 0.0
    uncertainty = MODEL_CHOICE * math.hypot(error, error)
    unseen = SEEN_FROM * error if smallest is None else smallest
    excess = max(0.0, abs(value.value) - unseen)
    yield _Test(name, value.unit, sign * value.value, uncertainty, two_sided(excess / uncertainty, None), state)


def _known(*values: Estimate) -> bool:
    return all(
        value.standard_error is not None and 0.0 < value.standard_error < math.inf and math.isfinite(value.value)
        for value in values
    )
