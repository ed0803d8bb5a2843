"""Measured series of the league, and draws of rows for learning and held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellapp.cell.profile import load_profile
from cellapp.cell.run import read_readings_csv
from cellapp.cell.run.csv_import import joint_limits
from cellapp.estimation.readings import Readings
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record

Group = Literal["all", "others", "published"]
"""Group of held-out rows: all; those that the authors of the data held out; the others."""
Rows = int | Literal["all"]
"""Number of rows to learn from."""

_DRAW_SEED = 0x1EA6
"""Mixed with the seed of a draw, so that it is independent of all other draws of the program."""
_HELD_OUT_OF_ALL = 0.2
"""Share that is held out if all rows of a series are learned from and its authors held none out."""


@dataclass(frozen=True)
class Series:
    """One measured series.

    Attributes
    ----------
    title : str
    folder : str
        Its folder below the data, and the stem of its profile.
    bars_mm : mapping
        Number of rows to learn from -> largest allowed mean over draws of discovery's mean held-out position error.
    bars_mrad : mapping
        The same for the mean held-out orientation error [mrad].
    published_mm : float, optional
        Mean position error that the authors of the data published for their held-out rows.
    published_how : str
        How the authors reached it.
    """

    title: str
    folder: str
    bars_mm: Mapping[Rows, float] = field(default_factory=dict)
    published_mm: float | None = None
    published_how: str = ""
    bars_mrad: Mapping[Rows, float] = field(default_factory=dict)


_JACOBI = "20 random poses, D-H calibration and a graph neural network learned from all 1000 poses on the grid"

SERIES: Mapping[str, Series] = {
    "C": Series("UR10, series C", "ur10-real", {300: 0.091}),
    "D": Series("UR10, series D", "ur10-real-d", {300: 0.101}),
    "UR5": Series("UR5", "ur5-real", {300: 0.053, "all": 0.055}, 0.155, _JACOBI),
    "D6": Series("UR10, series D with orientations", "ur10-6d", {300: 0.100}, bars_mrad={300: 0.225}),
}


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
class DrawnRows:
    """Rows to learn from, and the held-out rows by group; the first group is all of them."""

    learned: NDArray[np.intp]
    held_out: Mapping[Group, NDArray[np.intp]]

    @property
    def judged(self) -> NDArray[np.intp]:
        """All held-out rows."""
        return next(iter(self.held_out.values()))

    def split(self, readings: Readings) -> Readings:
        """Return the readings with their splits: rows to learn from, and held-out rows."""
        words = np.full(len(readings), None, dtype=object)
        words[self.learned], words[self.judged] = "identify", "validate"
        return replace(readings, split=tuple(words.tolist()))


class SeriesText(Record):
    """A measured series as text, for workers that do not see its files: its profile, and its readings as CSV."""

    profile: Profile
    csv: str


class SeriesTexts(Record):
    """Measured series by name."""

    series: Mapping[str, SeriesText]


def load_entrant(name: str, data: Path, profiles: Path) -> Entrant:
    """Read a series and its profile.

    Raises
    ------
    InputError
        If there is no such series, or its files are missing or not as expected.
    """
    profile, csv = _files(name, data, profiles)
    return _entrant(name, profile, csv)


def series_texts(names: Sequence[str], data: Path, profiles: Path) -> SeriesTexts:
    """Return the texts of some series. Raises ``InputError`` as ``load_entrant`` does."""
    texts = {}
    for name in dict.fromkeys(names):
        profile, csv = _files(name, data, profiles)
        texts[name] = SeriesText(profile=profile, csv=csv.read_text(encoding="utf-8"))
    return SeriesTexts(series=texts)


def parse_entrants(texts: SeriesTexts) -> dict[str, Entrant]:
    """Return the series with their readings. Raises ``InputError`` if a text is not as expected."""
    entrants = {}
    with TemporaryDirectory() as folder:
        for name, its in texts.series.items():
            csv = Path(folder) / f"{name}.csv"
            csv.write_text(its.csv, encoding="utf-8", newline="")
            entrants[name] = _entrant(name, its.profile, csv)
    return entrants


def _files(name: str, data: Path, profiles: Path) -> tuple[Profile, Path]:
    """Return profile of a series, and the file of its readings."""
    if name not in SERIES:
        raise InputError(f"--series: '{name}' is not a series of the league; series are {', '.join(SERIES)}")
    csv = data / SERIES[name].folder / "readings.csv"
    if not csv.is_file():
        raise InputError(
            f"{csv}: file not found; the measured series stand in tests/fixtures of the project's sources: run this"
            " there, or say with --data where they are"
        )
    return load_profile(profiles / f"{SERIES[name].folder}.yaml"), csv


def _entrant(name: str, profile: Profile, csv: Path) -> Entrant:
    readings, _ = read_readings_csv(
        csv,
        {arm: len(one.type.joints) for arm, one in profile.arms.items()},
        in_order=True,
        limits=joint_limits(profile),
    )
    ((arm, rows),) = readings.items()
    return Entrant(name, profile, arm, rows)


def draw_rows(entrant: Entrant, rows: Rows, seed: int, learnable: int | None = None) -> DrawnRows:
    """Draw the rows to learn from; all others are held out, including those that the authors held out.

    Draws of one seed are nested: more rows include the fewer. The first ``learnable`` rows of the permutation are never
    held out, so that draws of different sizes are judged on the same rows.

    Raises
    ------
    InputError
        If the series has too few rows.
    """
    pool, published = entrant.pool, entrant.readings.in_split("validate")
    order = np.random.default_rng([seed, _DRAW_SEED]).permutation(pool)
    held_out_of_all = 0 if len(published) else round(_HELD_OUT_OF_ALL * len(pool))
    count = len(pool) - held_out_of_all if rows == "all" else rows
    first_held_out = max(count, learnable or 0)
    if first_held_out > len(pool) or (first_held_out == len(pool) and not len(published)):
        raise InputError(
            f"--rows: series {entrant.name} has {counted(len(pool), 'row')} to learn from; ask for fewer than"
            f" {count}, or for all"
        )
    others = np.sort(order[first_held_out:])
    groups: dict[Group, NDArray[np.intp]] = {"all": np.concatenate([others, published])}
    if len(published):
        groups = {**groups, "others": others, "published": published} if len(others) else {"published": published}
    return DrawnRows(np.sort(order[:count]), groups)


def parse_rows(text: str) -> list[Rows]:
    """Parse numbers of rows, or ``all``, separated by commas. Raises ``InputError`` for anything else."""
    sizes: list[Rows] = []
    for word in (word.strip() for word in text.split(",")):
        if word != "all" and not (word.isascii() and word.isdigit() and int(word) > 0):
            raise InputError(f"--rows: expected numbers of rows or 'all', as 100,300,all; got '{word}'")
        sizes.append("all" if word == "all" else int(word))
    return sizes
