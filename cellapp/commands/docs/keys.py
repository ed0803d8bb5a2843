"""Table of all keys of the terminal application: one key per meaning. The handbook names keys by meanings, too."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args


@dataclass(frozen=True)
class Key:
    """Keys with Textual's names, separated by commas; the display name of the first; the meaning on every screen."""

    keys: str
    shown: str
    meaning: str


KEYS: Mapping[str, Key] = {
    "stop": Key("escape", "Escape", "STOP while something moves; else close a dialog"),
    "pause": Key("p", "p", "pause the job after the present stop; again: resume it"),
    "resume": Key("c", "c", "continue a paused or stopped job"),
    "abort": Key("x", "x", "end the job; Ctrl-X does so over a dialog, too"),
    "next": Key("n", "n", "do the step that comes next: show its screen; there, begin it"),
    "go": Key("b", "b", "begin the work of the screen"),
    "last": Key("a", "a", "go on with the last run: open it"),
    "runs": Key("8", "8", "all runs: open one, its report"),
    "day": Key("f5", "F5", "the whole day in a new run; asks first"),
    "open": Key("o", "o", "open a profile or a list; of a run, say where its page is"),
    "plots": Key("g", "g", "show the plots of a collection; again: the next one"),
    "tab": Key("t", "t", "show the next tab"),
    "search": Key("slash", "/", "search in the handbook"),
    "filter": Key("f", "f", "show only what needs attention"),
    "export": Key("e", "e", "write for others: arms, programs, plans, certificates"),
    "import": Key("i", "i", "take from elsewhere: readings, an earlier run"),
    "add": Key("plus,insert", "+", "add: a profile, stops"),
    "mark": Key("space", "Space", "mark the row"),
    "again": Key("r", "r", "again: read the folder, measure marked stops"),
    "before": Key("comma", ",", "the stop before"),
    "after": Key("full_stop", ".", "the next stop"),
    "check": Key("k", "k", "check: the plan, the calibration"),
    "measure": Key("m", "m", "drive and measure: targets, tests, proposed stops. The arms move"),
    "push": Key("P", "P", "drive to the targets without measuring. The arms move"),
    "locate": Key("l", "l", "measure where the tracker stands. The arms move"),
    "edit": Key("u", "u", "change the profile, or the list of targets, in $EDITOR"),
    "forecast": Key("j", "j", "foresee what a plan gives"),
    "drift": Key("d", "d", "accept a drift of the references"),
    "help": Key("question_mark", "?", "explain this screen, with all its keys"),
    "handbook": Key("f1,h", "F1", "the handbook: contents, search"),
    "palette": Key("ctrl+p", "Ctrl+P", "every action by its name, and the themes"),
    "quit": Key("q", "q", "quit; asks while something runs; in a text to read: close it. Ctrl-Q does so in a dialog"),
}
SHOWN: Mapping[str, str] = {meaning: key.shown for meaning, key in KEYS.items()}
"""Meaning -> display name of its key, for ``str.format_map``."""
Step = Literal["cell", "plan", "collect", "calibrate", "discover", "targets", "accept"]
STEPS: tuple[Step, ...] = get_args(Step)
"""Screens, in the order of the day."""
_PLACE = re.compile(r"\{key:([a-z]+)\}")


def filled_keys(text: str) -> str:
    """Replace each ``{key:MEANING}`` in Markdown by its key; a screen has its number."""
    numbers: dict[str, str] = {step: str(number) for number, step in enumerate(STEPS, start=1)}
    shown = {**numbers, **SHOWN}
    return _PLACE.sub(lambda found: f"**{shown[found[1]]}**", text)
