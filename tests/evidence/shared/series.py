"""Measured series of real robots, and draws of rows for learning and held-out rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.profile import load_profile
from cellapp.cell.run.csv_import import joint_limits
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.cell.run.small_runs import read_readings_csv
from tests.evidence.skeleton import ROOT

Rows = int | str
"""Number of rows to learn from, or ``all``."""
SERIES: Mapping[str, str] = {"C": "ur10-real", "D": "ur10-real-d", "UR5": "ur5-real", "D6": "ur10-6d"}
"""Series -> its folder of fixtures, and the stem of its profile; D6 is D with orientations."""
_SAMPLE_SEED = 0x1EA6
"""Mixed with the seed of a draw, so that it is independent of all other draws of the program."""
_HELD_OUT_OF_ALL = 0.2
"""Share that is held out if all rows of a series are learned from and its authors held none out."""


@dataclass(frozen=True, eq=False)
class Entrant:
    """A series with the readings of its one arm; approach and step follow from the order of the rows."""

    name: str
    profile: Profile
    arm: str
    readings: Readings

    @property
    def pool(self) -> NDArray[np.intp]:
        """Rows that may be used for learning: those that the authors did not hold out."""
        return np.setdiff1d(np.arange(len(self.readings)), self.readings.in_split("validate"))


@dataclass(frozen=True, eq=False)
class SampledRows:
    """Rows to learn from, and the held-out rows by group (all, others, published); the first group is all of them."""

    learned: NDArray[np.intp]
    held_out: Mapping[str, NDArray[np.intp]]

    def split(self, readings: Readings) -> Readings:
        """Return the readings with their splits: rows to learn from, and held-out rows."""
        words = np.full(len(readings), None, dtype=object)
        words[self.learned], words[next(iter(self.held_out.values()))] = "identify", "validate"
        return replace(readings, split=tuple(words.tolist()))


@cache
def load_entrant(name: str) -> Entrant:
    """Read a series and its profile."""
    profile = load_profile(ROOT / "profiles" / f"{SERIES[name]}.yaml")
    readings, _ = read_readings_csv(
        ROOT / "tests" / "fixtures" / SERIES[name] / "readings.csv",
        {arm: len(one.type.joints) for arm, one in profile.arms.items()},
        in_order=True,
        limits=joint_limits(profile),
    )
    ((arm, rows),) = readings.items()
    return Entrant(name, profile, arm, rows)


def sample_rows(entrant: Entrant, rows: Rows, seed: int) -> SampledRows:
    """Draw the rows to learn from; all others are held out, including those that the authors held out.

    Draws of one seed are nested: more rows include the fewer. Raises ``InputError`` if the series has too few rows.
    """
    pool, published = entrant.pool, entrant.readings.in_split("validate")
    order = np.random.default_rng([seed, _SAMPLE_SEED]).permutation(pool)
    held_out_of_all = 0 if len(published) else round(_HELD_OUT_OF_ALL * len(pool))
    count = len(pool) - held_out_of_all if isinstance(rows, str) else rows
    if count > len(pool) or (count == len(pool) and not len(published)):
        raise InputError(f"series {entrant.name} has {len(pool)} rows to learn from; ask for fewer than {count}")
    others = np.sort(order[count:])
    groups = {"all": np.concatenate([others, published])}
    if len(published):
        groups = {**groups, "others": others, "published": published} if len(others) else {"published": published}
    return SampledRows(np.sort(order[:count]), groups)
