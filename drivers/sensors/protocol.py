"""What a sensor of the surroundings must do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class AirReading:
    """The air at one moment; None where the sensor does not measure it.

    Attributes
    ----------
    time_s : float
        When it was read, on the clock of the driver [s]: the plant's in simulation, else this computer's monotonic one.
    temperature_c : float
        Temperature [degC].
    pressure_hpa : float or None
        Absolute pressure [hPa].
    humidity_percent : float or None
        Relative humidity [%].
    object_temperature_c : float or None
        Temperature of what a contact probe of the same station is fixed to [degC].
    age_s : float
        How long ago it was read when it was handed over [s].
    """

    time_s: float
    temperature_c: float
    pressure_hpa: float | None
    humidity_percent: float | None
    object_temperature_c: float | None = None
    age_s: float = 0.0

    def __str__(self) -> str:
        """For eyes: "air 21.4 degC, 1013.2 hPa, 38 %, object 22.0 degC, 3 s old"."""
        parts = [f"air {self.temperature_c:.1f} degC"]
        if self.pressure_hpa is not None:
            parts.append(f"{self.pressure_hpa:.1f} hPa")
        if self.humidity_percent is not None:
            parts.append(f"{self.humidity_percent:.0f} %")
        if self.object_temperature_c is not None:
            parts.append(f"object {self.object_temperature_c:.1f} degC")
        return ", ".join([*parts, f"{self.age_s:.0f} s old"])


class SensorError(Exception):
    """Base of all that a sensor can refuse or suffer."""


class SensorLinkLost(SensorError):
    """The sensor no longer answers, or answers what is no reading."""


class StaleReading(SensorLinkLost):
    """There is a reading, but it is too old to stand for the air now."""


class AirSensor(Protocol):
    """A weather station: at least a thermometer."""

    def connect(self) -> None:
        """Open the link. Raises ``SensorLinkLost``."""

    def read(self) -> AirReading:
        """The air now; never an old value: raises ``SensorLinkLost`` or ``StaleReading`` instead."""

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
