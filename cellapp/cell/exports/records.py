"""Results of ``export``: the files that were written, and what they cannot hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from cellapp.ground.results import Record, Result


class PositionLoss(Record):
    """Position error of the SMR [mm] over the workspace where a part of the model is left out.

    ``rms_mrad`` and ``max_mrad`` are of the flange's rotation, where readings had orientations.
    """

    rms_mm: float
    max_mm: float
    rms_mrad: float | None = None
    max_mrad: float | None = None
    omitted_when_none = frozenset({"rms_mrad", "max_mrad"})

    @property
    def words(self) -> str:
        """As ``0.112 mm rms, 0.310 mm at most``."""
        turned = ""
        if self.rms_mrad is not None and self.max_mrad is not None:
            turned = f"; {self.rms_mrad:.3f} mrad rms, {self.max_mrad:.3f} mrad at most"
        return f"{self.rms_mm:.3f} mm rms, {self.max_mm:.3f} mm at most{turned}"


class ArmFile(Record):
    """One arm in a file of another program.

    Attributes
    ----------
    file : str
    smr_m : three numbers
        SMR centre in the last frame that the file describes [m].
    conversion_mm : float
        Largest distance between SMR positions by the numbers of the file and by the model's geometry.
    lost : mapping
        What the file cannot hold, effect by effect; ``residual_network`` is the network.
    lost_together : PositionLoss or None
        All of that together; None if the model is geometry alone.
    """

    file: str
    smr_m: tuple[float, float, float]
    conversion_mm: float
    lost: Mapping[str, PositionLoss]
    lost_together: PositionLoss | None = None


class CommandFile(Record):
    """The commands of one arm in a file: how many it has, and how many targets have none in it."""

    file: str
    commands: int
    refused: int


class ExportResult(Result, schema="cellapp-export"):
    """``export``: the files that were written.

    ``arms`` maps the arms to their files in ``format``, ``commands`` to files of their commands.
    """

    csv: str | None = None
    readings: Mapping[str, int] | None = None
    recordings: Mapping[Literal["joints", "points"], str] | None = None
    plan: str | None = None
    format: str | None = None
    arms: Mapping[str, ArmFile] | None = None
    commands: Mapping[str, CommandFile] | None = None
    notes: tuple[str, ...] = ()
    omitted_when_none = frozenset({"csv", "readings", "recordings", "plan", "format", "arms", "commands"})
