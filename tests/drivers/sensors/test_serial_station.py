"""A station on a pty, a socket, a serial server and a loop: good lines, partial ones, garbage, silence, unplugging."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import tty
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.sensors import serial_station
from drivers.sensors.protocol import SensorLinkLost, StaleReading
from drivers.sensors.serial_station import LONGEST_LINE, PRESETS, LineFormat, SerialStation, parse_line
from tests.approved import assert_refused
from tests.sure import sure
from tests.waiting import until

PTU = PRESETS["vaisala-ptu300"]
STREAMED = LineFormat(PTU.pattern)
LINE = b"P= 1013.2 hPa T= 21.4 'C RH= 38.3 %RH\r\n"
LONG_S = 10.0
SHORT_S = 0.2


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.time_s = 1000.0

    def __call__(self) -> float:
        return self.time_s


class Line:
    """The station's end of a pty."""

    def __init__(self) -> None:
        self.fd, self._other = os.openpty()
        tty.setraw(self._other)
        self.path = os.ttyname(self._other)

    def say(self, text: bytes) -> None:
        os.write(self.fd, text)

    def hear(self) -> bytes:
        assert select.select([self.fd], [], [], LONG_S)[0], "nothing was sent"
        return os.read(self.fd, 100)

    def unplug(self) -> None:
        for fd in (self.fd, self._other):
            with contextlib.suppress(OSError):
                os.close(fd)


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


@pytest.fixture
def listen() -> Iterator[Callable[..., SerialStation]]:
    """``listen(url, layout, **options)``: a connected station, disconnected at the end."""
    stations = []

    def make(url: str, layout: LineFormat = STREAMED, **options: Any) -> SerialStation:
        station = SerialStation(url, layout, **({"timeout_s": LONG_S} | options))
        stations.append(station)
        station.connect()
        return station

    yield make
    for station in stations:
        station.disconnect()


# -- lines ------------------------------------------------------------------------------------------------------------


def test_lines_of_a_ptu300_are_read_or_refused_as_approved() -> None:
    def read(text: str) -> str:
        return ", ".join(f"{name} {value:.6g}" for name, value in parse_line(text, PTU).items()) or "nothing"

    assert_refused(Path(__file__).parent / "approved" / "lines.txt", read)


def test_a_custom_format() -> None:
    layout = LineFormat(
        r"(?P<temperature>\S+);(?P<object_temperature>\S+);(?P<pressure>\S+)",
        units={"temperature": "degF", "pressure": "kPa"},
    )
    assert parse_line("68.0;21.5;101.0", layout) == pytest.approx(
        {"temperature": 20.0, "object_temperature": 21.5, "pressure": 1010.0}
    )
    with pytest.raises(ValueError, match="object_temperature is 'nan', which is not a number"):
        parse_line("68.0;nan;101.0", layout)


@given(st.text(max_size=60), st.integers(0, len(LINE) - 2))
def test_mangled_lines_never_give_an_impossible_reading(junk: str, cut: int) -> None:
    good = LINE.decode().strip()
    try:
        values = parse_line(good[:cut] + junk + good[cut + 1 :], PTU)
    except ValueError:
        return
    assert not values or -10.0 <= values["temperature"] <= 50.0
    assert 500.0 <= values.get("pressure", 1000.0) <= 1100.0
    assert 0.0 <= values.get("humidity", 50.0) <= 100.0


# -- links ------------------------------------------------------------------------------------------------------------


def test_readings_come_with_their_age(line: Line, listen: Callable[..., SerialStation]) -> None:
    clock = Clock()
    station = listen(line.path, now=clock, max_age_s=60.0)
    line.say(b"\r\n" + LINE)
    first = station.read()
    assert (first.temperature_c, first.pressure_hpa, first.humidity_percent) == (21.4, 1013.2, 38.3)
    assert (first.time_s, first.age_s) == (1000.0, 0.0)
    clock.time_s += 59.0
    assert station.read().age_s == 59.0
    line.say(LINE.replace(b"21.4", b"21.9"))
    until(lambda: station.read().age_s == 0.0, "a fresh line")
    assert station.read().temperature_c == 21.9


def test_a_stale_reading_is_refused_and_silence_named(line: Line, listen: Callable[..., SerialStation]) -> None:
    clock = Clock()
    station = listen(line.path, now=clock, timeout_s=SHORT_S)
    line.say(b"\r\n" + LINE)
    until(lambda: station._newest is not None, "the first line")
    assert station.read().age_s == 0.0
    clock.time_s += 61.0
    with pytest.raises(StaleReading, match=r"is 61 s old, more than 60 s: it is silent; check its power"):
        station.read()


def test_the_tail_of_a_line_is_no_reading(line: Line, listen: Callable[..., SerialStation]) -> None:
    """Joined in mid-line, "T= 1.4" may be what is left of "T= 21.4"; pieces are put together."""
    station = listen(line.path)
    line.say(b"T= 1.4 'C\r\nT= 2")
    line.say(b"1.4 'C RH=")
    line.say(b" 38.3 %RH\r")
    assert station.read().temperature_c == 21.4
    assert station.read().humidity_percent == 38.3


def test_garbage_is_named_and_the_next_line_counts(line: Line, listen: Callable[..., SerialStation]) -> None:
    station = listen(line.path, timeout_s=SHORT_S)
    line.say(b"\r\n" + bytes(range(128, 250)) + b"\r\nP= 1.0 bar\r\n" + b"x" * 5 * LONGEST_LINE + b"\r\n")
    line.say(b"P= 1.0132 hPa T= 20.0 'C\r\n")
    until(lambda: "another unit" in station._last_bad_line, "the line that is refused")
    with pytest.raises(SensorLinkLost, match=r"lines without a reading: .*1\.0132 hPa.*check format, units"):
        station.read()
    assert len(station._last_bad_line) < 300
    line.say(LINE)
    until(lambda: station._newest is not None, "the first line")
    assert station.read().temperature_c == 21.4


def test_a_line_without_end_is_not_kept(line: Line, listen: Callable[..., SerialStation]) -> None:
    station = listen(line.path)
    line.say(b"\r\n")
    for _ in range(3):
        line.say(b"x" * LONGEST_LINE)
    until(lambda: "a line without end" in station._last_bad_line, "the line that is refused")
    line.say(b"P= 1000.0 hPa T= 1.4 'C\r\n" + LINE)  # the rest of it is no reading either
    assert station.read().temperature_c == 21.4


def test_a_polled_station(line: Line, listen: Callable[..., SerialStation]) -> None:
    station = listen(line.path, PTU, poll_every_s=3600.0)
    assert line.hear() == b"send\r\n"
    line.say(b"send\r\n" + LINE.replace(b"21.4", b"1.4"))  # the first line end is only where lines begin
    assert line.hear() == b"send\r\n"
    until(lambda: station._newest is not None, "the first line")
    line.say(LINE)
    until(lambda: station.read().temperature_c == 21.4, "the next value")


def test_unplugged_and_plugged_in_again(
    listen: Callable[..., SerialStation], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setattr(serial_station, "_REOPEN_S", 0.01)
    link = tmp_path_factory.mktemp("dev") / "ttyUSB0"  # as udev names whatever is plugged in
    clock = Clock()
    first = Line()
    link.symlink_to(first.path)
    station = listen(str(link), now=clock, timeout_s=SHORT_S)
    first.say(b"\r\n" + LINE)
    until(lambda: station._newest is not None, "the first line")
    first.unplug()
    link.unlink()
    until(lambda: bool(station._link_error), "the lost link")
    assert station.read().temperature_c == 21.4  # still fresh
    clock.time_s += 61.0
    with pytest.raises(StaleReading, match=r"61 s old.*(link is lost|cannot be opened)"):
        station.read()
    second = Line()
    link.symlink_to(second.path)
    until(lambda: not station._link_error, "the link")
    second.say(b"\r\n" + LINE.replace(b"21.4", b"22.5"))
    until(lambda: station._newest is not None and station._newest.values["temperature"] == 22.5, "the new value")
    assert station.read().age_s == 0.0
    station.disconnect()
    second.unplug()


def test_a_station_behind_a_socket_that_hangs_up(
    listen: Callable[..., SerialStation], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_station, "_REOPEN_S", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(LONG_S)
        station = listen(f"socket://127.0.0.1:{server.getsockname()[1]}")
        for figure in (b"21.4", b"22.5"):
            connection, _ = server.accept()
            with connection:
                until(partial(reads, station, connection, figure), "the figure")


def reads(station: SerialStation, connection: socket.socket, figure: bytes) -> bool:
    """Send again and again, as stations do: what comes while pyserial opens is lost."""
    connection.sendall(b"\n" + LINE.replace(b"21.4", figure))
    return station.read().temperature_c == float(figure)


@pytest.mark.parametrize(
    "url", ["/dev/there-is-no-such-port", "nonsense://x", "socket://127.0.0.1:1", "socket://nowhere"]
)
def test_ports_that_cannot_be_opened(url: str) -> None:
    with pytest.raises(SensorLinkLost, match=r"cannot be opened: \S"):
        SerialStation(url, STREAMED).connect()


def test_before_and_after(line: Line) -> None:
    with pytest.raises(ValueError, match="such as 8N1 or 7E1"):
        SerialStation(line.path, STREAMED, framing="9N1")
    station = SerialStation(line.path, STREAMED)
    with pytest.raises(SensorLinkLost, match="not connected"):
        station.read()
    station.connect()
    thread = sure(station._thread)
    station.disconnect()
    station.disconnect()
    assert not thread.is_alive()
    with pytest.raises(SensorLinkLost, match="not connected"):
        station.read()
