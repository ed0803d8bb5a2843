"""Detectability: effects that the data cannot show, and the smallest detectable size of the others."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.estimation.design.information import VISIBLE
from cellapp.estimation.discovery.records import AbsentEffect, SmallestSize
from cellapp.estimation.discovery.search.scan import LawScan
from cellapp.estimation.discovery.search.significance import smallest_detectable
from cellapp.estimation.discovery.search.state import SCORE_MARGIN, SearchResult
from cellapp.robot.effects import EFFECTS

_BARELY_VISIBLE = 0.03
"""Visible share below which an effect is reported as invisible under this plan: it would need to be 30 times as large
as an effect that the geometry cannot imitate."""
_MOST_SIZES = 40
"""Most parameters of one effect whose smallest sizes are reported: all joints and axes, but not hundreds of lines."""


@dataclass(frozen=True)
class _Detectable:
    """An effect's largest visible share, smallest size of each parameter, and least rms displacement (whitened)."""

    visible_share: float
    sizes: dict[str, SmallestSize]
    least_rms: float


def detectability(found: SearchResult, scan: LawScan) -> tuple[tuple[AbsentEffect, ...], tuple[AbsentEffect, ...]]:
    """Return effects that the data cannot show, and effects that were not found with their smallest detectable sizes.

    ``scan`` covers all effects that the final model lacks.
    """
    fit = found.fit if found.fit.terms else found.geometry_only
    noise_mm = 1e3 * (1.0 / math.sqrt(float(np.mean(np.einsum("aan->an", fit.white[:, :, fit.positions]) ** 2))))
    needed = found.threshold + SCORE_MARGIN  # score of a name with even odds
    invisible: list[AbsentEffect] = []
    not_found: list[AbsentEffect] = []
    for slug in found.absent:
        if lacking := EFFECTS[slug].missing_data(found.data.context):
            invisible.append(AbsentEffect(effect=slug, reason=f"not testable: {lacking}"))
            continue
        one = _detectable(scan, slug, needed)
        hidden = one.visible_share <= _BARELY_VISIBLE
        how_much = "all" if one.visible_share <= VISIBLE else "nearly all"
        (invisible if hidden else not_found).append(
            AbsentEffect(
                effect=slug,
                reason=f"invisible: geometry can follow {how_much} of it under this plan"
                if hidden
                else "not found; it could have been seen from these sizes on",
                visible_share=one.visible_share,
                smallest_seen=one.sizes or None,
                smallest_seen_rms_mm=one.least_rms * noise_mm * math.sqrt(3.0)
                if math.isfinite(one.least_rms)
                else None,
            )
        )
    return tuple(invisible), tuple(not_found)


def _detectable(scan: LawScan, slug: str, needed: float) -> _Detectable:
    """Return visible share and smallest sizes of one effect, over the laws of its simplest form that the data allow.

    A refined form may be visible although the effect itself is not: a scale error that bends with the range of the
    beam.
    """
    own = [candidate.law.form for candidate in scan.candidates if candidate.slug == slug]
    simplest = next((form for form in EFFECTS[slug].forms if form in own), None)
    sizes: dict[str, SmallestSize] = {}
    share, least_rms = 0.0, math.inf
    for number, candidate in enumerate(scan.candidates):
        if candidate.slug != slug or candidate.law.form != simplest:
            continue
        place = scan.place(number)
        share = max(share, float(scan.visible_share[place].max(initial=0.0)))
        size_of = smallest_detectable(scan, number, needed)
        rms = np.sqrt(np.mean(scan.behind.rows[place] ** 2, axis=1)).tolist()
        for column, displaced in zip(candidate.columns, rms, strict=True):
            size = size_of[column.name]
            if not math.isfinite(size):
                continue
            least_rms = min(least_rms, size * displaced)
            known = sizes.get(column.name)
            if (known is None or size < known.value) and len(sizes) < _MOST_SIZES:
                sizes[column.name] = SmallestSize(value=size, unit=column.unit)
    return _Detectable(share, sizes, least_rms)
