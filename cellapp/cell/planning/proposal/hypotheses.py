"""Hypotheses for further stops to decide between: one effect or another, or an effect or none.

Each is judged by T-optimality (see ``estimation.design.discrimination``). The true model has the effect with its fitted
values. The rival model has geometry, the other accepted effects and, if there is a rival effect, this by any of its
laws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellapp.cell.planning.proposal.candidate_design import CandidateDesign
from cellapp.estimation.design.discrimination import Discrimination
from cellapp.estimation.discovery.arm_data import ArmData
from cellapp.estimation.discovery.joint_fit import JointFit, refit
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.discovery.terms import Excess, ModelTerm, Smoothness
from cellapp.robot.effects import EFFECTS, DriverVariable, EffectColumn, EffectTerm, Law
from cellapp.robot.kinematics.transforms import Array


@dataclass(frozen=True)
class RivalLaw:
    """A law of the rival effect with those of its columns that may imitate the first effect."""

    law: Law
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect, against another one or (``against`` empty) against none.

    Attributes
    ----------
    effect, against : str
        Slugs.
    needed : float
        Non-centrality lambda from which the data decide.
    data, fit
        The model that the values are taken from.
    term : int, optional
        The effect's term in ``fit``; None where it is no part of it.
    law : Law
    names : tuple of str, length c
        Columns of the effect.
    values : array, shape (k, c)
        Values of these columns: k signals, whose mean lambda counts.
    rivals : tuple of RivalLaw
        Laws of the other effect, each of which may stand for it.
    """

    effect: str
    against: str
    needed: float
    data: ArmData
    fit: JointFit
    term: int | None
    law: Law
    names: tuple[str, ...]
    values: Array
    rivals: tuple[RivalLaw, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """The one or two effects that are compared."""
        return (self.effect, self.against) if self.against else (self.effect,)

    @property
    def variables(self) -> frozenset[DriverVariable]:
        """All variables that either model depends on."""
        slugs = [*self.effects, *(term.slug for term in self.fit.terms)]
        return frozenset().union(*(EFFECTS[slug].variables for slug in slugs))

    @property
    def columns_a_candidate(self) -> int:
        """Number of columns that all its discriminations hold for each candidate."""
        columns = len(self.fit.rows) + sum(len(rival.names) for rival in self.rivals)
        return columns * max(len(self.rivals), 1)

    def discriminations(self, design: CandidateDesign) -> list[Discrimination]:
        """Set up one discrimination for each law of the rival, over candidate stops."""
        data, fit = self.data, self.fit
        others = [term for number, term in enumerate(fit.terms) if number != self.term]
        further = [design.geometric, *(design.rows(term.slug, term.law, term.names) for term in others)]
        kept = np.ones(len(fit.rows), dtype=bool) if self.term is None else fit.layout.all_but(self.term)
        own = fit.displacements(data.columns(self.effect, self.law, self.names))
        signals = self.values @ own
        candidate_signals = design.by_stop(self.values @ design.rows(self.effect, self.law, self.names))
        found = []
        for rival in self.rivals or (RivalLaw(self.law, ()),):
            columns = data.columns(self.against, rival.law, rival.names) if rival.names else []
            more = [design.rows(self.against, rival.law, rival.names)] if rival.names else []
            found.append(
                Discrimination(
                    run_columns=np.concatenate([fit.rows[kept], fit.displacements(columns)]),
                    precision=np.concatenate([fit.precision[kept], [_bound_precision(c) for c in columns]]),
                    run_signals=signals,
                    candidate_columns=design.by_stop(np.concatenate([*further, *more])),
                    candidate_signals=candidate_signals,
                )
            )
        return found


def _bound_precision(column: EffectColumn) -> float:
    """Return the precision of a weak prior: the parameter is within its physical bounds."""
    bound = max(abs(column.lower), abs(column.upper))
    return 1.0 / bound**2 if math.isfinite(bound) and bound > 0.0 else 0.0


def refitted_discovery(data: ArmData, discovery: Discovery) -> tuple[ArmData, JointFit]:
    """Repeat the final fit of a discovery: the accepted terms with the weights of its search."""
    terms = tuple(_model_term(term, discovery.scatter_m) for term in discovery.terms)
    return refit(data, terms)


def _model_term(term: EffectTerm, scatter_m: float) -> ModelTerm:
    """Convert an accepted term to a term under test, without free part; ``scatter_m`` scales smooth priors."""
    smooth = Smoothness(0.0, 0, Excess(scatter_m)) if term.law.form.is_smooth else None
    return ModelTerm(term.slug, term.law, term.law_names, smooth, note=term.note)
