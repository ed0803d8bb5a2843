"""Interface of an air sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class AirReading:
    """State of the air at one moment; None if not measured.

    Attributes
    ----------
    time_s : float
        Time of the reading on the driver's clock [s]: the plant's in simulation, otherwise ``time.monotonic``.
    temperature_c : float
        Temperature [degC].
    pressure_hpa : float or None
        Absolute pressure [hPa].
    humidity_percent : float or None
        Relative humidity [%].
    object_temperature_c : float or None
        Temperature of an object, from a contact probe of the same station [degC].
    age_s : float
        Age of the reading when it was returned [s].
    """

    time_s: float
    temperature_c: float
    pressure_hpa: float | None
    humidity_percent: float | None
    object_temperature_c: float | None = None
    age_s: float = 0.0

    def __str__(self) -> str:
        """Format for people: "air 21.4 degC, 1013.2 hPa, 38 %, object 22.0 degC, 3 s old"."""
        parts = [f"air {self.temperature_c:.1f} degC"]
        if self.pressure_hpa is not None:
            parts.append(f"{self.pressure_hpa:.1f} hPa")
        if self.humidity_percent is not None:
            parts.append(f"{self.humidity_percent:.0f} %")
        if self.object_temperature_c is not None:
            parts.append(f"object {self.object_temperature_c:.1f} degC")
        return ", ".join([*parts, f"{self.age_s:.0f} s old"])


class SensorError(Exception):
    """Base of all errors of a sensor."""


class SensorLinkLost(SensorError):
    """The sensor does not answer, or its answers are not readings."""


class StaleReading(SensorLinkLost):
    """The newest reading is too old to represent the current air."""


class AirSensor(Protocol):
    """A weather station: at least a thermometer."""

    def connect(self) -> None:
        """Open the link. Raises ``SensorLinkLost``."""

    def read(self) -> AirReading:
        """Return the current air, never an old value. Raises ``SensorLinkLost`` or ``StaleReading``."""

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
