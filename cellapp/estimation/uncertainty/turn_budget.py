"""The uncertainty of a measured error of orientation by its contributions (JCGM 100): independent, of one component."""

from __future__ import annotations

import math
from collections.abc import Sequence

from cellapp.estimation.uncertainty.budget import COVERAGE, combined
from cellapp.estimation.uncertainty.records import TurnContribution
from cellapp.ground.profile import Profile


def turn_budget(
    profile: Profile, arm: str, model_mrad: float, noise_mrad: float, basis: str = "at the command"
) -> tuple[TurnContribution, ...]:
    """Contributions to the uncertainty of the rotation of a flange that a probe or several SMRs measured [mrad].

    What several SMRs tell is known by its scatter about the model alone, which the arm's repeatability is part of.

    Parameters
    ----------
    model_mrad : float
        Standard uncertainty of a component by the model in force, with how the probe is mounted.
    noise_mrad : float
        Scatter of measured orientations about the model.
    basis : str
        Of which command ``model_mrad`` is.
    """
    smr, scatter = profile.arms[arm].smr, f"orientations scatter by {noise_mrad:.4f} mrad about the model"
    stated = None if smr.probe is None else smr.probe.sigma * 1e3
    beyond = math.sqrt(max(noise_mrad**2 - (stated or 0.0) ** 2, 0.0))
    said = "not given: the profile states no probe (smr.probe), and fewer than three nests (smr.nests)"
    lines = [
        ("6-D probe", stated, "B", said if stated is None else "stated standard uncertainty about each axis"),
        ("repeatability of the arm", beyond, "A", f"{scatter}; what exceeds the probe's"),
        ("calibrated model", model_mrad, "A", f"posterior of the model in force {basis}"),
    ]
    if smr.probe is None and smr.tells_orientation:
        lines[:2] = [("several SMRs", noise_mrad, "A", f"{scatter}, with the repeatability of the arm")]
    return tuple(
        TurnContribution.model_validate(
            {"source": source, "standard_mrad": value, "evaluation": kind, "basis": words, "where": arm}
        )
        for source, value, kind, words in lines
    )


def expanded_mrad(contributions: Sequence[TurnContribution]) -> float | None:
    """Expanded uncertainty [mrad], k = 2; None where a contribution was not given."""
    standard_mrad = combined(one.standard_mrad for one in contributions)
    return None if standard_mrad is None else COVERAGE * standard_mrad
