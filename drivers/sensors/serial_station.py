"""A weather station on a serial line, a serial server or a socket: whatever pyserial can open, line by line.

One thread listens as long as the station is connected, so that every line is dated when it comes and not when somebody
asks; it opens a lost link again by itself. Who asks gets the newest reading with its age, or a refusal with the cause.
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
"""What the named groups of a pattern may be called, each also with ``_unit`` behind it."""
LONGEST_LINE = 512

_TURN_S = 0.1
_REOPEN_S = 2.0
_JOIN_S = 5.0
_LINE_END = re.compile(rb"[\r\n]+")
_BITS = {"5": serial.FIVEBITS, "6": serial.SIXBITS, "7": serial.SEVENBITS, "8": serial.EIGHTBITS}
_PARITIES = {"N": serial.PARITY_NONE, "E": serial.PARITY_EVEN, "O": serial.PARITY_ODD}
_STOPS = {"1": serial.STOPBITS_ONE, "2": serial.STOPBITS_TWO}
_FRAMING = re.compile(r"([5-8])([NEO])([12])")

# Factor and offset into degC, hPa and %; what a unit is called, without blanks, quotes, degree signs and capitals.
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
_USUAL = {"temperature": "degC", "object_temperature": "degC", "pressure": "hPa", "humidity": "%"}
# Narrow on purpose: 293 K, 68 degF, 1.013 bar or 29.9 inHg, taken for degC and hPa, fall outside.
_PLAUSIBLE = {
    "temperature": (-10.0, 50.0),
    "object_temperature": (-10.0, 60.0),
    "pressure": (500.0, 1100.0),
    "humidity": (0.0, 100.0),
}
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_NO_PART_OF_A_UNIT = re.compile(r"[\s'’°º�]")


@dataclass(frozen=True)
class LineFormat:
    """How a station writes a reading, and how it is asked for one.

    Attributes
    ----------
    pattern : str
        Regular expression that must fit a whole line, its groups named as ``FIELDS``; ``temperature`` must be one. A
        group such as ``pressure_unit`` catches the unit that the line names, which is then obeyed.
    units : mapping of str to str
        Unit of each field whose line names none; left out: degC, hPa, %.
    poll : bytes
        What is sent to get a line; empty for a station that sends by itself.
    baud, framing : int, str
        What such stations use when delivered, framing as in "8N1".
    """

    pattern: str
    units: Mapping[str, str] = field(default_factory=dict)
    poll: bytes = b""
    baud: int = 9600
    framing: str = "8N1"

    def __post_init__(self) -> None:
        try:
            groups = re.compile(self.pattern).groupindex
        except re.error as error:
            raise ValueError(f"pattern: no regular expression: {error}") from None
        known = {*FIELDS, *(f"{name}_unit" for name in FIELDS)}
        if "temperature" not in groups or not known.issuperset(groups):
            raise ValueError(f"pattern: needs (?P<temperature>...), and may have {', '.join(sorted(known))}")
        for name, unit in self.units.items():
            if name not in FIELDS or _bare(unit) not in _UNITS[name]:
                raise ValueError(f"units: '{name}: {unit}' is not known; for {name} use one of {_choices(name)}")


_VALUE = r"[-+]?[ ]*\d+\.?\d*"
PRESETS: Mapping[str, LineFormat] = MappingProxyType(
    {
        # "P= 1013.2 hPa T= 31.1 'C RH= 38.3 %RH", the quantities in any order, after the prompt; whatever else it
        # prints (P1=, dew point) is passed over. A star in place of a figure does not fit.
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
class _Heard:
    """A reading and when its line came."""

    values: Mapping[str, float]
    at_s: float


def parse_line(line: str, layout: LineFormat) -> dict[str, float]:
    """Fields of a line in degC, hPa and %; empty when it is no reading at all.

    Raises
    ------
    ValueError
        If it looks like a reading, but a unit is not known or a value cannot be: what and where.
    """
    found = re.fullmatch(layout.pattern, line)
    if found is None:
        return {}
    texts = found.groupdict()
    values = {}
    for name in FIELDS:
        text = texts.get(name)
        if text is None:
            continue
        bare = text.replace(" ", "")
        if _NUMBER.fullmatch(bare) is None:
            raise ValueError(f"{name} is '{text}', which is no number")
        unit = texts.get(f"{name}_unit") or layout.units.get(name) or _USUAL[name]
        if _bare(unit) not in _UNITS[name]:
            raise ValueError(f"{name} comes in '{unit}'; known are {_choices(name)}")
        factor, offset = _UNITS[name][_bare(unit)]
        value = float(bare) * factor + offset
        low, high = _PLAUSIBLE[name]
        if not low <= value <= high:
            raise ValueError(
                f"{name} is {value:g} {_USUAL[name]}, which is not between {low:g} and {high:g}: is it in another"
                f" unit than {unit}?"
            )
        values[name] = value
    if "temperature" not in values:
        raise ValueError("it has no temperature")
    return values


def _bare(unit: str) -> str:
    return _NO_PART_OF_A_UNIT.sub("", unit).casefold()


def _choices(name: str) -> str:
    return ", ".join(_UNITS.get(name, {})) or "nothing: there is no such field"


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
        """Nothing is opened yet.

        ``baud`` and ``framing`` differ from those of ``layout`` where given. A reading older than ``max_age_s`` is
        refused. A station that is polled is polled every ``poll_every_s``. ``timeout_s``: how long ``read`` waits for
        a reading that is fresh enough. Raises ``ValueError`` on a framing that is none.
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
        self._heard: _Heard | None = None
        self._misfits = 0
        self._trouble = ""
        self._lost = ""
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def connect(self) -> None:
        """Open the link and begin to listen. Raises ``SensorLinkLost``."""
        self.disconnect()
        port = self._open()
        self._stop = threading.Event()
        self._heard, self._misfits, self._trouble, self._lost = None, 0, "", ""
        self._thread = threading.Thread(target=self._listen, args=(port, self._stop), name="air sensor", daemon=True)
        self._thread.start()

    def read(self) -> AirReading:
        """The newest reading, with its age; waits a little for one that is fresh enough.

        Raises
        ------
        StaleReading
            If the newest one is too old: how old, and why none came since.
        SensorLinkLost
            If there is none: the station is silent, unplugged, or says what is no reading.
        """
        if self._thread is None:
            raise SensorLinkLost(f"air sensor {self._url}: not connected")
        with self._changed:
            self._changed.wait_for(lambda: self._fresh() is not None, timeout=self._timeout_s)
            heard = self._fresh()
            if heard is None:
                raise self._refusal()
        return AirReading(
            time_s=heard.at_s,
            temperature_c=heard.values["temperature"],
            pressure_hpa=heard.values.get("pressure"),
            humidity_percent=heard.values.get("humidity"),
            object_temperature_c=heard.values.get("object_temperature"),
            age_s=max(self._now() - heard.at_s, 0.0),
        )

    def disconnect(self) -> None:
        """Close the link; harmless when closed."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._stop.set()
            thread.join(_JOIN_S)

    # -- who asks ------------------------------------------------------------------------------------------------------

    def _fresh(self) -> _Heard | None:
        heard = self._heard
        return heard if heard is not None and self._now() - heard.at_s <= self._max_age_s else None

    def _refusal(self) -> SensorLinkLost:
        subject = f"air sensor {self._url}"
        cause = self._lost
        if not cause and self._misfits:
            lines = "1 line that is" if self._misfits == 1 else f"{self._misfits} lines that are"
            cause = f"it sent {lines} no reading: {self._trouble}; check format or pattern, units, baud and framing"
        if not cause:
            cause = "it is silent; check its power, the cable, and whether it must be polled"
        if self._heard is None:
            return SensorLinkLost(f"{subject}: no reading: {cause}")
        age_s = self._now() - self._heard.at_s
        return StaleReading(
            f"{subject}: the newest reading is {age_s:.0f} s old, more than {self._max_age_s:g} s: {cause}"
        )

    # -- who listens ---------------------------------------------------------------------------------------------------

    def _open(self) -> serial.SerialBase:
        options = self._options if "://" in self._url else {**self._options, "write_timeout": self._timeout_s}
        try:  # pyserial's rfc2217:// refuses a time limit for writing; its own socket has one
            return serial.serial_for_url(self._url, timeout=_TURN_S, **options)
        except (OSError, ValueError, NotImplementedError) as error:  # SerialException is an OSError
            raise SensorLinkLost(f"air sensor {self._url}: cannot be opened: {_said(error)}") from error

    def _listen(self, port: serial.SerialBase | None, stop: threading.Event) -> None:
        while not stop.is_set():
            if port is None:
                if stop.wait(_REOPEN_S):
                    return
                try:
                    port = self._open()
                except SensorLinkLost as error:
                    self._note_lost(str(error).partition(": ")[2])
                    continue
                self._note_lost("")
            try:
                self._follow(port, stop)
            except (OSError, ValueError) as error:
                self._note_lost(f"the link is lost: {_said(error)}")
            finally:
                self._close(port)
                port = None

    def _note_lost(self, cause: str) -> None:
        with self._changed:
            self._lost = cause

    @staticmethod
    def _close(port: serial.SerialBase) -> None:
        try:
            port.close()
        except OSError:
            return  # it was gone already

    def _follow(self, port: serial.SerialBase, stop: threading.Event) -> None:
        """Take lines until told to stop or until the link breaks."""
        held = b""
        in_step = False  # what comes before the first line end may be the tail of a line, and must not count
        due_s = time.monotonic()
        while not stop.is_set():
            if self._layout.poll and time.monotonic() >= due_s:
                port.write(self._layout.poll)
                due_s = time.monotonic() + self._poll_every_s
            came = port.read(max(port.in_waiting, 1))
            if not came:
                continue
            held += came
            *lines, held = _LINE_END.split(held)
            for line in lines:
                if in_step:
                    self._take(line)
                elif self._layout.poll:
                    due_s = time.monotonic()  # the first answer was passed over: ask again at once
                in_step = True
            if len(held) > LONGEST_LINE:
                self._note_misfit(held, "a line without end")
                held, in_step = b"", False

    def _take(self, line: bytes) -> None:
        text = line.decode("latin-1").strip()
        if not text or text == ">" or text.encode("latin-1") == self._layout.poll.strip():
            return  # the prompt, or an echo of what was sent
        try:
            values = parse_line(text, self._layout)
        except ValueError as error:
            self._note_misfit(line, str(error))
            return
        if not values:
            self._note_misfit(line, "it does not fit")
            return
        with self._changed:
            self._heard = _Heard(values, self._now())
            self._misfits, self._trouble = 0, ""
            self._changed.notify_all()

    def _note_misfit(self, line: bytes, why: str) -> None:
        with self._changed:
            self._misfits += 1
            self._trouble = f"{line[:60].decode('latin-1')!r}: {why}"


def _said(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
