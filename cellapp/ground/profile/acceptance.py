"""The profile's sections ``tolerances`` and ``traceability``: what a cell is accepted by, who measured it with what."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import date
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from cellapp.ground.profile.grown import GrownSection
from cellapp.ground.results import DecisionRule
from drivers.quantities import Angle, Length
from drivers.settings import Section

MpeRule = Literal["rectangular", "half"]
"""The standard uncertainty that a maximum permissible error stands for: ``rectangular`` takes any error up to it as
equally likely, MPE / sqrt 3 (JCGM 100, 4.3.7); ``half`` is MPE / 2, for who knows that errors are mostly smaller."""
MPE_SHARE: Mapping[MpeRule, float] = {"rectangular": 1.0 / math.sqrt(3.0), "half": 0.5}

Tolerance = Annotated[Length, Field(gt=0.0, le=0.1)]


def _span_of(value: object) -> object:
    """One number stands for a quantity that did not change."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if isinstance(value, str | bool):
        raise ValueError(f"expected a number, or the smallest and the largest in brackets, got {value!r}")
    return value


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError(f"expected the smaller value first, got {span[0]:g} and {span[1]:g}")
    return span


Pressure = Annotated[float, Field(strict=True, ge=300.0, le=1200.0)]
Humidity = Annotated[float, Field(strict=True, ge=0.0, le=100.0)]
PressureSpan = Annotated[tuple[Pressure, Pressure], BeforeValidator(_span_of), AfterValidator(_in_order)]
"""Smallest and largest absolute pressure [hPa]."""
HumiditySpan = Annotated[tuple[Humidity, Humidity], BeforeValidator(_span_of), AfterValidator(_in_order)]
"""Smallest and largest relative humidity [%]."""


class Tolerances(GrownSection):
    """Largest permissible errors of a cell; what is left out is not judged.

    ``position`` is the distance of an arm's SMR from where it was commanded, at any target; ``orientation`` the angle
    of its flange from the wanted rotation, where a probe measures that; ``distance`` the error of the distance between
    two positions of one arm; ``cooperative`` the error of the distance between the SMRs of two
    arms. The others are the characteristics of ISO 9283. ``decision`` and ``mpe`` say how all of them are judged, and
    the tolerances of targets and paths.
    """

    position: Tolerance | None = None
    orientation: Annotated[Angle, Field(gt=0.0, le=0.02)] | None = None
    distance: Tolerance | None = None
    cooperative: Tolerance | None = None
    pose_accuracy: Tolerance | None = None
    pose_repeatability: Tolerance | None = None
    multidirectional: Tolerance | None = None
    distance_accuracy: Tolerance | None = None
    distance_repeatability: Tolerance | None = None
    drift: Tolerance | None = None
    path_accuracy: Tolerance | None = None
    path_repeatability: Tolerance | None = None
    decision: DecisionRule = "guarded"
    mpe: MpeRule = "rectangular"

    later_keys = frozenset({"mpe", "orientation"})

    @property
    def covariance_factor(self) -> float:
        """Factor for a tracker's covariance: drivers take half of the maximum permissible error as sigma."""
        return (MPE_SHARE[self.mpe] / MPE_SHARE["half"]) ** 2

    @property
    def any_given(self) -> bool:
        """Whether anything is judged."""
        rules = ("decision", "mpe")
        return any(getattr(self, name) is not None for name in type(self).model_fields if name not in rules)


class Instrument(Section):
    """A measuring instrument or standard as its calibration certificate describes it."""

    model: str = ""
    serial: str = ""
    calibrated: date | None = None
    due: date | None = None
    certificate: str = ""
    """Number of its calibration certificate, and the laboratory."""

    @model_validator(mode="after")
    def _dates_in_order(self) -> Self:
        if self.calibrated is not None and self.due is not None and self.due <= self.calibrated:
            raise ValueError(f"due: {self.due} is not after 'calibrated' ({self.calibrated})")
        return self


class TraceableArm(Section):
    """What identifies an arm that its controller does not tell: serial number of the arm itself, name in the plant."""

    serial: str = ""
    asset: str = ""


class Traceability(GrownSection):
    """Who measured with what, for certificates. What is left out is reported as not given, never assumed.

    ``client`` is for whom the certificate is made, with the address; ``procedure`` the written procedure of the
    organisation by which one measured, with its revision. ``air_pressure`` [hPa] and ``relative_humidity`` [%] are
    those while measuring: a number, or the smallest and the largest. ``smr_centering`` is the standard uncertainty of
    the SMR's optical centre in its sphere and nest, ``air_temperature_uncertainty`` that of the air temperature along
    the beam.
    """

    later_keys = frozenset({"client", "procedure", "air_pressure", "relative_humidity"})

    organisation: str = ""
    location: str = ""
    operator: str = ""
    client: str = ""
    procedure: str = ""
    tracker: Instrument = Instrument()
    smr: Mapping[str, Instrument] = {}
    """By arm."""
    instruments: Mapping[str, Instrument] = {}
    """Further ones by name, as a thermometer or a reference bar."""
    arms: Mapping[str, TraceableArm] = {}
    air_pressure: PressureSpan | None = None
    relative_humidity: HumiditySpan | None = None
    smr_centering: Annotated[Length, Field(gt=0.0, le=1e-3)] | None = None
    air_temperature_uncertainty: Annotated[float, Field(strict=True, gt=0.0, le=20.0)] | None = None
    """Kelvin."""
