"""What is watched while stops are measured: the air, and the model that is refitted after each stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from drivers.sensors.protocol import AirReading, AirSensor, SensorError

Note = Callable[[str, str], None]
"""Takes a level of the log ("info", "warning") and a sentence."""


@dataclass
class AirTemperature:
    """Air temperature from the weather station; None while it fails, which is noted once.

    The tracker's own sensor is no substitute: a change of sensor would look like a change of the air.
    """

    sensor: AirSensor
    note: Note
    state: Literal["new", "working", "failed"] = "new"

    def at_stop(self, stop: int) -> float | None:
        """Read the air temperature [degC]."""
        reading = self._read(stop)
        return None if reading is None else reading.temperature_c

    def _read(self, stop: int) -> AirReading | None:
        try:
            reading = self.sensor.read()
        except SensorError as error:
            if self.state != "failed":
                self.note("warning", f"stop {stop + 1}: readings go without air temperature: {error}")
            self.state = "failed"
            return None
        if self.state != "working":
            self.note("info", f"stop {stop + 1}: {reading}")
        self.state = "working"
        return reading
