"""Uncertainty budget of a measured orientation error (JCGM 100): independent contributions, for one component."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.estimation.uncertainty.budget import COVERAGE, combined
from cellapp.estimation.uncertainty.records import TurnContribution
from cellapp.ground.profile import Profile


def turn_budget(
    profile: Profile, arm: str, model_mrad: float, noise_mrad: float, basis: str = "at the command"
) -> tuple[TurnContribution, ...]:
    """Return the contributions to the uncertainty of a flange rotation measured by a probe or several SMRs [mrad].

    With several SMRs only the scatter about the model is known, which includes the arm's repeatability.

    Parameters
    ----------
    model_mrad : float
        Standard uncertainty of a component by the model in force, including the mounting of the probe.
    noise_mrad : float
        Scatter of measured orientations about the model.
    basis : str
        Words that say to which command ``model_mrad`` belongs.
    """
    smr, scatter = profile.arms[arm].smr, f"orientations scatter by {noise_mrad:.4f} mrad about the model"
    stated = None if smr.probe is None else smr.probe.sigma * 1e3
    beyond = math.sqrt(max(noise_mrad**2 - (stated or 0.0) ** 2, 0.0))
    said = "not given: the profile states no probe (smr.probe)"
    lines = [
        ("6-D probe", stated, "B", said if stated is None else "stated standard uncertainty about each axis"),
        ("repeatability of the arm", beyond, "A", f"{scatter}; what exceeds the probe's"),
        ("calibrated model", model_mrad, "A", f"posterior of the model in force {basis}"),
    ]
    return tuple(
        TurnContribution.model_validate(
            {"source": source, "standard_mrad": value, "evaluation": kind, "basis": words, "where": arm}
        )
        for source, value, kind, words in lines
    )


def expanded_mrad(contributions: Sequence[TurnContribution]) -> float | None:
    """Return the expanded uncertainty [mrad], k = 2; None if a contribution is missing."""
    standard_mrad = combined(one.standard_mrad for one in contributions)
    return None if standard_mrad is None else COVERAGE * standard_mrad
