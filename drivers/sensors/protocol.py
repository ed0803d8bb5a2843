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
        When it was read, on the cell's clock [s].
    temperature_c : float
        Temperature [degC].
    pressure_hpa : float or None
        Absolute pressure [hPa].
    humidity_percent : float or None
        Relative humidity [%].
    """

    time_s: float
    temperature_c: float
    pressure_hpa: float | None
    humidity_percent: float | None


class SensorError(Exception):
    """Base of all that a sensor can refuse or suffer."""


class SensorLinkLost(SensorError):
    """The sensor no longer answers, or answers what is no reading."""


class AirSensor(Protocol):
    """A weather station: at least a thermometer."""

    def connect(self) -> None:
        """Open the link. Raises ``SensorLinkLost``."""

    def read(self) -> AirReading:
        """The air now; never an old value: raises ``SensorLinkLost`` instead."""

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
