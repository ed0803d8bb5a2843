"""Records of the contents of a run: what its order of measurement gave, missing readings, references."""

from __future__ import annotations

from typing import Literal

from cellapp.ground.results import Record


class ReferenceDrift(Record):
    """A reference measurement: distance from the first one of the same name, after a number of stops."""

    name: str
    stops_done: int
    drift_mm: float


class ArmOrder(Record):
    """What an import in order of measurement derived for one arm.

    Attributes
    ----------
    by : str
        What gave the order: the rows, the column ``sequence``, or the times.
    approach, step : int
        Approach signs and steps of single joints that were derived from the reading before.
    contradicted : int
        Given approach signs that contradict the motion from the reading before; the steps there are unknown.
    """

    by: Literal["rows", "sequence", "time"]
    approach: int
    step: int
    contradicted: int = 0


class StreamState(Record):
    """The stamps of one stream: how many, how often, and where its clock is not steady.

    Attributes
    ----------
    n : int
        Samples or points.
    seconds : float
        From the first stamp to the last one.
    rate_hz : float
        One over the median step of the stamps.
    gaps, longest_gap_s
        Steps of more than 2.5 times the median one, and the longest of them.
    repeats, backward : int
        Stamps that are the same as the one before, and stamps before it.
    lost : int
        Rows of points without coordinates: the beam was lost there. They are not kept.
    """

    n: int
    seconds: float
    rate_hz: float
    gaps: int = 0
    longest_gap_s: float = 0.0
    repeats: int = 0
    backward: int = 0
    lost: int = 0


class RecordingState(Record):
    """A recording of motion in a run; ``unknown`` are columns that are kept and not used.

    Recordings of one arm with the same ``session`` were made without a pause of the devices: their clocks are the same.
    ``part_of`` names the planned sweep of which this is a part, ``reached_s`` is the time of its motion at which the
    beam broke [s]; None where it did not.
    """

    name: str
    arm: str
    session: str = ""
    part_of: str = ""
    reached_s: float | None = None
    joints: StreamState
    points: StreamState
    optional: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
