"""Result of ``touch``."""

from __future__ import annotations

from cellapp.ground.results import Record, Result


class TouchedPoint(Record):
    """The touches of one socket.

    Attributes
    ----------
    point : str
    touches : int
    worst_mm : float or None
        How far a touch lies at most from the median of the others by the published arm; None for a single one.
    turned_deg : tuple of float
        Range of each joint over the touches.
    """

    point: str
    touches: int
    worst_mm: float | None
    turned_deg: tuple[float, ...]


class RecordedTouch(Record):
    """A touch that was recorded now."""

    configuration: int
    point: str


class TouchResult(Result, schema="cellapp-touch"):
    """``touch``: touches that were recorded now, and all of the arm, by socket.

    ``refused`` says why nothing was recorded; empty where something was, or nothing was asked for.
    """

    run: str
    arm: str
    recorded: tuple[RecordedTouch, ...] = ()
    points: tuple[TouchedPoint, ...] = ()
    notes: tuple[str, ...] = ()
    refused: str = ""
