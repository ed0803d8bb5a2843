"""Factors of a planned stop beside its joint positions: where the approach begins, how long the arms rest first.

A run stores them as the document ``factors``: ``{stop: {arm: {"via": [q1, ...], "dwell_s": s}}}``. Stops count from 0;
a listed stop was proposed by discovery; either key may be missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import TypeAdapter, ValidationError

from cellapp.errors import InputError
from cellapp.kinematics.transforms import Array
from cellapp.results import FACTORS, Record
from cellapp.run import RunFile

LONGEST_DWELL_S = 600.0
"""Longest rest before a measurement that a stored run may ask for: ten times any settling time of an arm."""


class FactorsRecord(Record):
    """Factors of one arm at one stop as they are stored."""

    via: tuple[float, ...] | None = None
    dwell_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Factors:
    """How one arm approaches a stop.

    Attributes
    ----------
    via : array, shape (N,), or None
        Joint positions [rad] from which the last motion starts; None is directly from the stop before.
    dwell_s : float
        Least time at rest before the measurement [s].
    """

    via: Array | None = None
    dwell_s: float = 0.0


def read_factors(run: RunFile) -> dict[int, dict[str, Factors]]:
    """Stop -> arm -> factors of the proposed stops; empty if there are none.

    Raises
    ------
    InputError
        If the stored document is not one that ``write_factors`` writes.
    """
    text = run.read_result(FACTORS)
    if text is None:
        return {}
    try:
        stored = _DOCUMENT.validate_json(text)
        return {stop: {arm: _checked(run, arm, one) for arm, one in arms.items()} for stop, arms in stored.items()}
    except (ValueError, KeyError) as error:
        raise InputError(
            f"{run.path}: the factors of its proposed stops are damaged ({_first_line(error)}); propose them again with"
            " 'cellapp discover DIR --propose N'"
        ) from None


def write_factors(run: RunFile, factors: Mapping[int, Mapping[str, Factors]]) -> None:
    """Store the factors of all proposed stops in place of earlier ones."""
    stored = {stop: {arm: _record(one) for arm, one in arms.items()} for stop, arms in factors.items()}
    run.write_result(FACTORS, _DOCUMENT.dump_json(stored, exclude_defaults=True).decode())


_DOCUMENT = TypeAdapter(dict[int, dict[str, FactorsRecord]])


def _record(factors: Factors) -> FactorsRecord:
    return FactorsRecord(via=None if factors.via is None else tuple(factors.via.tolist()), dwell_s=factors.dwell_s)


def _checked(run: RunFile, arm: str, stored: FactorsRecord) -> Factors:
    joints = len(run.profile.arms[arm].type.joints)
    via = None if stored.via is None else np.array(stored.via, dtype=np.float64)
    if via is not None and (via.shape != (joints,) or not np.isfinite(via).all()):
        raise ValueError(f"arm {arm}: 'via' must be {joints} finite joint positions")
    if not (math.isfinite(stored.dwell_s) and 0.0 <= stored.dwell_s <= LONGEST_DWELL_S):
        raise ValueError(f"arm {arm}: 'dwell_s' must lie between 0 and {LONGEST_DWELL_S:g} s")
    return Factors(via, stored.dwell_s)


def _first_line(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return str(error)
