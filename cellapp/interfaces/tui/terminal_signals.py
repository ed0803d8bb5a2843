"""Signals of the terminal for somebody who does not look at it: its title, a bell, a desktop notification."""

from __future__ import annotations

import os
import re

from cellapp.interfaces.tui.job_record import JobRecord
from cellapp.interfaces.tui.run_state import RunState

_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f]+")
_MUTE = ("", "dumb", "linux", "unknown")
"""Terminals that would show such sequences as text, or have no desktop."""


def title_words(state: RunState, record: JobRecord) -> str:
    """Return state, percentage and job for the terminal's title: "PAUSED 54 % collect · logs/day"."""
    latest, job = record.latest, state.job
    where = str(state.folder or (job.folder if job is not None and job.folder is not None else "")) or state.profile
    if job is None:
        return " · ".join(filter(None, ("cellapp", where)))
    share = "" if latest is None or not latest.total else f" {100 * latest.done // latest.total} %"
    return " · ".join(
        filter(None, (f"{job.state.upper() if job.state != 'running' else ''}{share} {job.name}".strip(), where))
    )


def since_words(record: JobRecord) -> str:
    """Return since when a job waits, why, and its progress: "since 02:14, arm right: link lost, 215 of 400"."""
    latest = record.latest
    count = "" if latest is None else f"{latest.done} of {latest.total}"
    return ", ".join(filter(None, (f"since {record.since:%H:%M}", record.reason.rstrip("."), count)))


def title_sequence(words: str) -> str:
    """Return the sequence that sets the terminal's title (OSC 2)."""
    return f"\x1b]2;{_plain(words)}\x07"


def notice_sequence(title: str, text: str) -> str:
    """Return a bell and a notification for iTerm2, Windows Terminal and kitty (OSC 9) and for rxvt (OSC 777)."""
    text = _plain(text)
    return f"\x07\x1b]9;{_plain(title)}: {text}\x07\x1b]777;notify;{_plain(title).replace(';', ',')};{text}\x07"


def is_told() -> bool:
    """Return whether the terminal supports such sequences."""
    return os.environ.get("TERM", "") not in _MUTE


def _plain(text: str) -> str:
    """Replace characters that would end the sequence."""
    return _CONTROLS.sub(" ", text)[:200]
