"""Readings of a cell from files, data frames or arrays, all with the same checks as files of readings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from cellapp.cell.run.csv_import import readings_of_table
from cellapp.cell.run.csv_text import CsvTable, read_csv_table
from cellapp.cell.run.stations import require_ties
from cellapp.cell.run.table_in_memory import is_frame, table_of_arrays, table_of_frame
from cellapp.commands.view.parts import Parts
from cellapp.commands.view.table import Column, Table, number_column
from cellapp.estimation.calibration.calibrate import missing_splits
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.columns import COLUMNS
from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.interfaces.python.printed import Printed

if TYPE_CHECKING:
    import pandas as pd

ReadingsLike: TypeAlias = "str | Path | pd.DataFrame | Mapping[str, Mapping[str, Any]] | Mapping[str, Readings]"
"""A CSV file, a data frame with its columns, or arrays by arm; see ``Cell.readings``."""


@dataclass(frozen=True, eq=False, repr=False)
class CellReadings(Printed, Mapping[str, Readings]):
    """Checked readings of a cell: a mapping of each arm of the profile to its ``Readings``.

    Attributes
    ----------
    profile : Profile
    arms : mapping
        Arm -> Readings.
    notes : tuple of str
        Remarks: unknown columns, and what was derived from the order of the rows.
    """

    profile: Profile
    arms: Mapping[str, Readings]
    notes: tuple[str, ...] = ()

    def __getitem__(self, arm: str) -> Readings:
        return self.arms[arm]

    def __iter__(self) -> Iterator[str]:
        return iter(self.arms)

    def __len__(self) -> int:
        return len(self.arms)

    def summary(self) -> str:
        """Return the number of readings of each arm."""
        return ", ".join(
            f"{name}: {counted(len(arm), 'reading')} of {arm.joints} joints" for name, arm in self.arms.items()
        )

    def view(self) -> Parts:
        """Return the content of each arm's readings, and the notes."""
        columns = (Column("arm"), number_column("readings", "d"), number_column("joints", "d"), Column("given"))
        rows = tuple((name, len(arm), arm.joints, ", ".join(_given(arm))) for name, arm in self.arms.items())
        return [Table(f"Readings of {self.profile.name}", columns, rows), *self.notes]

    def frame(self) -> pd.DataFrame:
        """Return one row for each arm and stop, with the columns of a CSV file of readings. Needs pandas."""
        from cellapp.interfaces.python.frames import readings_frame

        return readings_frame(self.arms)

    def with_splits(self) -> tuple[dict[str, Readings], tuple[str, ...]]:
        """Return the readings with a split each, drawn by the profile's seed where missing; and notes on the draw."""
        drawn, notes = missing_splits(self.profile, self.arms)
        return {name: replace(arm, split=drawn.get(name, arm.split)) for name, arm in self.arms.items()}, notes


def checked_readings(profile: Profile, source: ReadingsLike, *, in_order: bool = False) -> CellReadings:
    """Check readings; parameters and errors are those of ``Cell.readings``."""
    if isinstance(source, CellReadings) and not in_order:
        if source.profile == profile:
            return source
        source = source.arms
    readings, _, notes = readings_of_table(profile, _table(profile, source), in_order=in_order)
    require_ties(Path("readings"), readings)
    return CellReadings(profile, readings, tuple(notes))


def _table(profile: Profile, source: object) -> CsvTable:
    if isinstance(source, str | Path):
        return read_csv_table(Path(source))
    if is_frame(source):
        return table_of_frame(source)
    if isinstance(source, Mapping):
        return table_of_arrays(profile, {name: _arrays(arm) for name, arm in source.items()})
    raise InputError(
        "readings: expected the path of a CSV file, a data frame, or arrays by arm as {'left': {'q': q, 'p_M': p_M}},"
        f" got {type(source).__name__}"
    )


def _arrays(arm: Any) -> Any:
    """Return the quantities of one arm by name."""
    return {column.name: getattr(arm, column.name) for column in COLUMNS} if isinstance(arm, Readings) else arm


def _given(arm: Readings) -> list[str]:
    return [column.name for column in COLUMNS if column.is_given(getattr(arm, column.name))]
