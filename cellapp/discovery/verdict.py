"""Verdict on one arm: explained, nothing missing, unknown effect or ambiguous, with one sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.discovery.outcome import AcceptedEffect
from cellapp.discovery.search.comparison import FLOOR_CHANCE, Scatter
from cellapp.discovery.terms import UNKNOWN
from cellapp.effects import EFFECTS
from cellapp.results import Verdict

_FLOOR = 1.05
"""Held-out rms error over the noise floor up to which the gap counts as closed: the twin's plan of a hundred held-out
stops scatters it by 4 %."""
_UNSTRUCTURED = 1.5
"""Factor on the stated uncertainty up to which scatter without any structure is called noise and not an effect."""
_SAMPLING_ERRORS = 2.5
"""Standard errors of the held-out rms by which it may pass the floor: a chance of 0.6 %."""


def verdict(
    accepted: Sequence[AcceptedEffect], floor_mm: float, after_mm: float, held_out: int, scatter: Scatter | None
) -> tuple[Verdict, str]:
    """Verdict and sentence; ``held_out`` is the number of held-out readings, ``scatter`` that of what is left."""
    driven = [effect.description for effect in accepted if effect.description is not None]
    named = [effect for effect in accepted if effect.term.slug != UNKNOWN]
    names = " and ".join(EFFECTS[effect.term.slug].title for effect in named)
    ambiguous = [effect for effect in named if len(effect.answer_set) > 1]
    if driven:
        also = f"{names}, and " if names else ""
        described = "; ".join(description.sentence for description in driven)
        return "unknown effect", f"{also}something that the library does not have: {described}"
    if scatter is None:
        left = "the readings state no uncertainty, so it is not known whether what is left is noise"
        if ambiguous:
            return "ambiguous", f"{names}, or {_rivals(ambiguous)}; {left}"
        return ("explained", f"{names}; {left}") if accepted else ("nothing missing", f"nothing found; {left}")
    gap = f"{after_mm * 1e3:.0f} um rms held out against a noise floor of {floor_mm * 1e3:.0f} um"
    closed = _gap_closed(floor_mm, after_mm, held_out, scatter)
    if not closed and (accepted or scatter.ratio > _UNSTRUCTURED):
        found = f"{names} found{' (or a look-alike)' if ambiguous else ''}, but " if accepted else ""
        return "unknown effect", f"{found}the library does not explain all of the error; {gap}"
    if not accepted:
        return "nothing missing", gap if closed else f"{_unstructured(scatter)}; {gap}"
    if ambiguous:
        return "ambiguous", f"{names}, or {_rivals(ambiguous)}: these data cannot distinguish them; {gap}"
    return "explained", f"{names}; {gap}"


def _gap_closed(floor_mm: float, after_mm: float, held_out: int, scatter: Scatter) -> bool:
    """Whether the held-out error is at the noise floor, or what is left may be the stated noise."""
    # the rms of 3 n coordinates has a relative standard error of 1 / sqrt(6 n)
    sampling = 1.0 + _SAMPLING_ERRORS / math.sqrt(6.0 * max(held_out, 1))
    return (
        after_mm <= floor_mm * _FLOOR
        or scatter.p_value > FLOOR_CHANCE
        or (after_mm <= floor_mm * sampling and scatter.ratio < _FLOOR)
    )


def _unstructured(scatter: Scatter) -> str:
    return (
        f"no effect found; readings scatter {scatter.ratio:.2f} times as stated but without structure in joints, time"
        " or field: repeatability or noise, not something a model could follow"
    )


def _rivals(effects: Sequence[AcceptedEffect]) -> str:
    slugs = dict.fromkeys(slug for effect in effects for slug in effect.answer_set[1:])
    return " or ".join(EFFECTS[slug].title for slug in slugs)
