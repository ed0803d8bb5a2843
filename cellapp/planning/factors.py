"""What a planned stop asks for beside its joint positions: by which way it is approached, how long the arms rest first.

A run keeps it under the result ``factors``: ``{stop: {arm: {"via": [q1, ...], "dwell_s": s}}}``; stops count from 0, a
stop that is listed was proposed by discovery, and either key may be missing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.run import RunFile

FACTORS_RESULT = "factors"
LONGEST_DWELL_S = 600.0


@dataclass(frozen=True, eq=False)
class Factors:
    """How one arm comes to a stop.

    Attributes
    ----------
    via : array, shape (N,), or None
        Where it goes first [rad]; from there its last leg begins. None is straight from wherever it was.
    dwell_s : float
        How long it rests, at least, before it is measured [s].
    """

    via: Array | None = None
    dwell_s: float = 0.0


def read_factors(run: RunFile) -> dict[int, dict[str, Factors]]:
    """Stop -> arm -> factors of the stops that were proposed; empty where none were.

    Raises
    ------
    InputError
        If what the run holds is not what ``write_factors`` writes.
    """
    text = run.read_result(FACTORS_RESULT)
    if text is None:
        return {}
    try:
        content = json.loads(text)
        return {
            int(stop): {arm: _checked(run, arm, entry) for arm, entry in arms.items()} for stop, arms in content.items()
        }
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise InputError(
            f"{run.path}: the factors of its proposed stops are damaged ({error}); propose them anew with"
            " 'cellapp discover DIR --propose N'"
        ) from None


def write_factors(run: RunFile, factors: Mapping[int, Mapping[str, Factors]]) -> None:
    """Store the factors of all proposed stops in place of those that were there."""
    run.write_result(
        FACTORS_RESULT,
        json.dumps({str(stop): {arm: as_dict(one) for arm, one in arms.items()} for stop, arms in factors.items()}),
    )


def as_dict(factors: Factors) -> dict[str, Any]:
    """For JSON: only what is asked for."""
    entry: dict[str, Any] = {}
    if factors.via is not None:
        entry["via"] = factors.via.tolist()
    if factors.dwell_s > 0.0:
        entry["dwell_s"] = factors.dwell_s
    return entry


def _checked(run: RunFile, arm: str, entry: Mapping[str, Any]) -> Factors:
    joints = len(run.profile.arms[arm].type.joints)
    via = None if "via" not in entry else np.array(entry["via"], dtype=np.float64)
    if via is not None and (via.shape != (joints,) or not np.isfinite(via).all()):
        raise ValueError(f"arm {arm}: 'via' must be {joints} finite joint positions")
    dwell_s = float(entry.get("dwell_s", 0.0))
    if not (math.isfinite(dwell_s) and 0.0 <= dwell_s <= LONGEST_DWELL_S):
        raise ValueError(f"arm {arm}: 'dwell_s' must lie between 0 and {LONGEST_DWELL_S:g} s")
    return Factors(via, dwell_s)
