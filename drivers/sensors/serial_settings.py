"""The kind ``serial``: a weather station over any pyserial URL, one line per reading."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.findings import DeviceReport, Finding
from drivers.quantities import Time
from drivers.sensors.settings import AirSensorSettings
from drivers.settings import Section

if TYPE_CHECKING:
    from drivers.plant import Plant
    from drivers.sensors.protocol import AirSensor

_SCHEMES = ("socket", "rfc2217", "loop", "spy", "alt", "hwgrep")


class SensorUnits(Section):
    """Units of a line that does not name them."""

    temperature: Literal["degC", "degF", "K"] = "degC"
    object_temperature: Literal["degC", "degF", "K"] = "degC"
    pressure: Literal["hPa", "mbar", "kPa", "Pa", "bar", "mmHg", "inHg", "psi"] = "hPa"
    humidity: Literal["%"] = "%"


class SerialStationSettings(AirSensorSettings):
    """A weather station with a known ``format``, or with a ``pattern`` that describes its lines.

    The pattern must match the whole line. Its named groups are ``temperature`` and optionally ``pressure``,
    ``humidity``, ``object_temperature``; a group with the suffix ``_unit`` catches the unit that the line names.
    """

    kind: Literal["serial"] = "serial"
    url: Annotated[str, Field(min_length=1)]
    format: Literal["vaisala-ptu300"] | None = None
    pattern: str | None = None
    units: SensorUnits = SensorUnits()
    poll: str | None = None
    """Text that requests a line, line end included; "" for a station that sends by itself; None: the format's."""
    poll_interval: Annotated[Time, Field(ge=0.1, le=3600.0)] = 5.0
    baud: Annotated[int, Field(strict=True, ge=50, le=4_000_000)] | None = None
    framing: Annotated[str, Field(pattern=r"^[5-8][NEO][12]$")] | None = None
    max_age: Annotated[Time, Field(gt=0.0, le=3600.0)] = 60.0
    timeout: Annotated[Time, Field(gt=0.0, le=60.0)] = 5.0
    """Longest wait for a first reading; must exceed the interval between lines of a station that sends by itself."""

    @field_validator("url")
    @classmethod
    def _known_scheme(cls, value: str) -> str:
        scheme, found, _ = value.partition("://")
        if found and scheme not in _SCHEMES:
            known = ", ".join(f"{name}://" for name in _SCHEMES)
            raise ValueError(f"'{scheme}://' is not known; write a device such as /dev/ttyUSB0 or COM3, or {known}")
        return value

    @model_validator(mode="after")
    def _one_format(self) -> Self:
        if (self.format is None) == (self.pattern is None):
            raise ValueError("format: give either format or pattern")
        if self.pattern is not None:
            _check_pattern(self.pattern)
        return self

    def open(self, plant: Plant | None) -> AirSensor:
        """Create the driver, not connected yet."""
        from drivers.sensors.serial_station import PRESETS, LineFormat, SerialStation

        layout = PRESETS[self.format] if self.format else LineFormat(self.pattern or "")
        layout = replace(layout, units=self.units.model_dump())
        if self.poll is not None:
            layout = replace(layout, poll=self.poll.encode())
        return SerialStation(
            self.url,
            layout,
            baud=self.baud,
            framing=self.framing,
            max_age_s=self.max_age,
            poll_every_s=self.poll_interval,
            timeout_s=self.timeout,
        )

    def probe(self) -> list[Finding]:
        """Connect and take one reading, within ``timeout``."""
        from drivers.sensors.protocol import SensorError

        station = self.open(None)
        try:
            station.connect()
            air = station.read()
            report = DeviceReport(
                air_c=air.temperature_c, pressure_hpa=air.pressure_hpa, humidity_percent=air.humidity_percent
            )
            return [Finding("", "ok", f"{self.url}: {air}", report)]
        except SensorError as error:
            return [Finding("", "failed", str(error))]
        finally:
            station.disconnect()


def _check_pattern(pattern: str) -> None:
    try:
        groups = set(re.compile(pattern).groupindex)
    except re.error as error:
        raise ValueError(f"pattern: not a regular expression: {error}") from None
    known = {name + suffix for name in SensorUnits.model_fields for suffix in ("", "_unit")}
    if "temperature" not in groups:
        raise ValueError("pattern: it has no group (?P<temperature>...)")
    if groups - known:
        unknown = ", ".join(sorted(groups - known))
        raise ValueError(f"pattern: group {unknown} is not known; known are {', '.join(sorted(known))}")
