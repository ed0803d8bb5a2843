"""Python access to a cell: its profile, readings that are checked against it, and the calibration with both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellapp.cell.profile import load_profile, profile_from_dict
from cellapp.commands.calibrate.run import calibrate_cell
from cellapp.commands.doctor.view import profile_tables
from cellapp.commands.view.parts import Parts
from cellapp.ground.profile import Profile
from cellapp.ground.progress import CancelToken, Listener, ignore
from cellapp.interfaces.python.fitted import Calibration
from cellapp.interfaces.python.printed import Printed
from cellapp.interfaces.python.readings import CellReadings, ReadingsLike, checked_readings


@dataclass(frozen=True, repr=False)
class Cell(Printed):
    """A robot cell as its profile describes it: one or more arms and a laser tracker.

    None of its methods moves an arm or writes a file.
    """

    profile: Profile

    @classmethod
    def load(cls, path: Path | str) -> Cell:
        """Load the cell of a YAML profile. Raises ``InputError`` with file, line and key of what is wrong."""
        return cls(load_profile(Path(path)))

    @classmethod
    def from_dict(cls, profile: Mapping[str, Any], folder: Path | str = ".") -> Cell:
        """Create the cell of a profile given as a mapping; paths in it are relative to ``folder``.

        Raises ``InputError`` with the key of what is wrong.
        """
        return cls(profile_from_dict(profile, Path(folder)))

    def readings(self, source: ReadingsLike, *, in_order: bool = False) -> CellReadings:
        """Check readings of this cell.

        Parameters
        ----------
        source
            The path of a CSV file; a data frame with its columns (``configuration``, ``arm``, ``q1`` ... [rad],
            ``x_m``, ``y_m``, ``z_m``, and optional ones); or for each arm its quantities as arrays, with the names,
            shapes and units of ``Readings``: ``{"left": {"q": (n, N) [rad], "p_M": (n, 3) [m], "sigma_m": 5e-6}}``. A
            single number stands for n equal ones. Without ``configuration`` (n,), row k of every arm is stop k.
        in_order : bool
            Whether the rows of an arm are in the order of measurement: missing approach and step are then derived from
            the previous row.

        Raises
        ------
        InputError
            Names the row and the quantity that is missing, not a number, implausible (degrees, millimetres) or of
            another shape; and arms that are not in the profile, or have no readings.
        """
        return checked_readings(self.profile, source, in_order=in_order)

    def calibrate(
        self,
        readings: ReadingsLike,
        listener: Listener = ignore,
        cancel: CancelToken | None = None,
        *,
        in_order: bool = False,
    ) -> Calibration:
        """Identify every arm, its residual network and the transform between the bases, as ``cellapp calibrate`` does.

        Parameters
        ----------
        readings, in_order
            As for ``readings``. Readings without a split get one by the profile's seed.
        listener : callable
            Receives progress events.
        cancel : CancelToken, optional

        Raises
        ------
        InputError
            As ``readings`` does, and if an arm has too few of them.
        Cancelled
            If ``cancel`` requests it.
        """
        checked = self.readings(readings, in_order=in_order)
        split, notes = checked.with_splits()
        result, model = calibrate_cell(self.profile, split, listener, cancel, notes=notes)
        return Calibration(self.profile, split, model, result)

    def summary(self) -> str:
        """Return the name of the cell, its arms and their types."""
        arms = ", ".join(f"{name} {arm.type.model}" for name, arm in self.profile.arms.items())
        return f"{self.profile.name}: {arms}"

    def view(self) -> Parts:
        """Return arms, tracker and plan as tables, one quantity per row."""
        return profile_tables(self.profile)
