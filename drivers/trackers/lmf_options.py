"""Profile options of a tracker of the kind ``lmf``: all settings that its driver reads."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from drivers.quantities import CellLength, Length, Temperature, Time
from drivers.settings import Section
from drivers.trackers.settings import TrackerSettings

DEFAULT_LIBRARY = "LMF.Tracker.Connection"
_SIMULATOR = re.compile(r"(AT930|AT960|AT40[123]|AT500|ATS600)[A-Z]{0,3}Simulator(#\d+)?", re.IGNORECASE)


class Air(Section):
    """Air that the tracker corrects the refraction for, instead of what its own station measures."""

    temperature: Annotated[Temperature, Field(ge=-40.0, le=85.0)]
    pressure_hpa: Annotated[float, Field(strict=True, ge=500.0, le=1200.0)]
    humidity_percent: Annotated[float, Field(strict=True, ge=0.0, le=100.0)]


class LmfOptions(TrackerSettings):
    """Settings of LMF and the tracker that it controls. Lengths [m], times [s]."""

    kind: Literal["lmf"] = "lmf"
    address: Annotated[str, Field(min_length=1)]
    """IP address or host name, or one of LMF's simulators such as AT960LRSimulator#1."""
    serial: str | None = None
    """Serial number that the tracker must have; compared at each connect."""
    reflector: Annotated[str, Field(max_length=60)] = ""
    """The reflector type as LMF names it, or its class such as RedRingReflector15; empty: what is selected there."""
    probes: Annotated[bool, Field(strict=True)] = False
    """A 6-D probe, as a T-Mac, may be where an SMR is expected: LMF knows it by itself and measures its rotation."""
    accuracy: Literal["fast", "standard", "precise"] = "standard"
    air: Air | None = None
    library: Annotated[str, Field(min_length=1)] = DEFAULT_LIBRARY
    """Path of LMF.Tracker.Connection.dll, or its bare name if Python's path finds it."""
    stationary: Literal["accuracy", "time"] = "accuracy"
    """Who decides the averaging time: the tracker by ``accuracy``, or the caller (``tracker.averaging``)."""
    power_lock: Annotated[bool, Field(strict=True)] = True
    """Search with the camera; otherwise in a spiral around the prediction, which is slower and stays nearer to it."""
    search_radius: Annotated[CellLength, Field(gt=0.0)] | None = None
    """Radius of a search; None leaves LMF's."""
    wrong_target: Annotated[CellLength, Field(gt=0.0, le=1.0)] = 0.05
    """Largest distance of an SMR from its prediction."""
    shaking: Annotated[Length, Field(gt=0.0, le=0.01)] = 100e-6
    """An SMR counts as moving if the tracker reports a worse precision."""
    gravity: Annotated[bool, Field(strict=True)] = False
    """Level the tracker: M's z axis is the vertical and tilt is monitored. Otherwise M is fixed to the tracker."""
    target_words: tuple[str, ...] = ("target", "reflector")
    """Words by which LMF's preconditions report that no target is locked; before pointing this is accepted."""
    lost_numbers: tuple[Annotated[int, Field(strict=True)], ...] = (840702,)
    """LMF's error numbers of a lost target. Leica publishes no list; this one is from another project's log."""
    timeout: Annotated[Time, Field(gt=0.0, le=120.0)] = 15.0
    """Time limit of commands for which Leica recommends none; includes pointing and searching."""

    @field_validator("address")
    @classmethod
    def _known_simulator(cls, value: str) -> str:
        if "simulator" in value.casefold() and _SIMULATOR.fullmatch(value) is None:
            raise ValueError(
                f"'{value}' is not a simulator of LMF; their names are like AT960LRSimulator or AT960Simulator#506432"
            )
        return value

    @property
    def simulated(self) -> bool:
        """Whether the address is one of LMF's simulators."""
        return _SIMULATOR.fullmatch(self.address) is not None
