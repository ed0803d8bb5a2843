"""Verdict on one arm: explained, nothing missing, unknown effect or ambiguous, with one sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.estimation.discovery.records import AcceptedEffect, RemainingStructure
from cellapp.estimation.discovery.search.comparison import FLOOR_CHANCE, Scatter
from cellapp.estimation.discovery.structure import has_structure
from cellapp.estimation.discovery.terms import UNKNOWN
from cellapp.ground.results import Verdict
from cellapp.robot.effects import EFFECTS

_FLOOR = 1.05
"""Ratio of held-out rms error to noise floor up to which the gap counts as closed: with the twin's plan of a hundred
held-out stops it scatters by 4 %."""
_FAR = 5.0
"""Ratio of scatter to stated noise that exceeds the repeatability of an arm: 75 µm of a coordinate against the 15 µm of
a tracker. Readings too few to show structure then still lack an explanation."""
_SAMPLING_ERRORS = 2.5
"""Standard errors by which the held-out rms may exceed the floor: a probability of 0.6 %."""


def verdict(
    accepted: Sequence[AcceptedEffect],
    floor_mm: float,
    after_mm: float,
    held_out: int,
    scatter: Scatter | None,
    structure: RemainingStructure,
) -> tuple[Verdict, str]:
    """Return the verdict and its sentence.

    ``held_out`` is the number of held-out readings; ``scatter`` and ``structure`` are those of the residuals. An error
    at the stated noise counts as explained. Above it, or if none is stated, the residuals must show no structure.
    """
    driven = [effect.description for effect in accepted if effect.description is not None]
    named = [effect for effect in accepted if effect.effect != UNKNOWN]
    names = " and ".join(EFFECTS[effect.effect].title for effect in named)
    ambiguous = [effect for effect in named if len(effect.answer_set) > 1]
    if driven:
        also = f"{names}, and " if names else ""
        described = "; ".join(description.sentence for description in driven)
        return "unknown effect", f"{also}something that the library does not have: {described}"
    closed = scatter is not None and _gap_closed(floor_mm, after_mm, held_out, scatter)
    left = _left(floor_mm, after_mm, scatter, structure, closed=closed)
    if not closed and (has_structure(structure) or _far_off(scatter, structure)):
        found = f"{names} found{' (or a look-alike)' if ambiguous else ''}, but " if accepted else ""
        return "unknown effect", f"{found}the library does not explain all of the error; {left}"
    if not accepted:
        return "nothing missing", left if closed else f"no effect found; {left}"
    if ambiguous:
        return "ambiguous", f"{names}, or {_rivals(ambiguous)}: these data cannot distinguish them; {left}"
    return "explained", f"{names}; {left}"


def _left(
    floor_mm: float, after_mm: float, scatter: Scatter | None, structure: RemainingStructure, *, closed: bool
) -> str:
    """Describe the residual error in words."""
    held_out = f"{after_mm * 1e3:.0f} µm rms held out"
    if scatter is None:
        return f"{structure.sentence}; {held_out}, and the readings state no uncertainty"
    gap = f"{held_out} against a noise floor of {floor_mm * 1e3:.0f} µm"
    if closed:
        return gap
    if has_structure(structure):
        return f"{structure.sentence}; {gap}"
    if _far_off(scatter, structure):
        return f"readings scatter {scatter.ratio:.0f} times as stated and are too few to look for effects; {gap}"
    without = "but without structure" if structure.tests else "and are too few to test for structure"
    return f"readings scatter {scatter.ratio:.2f} times as stated {without}: repeatability or noise; {gap}"


def _far_off(scatter: Scatter | None, structure: RemainingStructure) -> bool:
    """Return whether readings too few to show structure scatter more than an arm's repeatability."""
    return scatter is not None and not structure.tests and scatter.ratio > _FAR


def sampling_allowance(held_out: int) -> float:
    """Return the factor by which the rms error of n held-out readings may exceed another one by sampling alone.

    The rms of 3 n coordinates has a relative standard error of ``1 / sqrt(6 n)``.
    """
    return 1.0 + _SAMPLING_ERRORS / math.sqrt(6.0 * max(held_out, 1))


def _gap_closed(floor_mm: float, after_mm: float, held_out: int, scatter: Scatter) -> bool:
    """Return whether the held-out error is at the noise floor, or the residuals may be the stated noise."""
    sampling = sampling_allowance(held_out)
    return (
        after_mm <= floor_mm * _FLOOR
        or scatter.p_value > FLOOR_CHANCE
        or (after_mm <= floor_mm * sampling and scatter.ratio < _FLOOR)
    )


def _rivals(effects: Sequence[AcceptedEffect]) -> str:
    slugs = dict.fromkeys(slug for effect in effects for slug in effect.answer_set[1:])
    return " or ".join(EFFECTS[slug].title for slug in slugs)
