"""Driver of a weather station that sends lines over any pyserial URL (serial port, serial server, socket).

A thread reads while the station is connected, so every line gets its arrival time; it reopens a lost link. ``read``
returns the newest reading with its age, or raises an error with the cause.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import serial

from drivers.sensors.protocol import AirReading, SensorLinkLost, StaleReading

FIELDS = ("temperature", "pressure", "humidity", "object_temperature")
"""Allowed group names in a pattern, each also with the suffix ``_unit``."""
LONGEST_LINE = 512

_READ_TIMEOUT_S = 0.1
_REOPEN_S = 2.0
_JOIN_S = 5.0
_LINE_END = re.compile(rb"[\r\n]+")
_BITS = {"5": serial.FIVEBITS, "6": serial.SIXBITS, "7": serial.SEVENBITS, "8": serial.EIGHTBITS}
_PARITIES = {"N": serial.PARITY_NONE, "E": serial.PARITY_EVEN, "O": serial.PARITY_ODD}
_STOPS = {"1": serial.STOPBITS_ONE, "2": serial.STOPBITS_TWO}
_FRAMING = re.compile(r"([5-8])([NEO])([12])")

# Factor and offset to degC, hPa and %. Names of units without blanks, quotes, degree signs and capitals.
_TEMPERATURES = {"c": (1.0, 0.0), "degc": (1.0, 0.0), "f": (5 / 9, -160 / 9), "degf": (5 / 9, -160 / 9),
                 "k": (1.0, -273.15)}  # fmt: skip
_PRESSURES = {
    "hpa": (1.0, 0.0),
    "mbar": (1.0, 0.0),
    "mb": (1.0, 0.0),
    "pa": (0.01, 0.0),
    "kpa": (10.0, 0.0),
    "bar": (1000.0, 0.0),
    "mmhg": (1.33322387415, 0.0),
    "torr": (1.33322368421, 0.0),
    "inhg": (33.8638866667, 0.0),
    "psi": (68.9475729318, 0.0),
    "psia": (68.9475729318, 0.0),
}
_HUMIDITIES = {"%rh": (1.0, 0.0), "%": (1.0, 0.0)}
_UNITS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "temperature": _TEMPERATURES,
    "object_temperature": _TEMPERATURES,
    "pressure": _PRESSURES,
    "humidity": _HUMIDITIES,
}
_DEFAULT_UNITS = {"temperature": "degC", "object_temperature": "degC", "pressure": "hPa", "humidity": "%"}
# Narrow on purpose: 293 K, 68 degF, 1.013 bar or 29.9 inHg misread as degC and hPa fall outside.
_PLAUSIBLE = {
    "temperature": (-10.0, 50.0),
    "object_temperature": (-10.0, 60.0),
    "pressure": (500.0, 1100.0),
    "humidity": (0.0, 100.0),
}
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_NOT_IN_UNIT = re.compile(r"[\s'’°º�]")


@dataclass(frozen=True)
class LineFormat:
    """Format of a station's lines, and how to request one. ``SerialStationSettings`` checks one of a profile.

    Attributes
    ----------
    pattern : str
        Regular expression that matches a whole line, with groups named as in ``FIELDS``; ``temperature`` is required.
        A group such as ``pressure_unit`` takes the unit from the line.
    units : mapping of str to str
        Unit of each field if the line contains none; default: degC, hPa, %.
    poll : bytes
        Bytes that request a line; empty for a station that sends unasked.
    baud, framing : int, str
        Factory settings of such stations, framing as in "8N1".
    """

    pattern: str
    units: Mapping[str, str] = field(default_factory=dict)
    poll: bytes = b""
    baud: int = 9600
    framing: str = "8N1"


_VALUE = r"[-+]?[ ]*\d+\.?\d*"
PRESETS: Mapping[str, LineFormat] = MappingProxyType(
    {
        # "P= 1013.2 hPa T= 31.1 'C RH= 38.3 %RH", the quantities in any order, after the prompt. Other output (P1=, dew
        # point) is skipped. A star in place of a number does not match.
        "vaisala-ptu300": LineFormat(
            pattern=(
                rf"(?=(?:.*[\s>])?T=\s*(?P<temperature>{_VALUE})\s*(?P<temperature_unit>'?[CFK])(?:\s|$))"
                rf"(?:(?=(?:.*[\s>])?P=\s*(?P<pressure>{_VALUE})\s*(?P<pressure_unit>[A-Za-z]+)(?:\s|$)))?"
                rf"(?:(?=(?:.*[\s>])?RH=\s*(?P<humidity>{_VALUE})\s*(?P<humidity_unit>%RH)(?:\s|$)))?.*"
            ),
            poll=b"send\r\n",
            baud=4800,
            framing="7E1",
        )
    }
)


@dataclass(frozen=True)
class _DatedReading:
    """A reading and the arrival time of its line."""

    values: Mapping[str, float]
    at_s: float


def parse_line(line: str, layout: LineFormat) -> dict[str, float]:
    """Return the fields of a line in degC, hPa and %; empty if the line does not match the pattern.

    Raises
    ------
    ValueError
        If the line matches, but a unit is unknown or a value is not plausible.
    """
    match = re.fullmatch(layout.pattern, line)
    if match is None:
        return {}
    texts = match.groupdict()
    values = {}
    for name in FIELDS:
        text = texts.get(name)
        if text is None:
            continue
        bare = text.replace(" ", "")
        if _NUMBER.fullmatch(bare) is None:
            raise ValueError(f"{name} is '{text}', which is not a number")
        unit = texts.get(f"{name}_unit") or layout.units.get(name) or _DEFAULT_UNITS[name]
        if _normalised(unit) not in _UNITS[name]:
            raise ValueError(f"{name} has the unit '{unit}'; known are {', '.join(_UNITS[name])}")
        factor, offset = _UNITS[name][_normalised(unit)]
        value = float(bare) * factor + offset
        low, high = _PLAUSIBLE[name]
        if not low <= value <= high:
            raise ValueError(
                f"{name} is {value:g} {_DEFAULT_UNITS[name]}, which is not between {low:g} and {high:g}: is it in"
                f" another unit than {unit}?"
            )
        values[name] = value
    if "temperature" not in values:
        raise ValueError("it contains no temperature")
    return values


def _normalised(unit: str) -> str:
    return _NOT_IN_UNIT.sub("", unit).casefold()


class SerialStation:
    """A weather station over any pyserial URL: a device, ``socket://``, ``rfc2217://``, ``loop://``."""

    def __init__(
        self,
        url: str,
        layout: LineFormat,
        *,
        baud: int | None = None,
        framing: str | None = None,
        max_age_s: float = 60.0,
        poll_every_s: float = 5.0,
        timeout_s: float = 5.0,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Configure the driver; nothing is opened yet.

        ``baud`` and ``framing`` replace those of ``layout``. Readings older than ``max_age_s`` are refused. A polled
        station is polled every ``poll_every_s``. ``read`` waits ``timeout_s`` for a fresh reading. Raises
        ``ValueError`` for an invalid framing.
        """
        match = _FRAMING.fullmatch((framing or layout.framing).upper())
        if match is None:
            raise ValueError(f"framing must be data bits, parity and stop bits such as 8N1 or 7E1, not {framing!r}")
        self._url, self._layout = url, layout
        self._options: dict[str, object] = {
            "baudrate": baud or layout.baud,
            "bytesize": _BITS[match[1]],
            "parity": _PARITIES[match[2]],
            "stopbits": _STOPS[match[3]],
        }
        self._max_age_s, self._poll_every_s, self._timeout_s = max_age_s, poll_every_s, timeout_s
        self._now = now
        self._changed = threading.Condition()
        self._newest: _DatedReading | None = None
        self._bad_lines = 0
        self._last_bad_line = ""
        self._link_error = ""
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def connect(self) -> None:
        """Open the link and start reading. Raises ``SensorLinkLost``."""
        self.disconnect()
        port = self._open()
        self._stop = threading.Event()
        self._newest, self._bad_lines, self._last_bad_line, self._link_error = None, 0, "", ""
        self._thread = threading.Thread(target=self._listen, args=(port, self._stop), name="air sensor", daemon=True)
        self._thread.start()

    def read(self) -> AirReading:
        """Return the newest reading with its age; wait for a fresh one for a limited time.

        Raises
        ------
        StaleReading
            If the newest one is too old; the message contains its age and the cause.
        SensorLinkLost
            If there is none: the station is silent, unplugged, or its lines do not match.
        """
        if self._thread is None:
            raise SensorLinkLost(f"air sensor {self._url}: not connected")
        with self._changed:
            self._changed.wait_for(lambda: self._fresh() is not None, timeout=self._timeout_s)
            reading = self._fresh()
            if reading is None:
                raise self._no_reading_error()
        return AirReading(
            time_s=reading.at_s,
            temperature_c=reading.values["temperature"],
            pressure_hpa=reading.values.get("pressure"),
            humidity_percent=reading.values.get("humidity"),
            object_temperature_c=reading.values.get("object_temperature"),
            age_s=max(self._now() - reading.at_s, 0.0),
        )

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._stop.set()
            thread.join(_JOIN_S)

    # -- reading ------------------------------------------------------------------------------------------------------

    def _fresh(self) -> _DatedReading | None:
        reading = self._newest
        return reading if reading is not None and self._now() - reading.at_s <= self._max_age_s else None

    def _no_reading_error(self) -> SensorLinkLost:
        subject = f"air sensor {self._url}"
        cause = self._link_error
        if not cause and self._bad_lines:
            lines = "1 line" if self._bad_lines == 1 else f"{self._bad_lines} lines"
            cause = f"it sent {lines} without a reading: {self._last_bad_line}; check format, units, baud and framing"
        if not cause:
            cause = "it is silent; check its power, the cable, and whether it must be polled"
        if self._newest is None:
            return SensorLinkLost(f"{subject}: no reading: {cause}")
        age_s = self._now() - self._newest.at_s
        return StaleReading(
            f"{subject}: the newest reading is {age_s:.0f} s old, more than {self._max_age_s:g} s: {cause}"
        )

    # -- the thread ---------------------------------------------------------------------------------------------------

    def _open(self) -> serial.SerialBase:
        options = self._options if "://" in self._url else {**self._options, "write_timeout": self._timeout_s}
        try:  # pyserial's rfc2217:// refuses a write timeout; its socket has one
            return serial.serial_for_url(self._url, timeout=_READ_TIMEOUT_S, **options)
        except (OSError, ValueError, NotImplementedError) as error:  # SerialException is an OSError
            raise SensorLinkLost(f"air sensor {self._url}: cannot be opened: {_one_line(error)}") from error

    def _listen(self, port: serial.SerialBase | None, stop: threading.Event) -> None:
        while not stop.is_set():
            if port is None:
                if stop.wait(_REOPEN_S):
                    return
                try:
                    port = self._open()
                except SensorLinkLost as error:
                    self._set_link_error(str(error).partition(": ")[2])
                    continue
                self._set_link_error("")
            try:
                self._read_lines(port, stop)
            except (OSError, ValueError) as error:
                self._set_link_error(f"the link is lost: {_one_line(error)}")
            finally:
                self._close(port)
                port = None

    def _set_link_error(self, cause: str) -> None:
        with self._changed:
            self._link_error = cause

    @staticmethod
    def _close(port: serial.SerialBase) -> None:
        try:
            port.close()
        except OSError:
            return  # it was already closed

    def _read_lines(self, port: serial.SerialBase, stop: threading.Event) -> None:
        """Process lines until ``stop`` is set or the link breaks."""
        pending = b""
        synchronised = False  # input before the first line end may be an incomplete line and is ignored
        due_s = time.monotonic()
        while not stop.is_set():
            if self._layout.poll and time.monotonic() >= due_s:
                port.write(self._layout.poll)
                due_s = time.monotonic() + self._poll_every_s
            data = port.read(max(port.in_waiting, 1))
            if not data:
                continue
            pending += data
            *lines, pending = _LINE_END.split(pending)
            for line in lines:
                if synchronised:
                    self._process(line)
                elif self._layout.poll:
                    due_s = time.monotonic()  # the first answer was ignored: poll again at once
                synchronised = True
            if len(pending) > LONGEST_LINE:
                self._count_bad_line(pending, "a line without end")
                pending, synchronised = b"", False

    def _process(self, line: bytes) -> None:
        text = line.decode("latin-1").strip()
        if not text or text == ">" or text.encode("latin-1") == self._layout.poll.strip():
            return  # the prompt, or the echo of the poll
        try:
            values = parse_line(text, self._layout)
        except ValueError as error:
            self._count_bad_line(line, str(error))
            return
        if not values:
            self._count_bad_line(line, "it does not match")
            return
        with self._changed:
            self._newest = _DatedReading(values, self._now())
            self._bad_lines, self._last_bad_line = 0, ""
            self._changed.notify_all()

    def _count_bad_line(self, line: bytes, why: str) -> None:
        with self._changed:
            self._bad_lines += 1
            self._last_bad_line = f"{line[:60].decode('latin-1')!r}: {why}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
