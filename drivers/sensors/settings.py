"""Interface of every kind of weather station: settings, how it is opened and how it is probed."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from drivers.findings import Finding
from drivers.settings import Section

if TYPE_CHECKING:
    from drivers.plant import Plant
    from drivers.sensors.protocol import AirSensor


class AirSensorSettings(Section):
    """Base of the settings of every kind of weather station."""

    kind: str
    needs_plant: ClassVar[bool] = False
    """Whether the station belongs to the simulated cell."""

    @abstractmethod
    def open(self, plant: Plant | None) -> AirSensor:
        """Create the driver, not connected yet; ``plant`` is the simulated cell, if any. Raises ``SettingError``."""

    @abstractmethod
    def probe(self) -> Sequence[Finding]:
        """Take one reading."""
