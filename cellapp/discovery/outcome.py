"""Outcome of discovery in one arm's data: accepted effects with their evidence, verdict, and the extended model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cellapp.discovery.describe import Description
from cellapp.discovery.pictures.picture import Picture
from cellapp.discovery.search.state import Rival
from cellapp.effects import EFFECTS, EffectTerm, term_to_json
from cellapp.model import ArmModel


@dataclass(frozen=True)
class AcceptedEffect:
    """An effect that became part of the model, with its evidence.

    Attributes
    ----------
    term : EffectTerm
    joints : tuple of int
        Joints it offsets, from 1.
    acts_on : tuple of str
        Joints or frames it acts on.
    score, p_value : float
        Score beside all other effects, and its p-value corrected for the whole scan.
    heldout_before_mm, heldout_after_mm : float
        Held-out rms error without and with it.
    rivals : tuple of Rival
    correlated : (str, float), optional
        Geometric parameter that its values are most correlated with, and the correlation.
    cycles : mapping, optional
        Dominant cycles a turn of each joint, of a transmission error.
    description : Description, optional
        Of a data-driven term.
    """

    term: EffectTerm
    joints: tuple[int, ...]
    acts_on: tuple[str, ...]
    score: float
    p_value: float
    heldout_before_mm: float
    heldout_after_mm: float
    rivals: tuple[Rival, ...]
    correlated: tuple[str, float] | None
    cycles: Mapping[str, Mapping[str, float]] | None = None
    description: Description | None = None

    @property
    def answer_set(self) -> tuple[str, ...]:
        """The effect and all that these data cannot distinguish from it."""
        return (self.term.slug, *(rival.slug for rival in self.rivals if not rival.distinguishable))


@dataclass(frozen=True)
class GapStep:
    """The held-out rms error after one step of the search."""

    what: str
    effect: str
    heldout_mm: float


@dataclass(frozen=True)
class Discovery:
    """Outcome of discovery in one arm's data.

    Attributes
    ----------
    accepted : tuple of AcceptedEffect
    noise_floor_mm : float
        Rms length of the stated noise; NaN where none is stated.
    before_mm, after_mm : float
        Held-out rms error before and after.
    steps : tuple of GapStep
    threshold : float
        Score that an effect had to pass.
    omnibus_p, scatter : float
        p-value and root of chi-square per degree of freedom of what is left; NaN where no noise is stated.
    invisible, not_found : tuple of mapping
        Effects that this plan cannot show, and those that it could have shown, with the smallest size.
    verdict, sentence : str
    model : ArmModel
        With the accepted effects.
    stage : mapping
        Held-out errors of that model.
    pictures : tuple of Picture
    network_mm : mapping, optional
        Rms correction of a residual network before and after.
    uncertainty_mm : mapping, optional
        Predicted uncertainty at the held-out stops.
    """

    accepted: tuple[AcceptedEffect, ...]
    noise_floor_mm: float
    before_mm: float
    after_mm: float
    steps: tuple[GapStep, ...]
    threshold: float
    omnibus_p: float
    scatter: float
    invisible: tuple[Mapping[str, Any], ...]
    not_found: tuple[Mapping[str, Any], ...]
    verdict: str
    sentence: str
    model: ArmModel
    stage: Mapping[str, Mapping[str, float | int]]
    pictures: tuple[Picture, ...] = ()
    network_mm: Mapping[str, float] | None = None
    uncertainty_mm: Mapping[str, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "noise_floor_mm": _number(self.noise_floor_mm),
            "heldout_mm": {"before": self.before_mm, "after": self.after_mm},
            "steps": [{"what": step.what, "effect": step.effect, "heldout_mm": step.heldout_mm} for step in self.steps],
            "threshold": self.threshold,
            "omnibus_p": _number(self.omnibus_p),
            "scatter": _number(self.scatter),
            "accepted": [_accepted_dict(effect) for effect in self.accepted],
            "invisible": [dict(entry) for entry in self.invisible],
            "not_found": [dict(entry) for entry in self.not_found],
            "network_mm": None if self.network_mm is None else dict(self.network_mm),
            "uncertainty_mm": None if self.uncertainty_mm is None else dict(self.uncertainty_mm),
            "pictures": [picture.as_dict() for picture in self.pictures],
            "verdict": self.verdict,
            "sentence": self.sentence,
        }


def as_dict(found: Mapping[str, Discovery]) -> dict[str, Any]:
    """The object that ``--json`` writes."""
    return {
        "schema": "cellapp-discover",
        "version": 1,
        "arms": {name: discovery.as_dict() for name, discovery in found.items()},
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def _accepted_dict(effect: AcceptedEffect) -> dict[str, Any]:
    term, shared = effect.term, term_to_json(effect.term)
    entry: dict[str, Any] = {
        "effect": shared["effect"],
        "title": EFFECTS[term.slug].title,
        "law": {"name": shared["law"], "constants": shared["constants"]},
        "where": {"joints": list(effect.joints), "acts_on": list(effect.acts_on)},
        "parameters": shared["parameters"],
        "evidence": {
            "statistic": effect.score,
            "corrected_p": effect.p_value,
            "heldout_mm": {"before": effect.heldout_before_mm, "after": effect.heldout_after_mm},
        },
        "answer_set": list(effect.answer_set),
        "runners_up": [
            {"effect": rival.slug, "statistic": rival.score, "told_apart": rival.distinguishable}
            for rival in effect.rivals
        ],
        "correlated_with": None
        if effect.correlated is None
        else {"parameter": effect.correlated[0], "correlation": effect.correlated[1]},
    }
    if effect.cycles is not None:
        entry["cycles"] = effect.cycles
    if effect.description is not None:
        entry["description"] = effect.description.as_dict()
        entry["where"] |= {"channel": effect.description.channel, "variables": list(effect.description.variables)}
    return entry
