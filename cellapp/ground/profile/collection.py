"""The profile's section ``collection``: how stops are measured, what is waited for, when the job ends."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.quantities import CellLength, Length, Temperature, Time
from drivers.settings import Section

CellPoint = tuple[CellLength, CellLength, CellLength]


class Reference(Section):
    """Reference measurements: both arms at home, and fixed nests, every ``every`` stops and at the end; 0: none."""

    every: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    drift: Annotated[Length, Field(gt=0.0, le=0.01)] = 100e-6
    """Largest accepted distance of a reference from its first measurement."""
    nests: dict[str, CellPoint] = Field(default_factory=dict)
    """Fixed nests with an SMR: name -> position in the cell frame C."""


class Repeat(Section):
    """Repetition of a measurement until the standard deviation of its mean is below ``precision``; None: one each."""

    precision: Annotated[Length, Field(gt=0.0, le=0.01)] | None = None
    times: Annotated[int, Field(strict=True, ge=2, le=50)] = 5
    """Most measurements of one SMR at one stop."""


class SlowStart(Section):
    """The first motions on real hardware: their number, and the share of the usual speed."""

    stops: Annotated[int, Field(strict=True, ge=0, le=1000)] = 3
    speed: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 0.2


class Finish(Section):
    """An early end: when the standard uncertainty of predicted positions of every arm is below ``standard_error``."""

    standard_error: Annotated[Length, Field(gt=0.0, le=0.01)] | None = None
    least_stops: Annotated[int, Field(strict=True, ge=10, le=100_000)] = 60


class AirLimits(Section):
    """Air temperatures at which measuring is allowed."""

    temperature: tuple[Temperature, Temperature] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.temperature is not None and self.temperature[0] >= self.temperature[1]:
            raise ValueError("temperature: the lower limit must be below the upper one")
        return self


class Suspension(Section):
    """Waiting for a cause to pass: at most ``times`` in a session, each at most ``wait``. 0 times: never."""

    times: Annotated[int, Field(strict=True, ge=0, le=1000)] = 10
    wait: Annotated[Time, Field(gt=0.0, le=86_400.0)] = 20.0
    retry: Annotated[Time, Field(gt=0.0, le=3600.0)] = 2.0
    """Time between two tries."""


class Suspend(Section):
    """Causes that are no danger and for which collection waits and continues by itself.

    Faults of an arm and safety stops are not here: they always need a person.
    """

    target: Suspension = Suspension()
    """The beam is broken, or no SMR is found where one should be."""
    air: Suspension = Suspension(times=10, wait=1800.0, retry=30.0)
    """The air is out of ``air.temperature``."""
    drift: Suspension = Suspension(times=5, wait=600.0, retry=60.0)
    """A reference measurement is out of ``reference.drift``."""
    tracker_warm_up: Suspension = Suspension(times=0, wait=3600.0, retry=10.0)
    """The tracker is not ready to measure: it warms up, or lacks something that a person must do. Opt-in."""
    host_stall: Suspension = Suspension(times=0, wait=30.0, retry=1.0)
    """This computer was silent, so that a controller's watchdog stopped its arm. Opt-in."""


class Collection(Section):
    """How planned stops are measured."""

    reference: Reference = Reference()
    warm_up: Annotated[Time, Field(ge=0.0, le=14_400.0)] = 0.0
    """The arms exercise along planned stops for this time before the first measurement."""
    repeat: Repeat = Repeat()
    slow_start: SlowStart = SlowStart()
    finish: Finish = Finish()
    air: AirLimits = AirLimits()
    suspend: Suspend = Suspend()
    motion_rate: Annotated[float, Field(strict=True, ge=5.0, le=1000.0)] = 250.0
    """Points of the tracker in a second while an arm sweeps [1/s]; a serial line carries 150."""
    tolerated: Annotated[float, Field(strict=True, ge=0.0, le=1.0)] = 0.05
    """Share of planned measurements that may be missing at the end without a failure."""
