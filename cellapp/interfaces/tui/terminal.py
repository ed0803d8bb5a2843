"""Choice of Textual's driver for the terminal.

STOP in the thread that reads the terminal: a stop must not wait for the event loop, which may be busy drawing.

Escape, Ctrl-C and a mouse press of STOP brake here as soon as they are read, in every encoding of the terminal. The
screens then get ``StopGiven`` instead of the key: one press stops once, and every press stops.
"""

from __future__ import annotations

import os
import select
import sys
import time
from codecs import getincrementaldecoder
from typing import cast

from textual import constants, events
from textual._xterm_parser import BRACKETED_PASTE_END, BRACKETED_PASTE_START, XTermParser
from textual.driver import Driver
from textual.drivers.linux_driver import LinuxDriver
from textual.message import Message

from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.leaving import LEFT
from drivers.priority import run_first

_POLL_S = 0.1
"""Time in which the thread notices that the application ends."""
_PASTE_RESTS_S = 0.5
"""Pause that ends a pasted text: if its end mark was lost, keys must not be taken for text for ever."""
_ALONE = (b"\x03", b"\x1b")
"""Ctrl-C and Escape typed by a person, alone. After a pause they are not pasted text, even if this thread had no
processor to notice the pause."""
_READ = 4096
_NICENESS = -10
_LEFT_BUTTON = 1
_ESCAPES = ("escape", "\x1b")
"""Names of Escape, without modifiers: the second in the terminal encoding "modifyOtherKeys"."""
_CTRL_C = ("ctrl+c", "ctrl+\u0441")
"""Names of Ctrl-C: the second on a Cyrillic layout, if the terminal reports letters instead of bytes."""


class UrgentDriver(LinuxDriver):
    """Textual's driver, with STOP taken out of the input before the event loop gets it."""

    _pasting = False
    _newest = ""
    """The last characters read, as many as the mark of a pasted text has."""

    def run_input_thread(self) -> None:
        """Read keys until the application ends or the terminal is closed.

        After each read the parser is asked again as soon as an escape sequence would have to continue. Textual's own
        loop looks only ten times a second, and a lone Escape would wait for that.
        """
        run_first(_NICENESS)  # also for the threads that it starts, which brake
        parser = XTermParser(self._debug)
        decode = getincrementaldecoder("utf-8")(errors="replace").decode
        wait_s, read_s = _POLL_S, time.monotonic()
        while not self.exit_event.is_set():
            if select.select([self.fileno], [], [], wait_s)[0]:
                data = self._read()
                if not data:
                    cast(Host, self._app).leaving.close_terminal()
                    return
                if self._pasting and data in _ALONE and time.monotonic() - read_s > _PASTE_RESTS_S:
                    self._parse(parser, BRACKETED_PASTE_END)
                self._parse(parser, decode(data))
                wait_s, read_s = constants.ESCAPE_DELAY, time.monotonic()
            else:
                wait_s = _POLL_S
                if self._pasting and time.monotonic() - read_s > _PASTE_RESTS_S:
                    self._parse(parser, BRACKETED_PASTE_END)
            for message in parser.tick():
                self.process_message(message)

    def _read(self) -> bytes:
        """Return what was typed; empty if the terminal is gone."""
        try:
            return os.read(self.fileno, _READ)
        except OSError:
            return b""

    def _parse(self, parser: XTermParser, text: str) -> None:
        """Parse character by character, to know for each key whether it was pressed or pasted."""
        for character in text:
            for message in parser.feed(character):
                self.process_message(message)
            self._newest = (self._newest + character)[-len(BRACKETED_PASTE_START) :]
            if self._newest in (BRACKETED_PASTE_START, BRACKETED_PASTE_END):
                self._pasting = self._newest == BRACKETED_PASTE_START

    def process_message(self, message: Message) -> None:
        """Stop if the message is a press of STOP and a job runs, then pass it on."""
        if self._pasting and isinstance(message, events.Key):
            return  # an escape sequence in a pasted text, which is also in the paste event
        if self._presses_stop(message):
            given = cast(Host, self._app).presses.give()
            message = message if given is None else given
        if isinstance(message, events.Key) and message.key == "ctrl+q":
            cast(Host, self._app).leaving.end_if_stalled(LEFT)  # the event loop may wait for the terminal
        super().process_message(message)

    def _presses_stop(self, message: Message) -> bool:
        if isinstance(message, events.Key):
            closes = message.key not in _CTRL_C and cast(Host, self._app).escape_closes
            return presses_stop(message.key) and not closes
        if isinstance(message, events.MouseDown) and message.button == _LEFT_BUTTON:
            return cast(Host, self._app).presses.region.contains(int(message.screen_x), int(message.screen_y))
        return False


def presses_stop(key: str) -> bool:
    """Return whether a key, with Textual's name, is STOP: Escape with any modifier, or Ctrl-C."""
    return key in _CTRL_C or key.rpartition("+")[2] in _ESCAPES


def since_words(record: JobRecord) -> str:
    """Return since when a job waits, why, and its progress: "since 02:14, arm right: link lost, 215 of 400"."""
    latest = record.latest
    count = "" if latest is None else f"{latest.done} of {latest.total}"
    return ", ".join(filter(None, (f"since {record.since:%H:%M}", record.reason.rstrip("."), count)))


def driver_that_stops(usual: type[Driver]) -> type[Driver]:
    """Return the driver whose thread handles STOP itself, if ``usual`` is that of a POSIX terminal; else ``usual``."""
    if sys.platform == "win32":
        return usual
    from textual.drivers.linux_driver import LinuxDriver  # which Windows cannot load

    return UrgentDriver if usual is LinuxDriver else usual
