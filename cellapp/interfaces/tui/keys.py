"""Table of all keys: one key per meaning. Screens bind meanings, and sentences name keys by meanings.

A meaning has the same key on every screen, and a key has one meaning. Sentences from elsewhere that name a command of
the command line are shown here with the keys that do it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from textual.binding import Binding, BindingType

from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.registry import ALL, name_of
from cellapp.commands.view.table import Table
from cellapp.interfaces.tui.workspace import STEPS, Step


@dataclass(frozen=True)
class Key:
    """Keys with Textual's names, separated by commas; the display name of the first; the meaning on every screen."""

    keys: str
    shown: str
    meaning: str


KEYS: Mapping[str, Key] = {
    "stop": Key("escape", "Escape", "STOP while something moves; else close a field or a dialog"),
    "pause": Key("p", "p", "pause the job after the present stop; again: resume it"),
    "resume": Key("c", "c", "continue a paused or stopped job"),
    "abort": Key("x", "x", "end the job; Ctrl-X does so over a dialog, too"),
    "next": Key("n", "n", "do the step that comes next: show its screen; there, begin it"),
    "go": Key("b", "b", "begin the work of the screen"),
    "day": Key("f5", "F5", "the whole day in a new run; asks first"),
    "open": Key("o", "o", "open a profile, a list, a table, a log or a page"),
    "plots": Key("g", "g", "show the plots; again: the next one"),
    "tab": Key("t", "t", "show the next tab"),
    "search": Key("slash", "/", "search, or filter while you type"),
    "filter": Key("f", "f", "show only what needs attention or holds a text"),
    "sort": Key("s", "s", "sort by the next column"),
    "export": Key("e", "e", "write for others: arms, programs, plans, certificates"),
    "import": Key("i", "i", "take from elsewhere: readings, an earlier run"),
    "save": Key("w", "w", "save what is shown: a list, tables, the log"),
    "copy": Key("y", "y", "copy what is shown or marked"),
    "add": Key("plus,insert", "+", "add: a profile, stops, a target, a network from all readings"),
    "remove": Key("minus,delete", "-", "remove the row"),
    "mark": Key("space", "Space", "mark the row"),
    "undo": Key("ctrl+z", "Ctrl+Z", "take back the last edit"),
    "redo": Key("ctrl+y", "Ctrl+Y", "make it again"),
    "again": Key("r", "r", "again: read the folder, design the rest of a plan, measure marked stops"),
    "before": Key("comma", ",", "the stop before"),
    "after": Key("full_stop", ".", "the next stop"),
    "check": Key("k", "k", "check: the plan, the calibration"),
    "measure": Key("m", "m", "drive and measure: targets, tests, proposed stops. The arms move"),
    "push": Key("P", "P", "drive to the targets without measuring. The arms move"),
    "locate": Key("l", "l", "measure where the tracker stands. The arms move"),
    "edit": Key("u", "u", "change the profile in $EDITOR"),
    "forecast": Key("j", "j", "foresee what a plan gives"),
    "freeze": Key("z", "z", "let later designs leave the marked stops"),
    "drift": Key("d", "d", "accept a drift of the references"),
    "debug": Key("D", "D", "show all lines of the log"),
    "info": Key("I", "I", "show lines of the log from info upwards"),
    "warning": Key("W", "W", "show warnings and errors of the log"),
    "error": Key("E", "E", "show errors of the log"),
    "help": Key("question_mark", "?", "explain this screen, with all its keys"),
    "handbook": Key("f1,h", "F1", "the handbook: contents, search"),
    "palette": Key("ctrl+p", "Ctrl+P", "every action by its name, and the themes"),
    "quit": Key(
        "q",
        "q",
        "quit; asks where something runs or is not saved; in a text to read: close it. Ctrl-Q does so in a text field",
    ),
}
SHOWN: Mapping[str, str] = {meaning: key.shown for meaning, key in KEYS.items()}
"""Meaning -> display name of its key, for ``str.format_map``."""
WAYS: Mapping[str, tuple[Step, str]] = {
    "doctor": ("cell", "go"),
    "plan": ("plan", "go"),
    "collect": ("collect", "go"),
    "calibrate": ("calibrate", "go"),
    "discover": ("discover", "go"),
    "discover --propose": ("discover", "add"),
    "compensate": ("targets", "go"),
    "push": ("targets", "measure"),
    "locate": ("targets", "locate"),
    "correct": ("targets", "export"),
    "check": ("accept", "check"),
    "iso9283": ("accept", "measure"),
    "certificate": ("accept", "export"),
    "report": ("accept", "go"),
    "export": ("calibrate", "export"),
    "runs": ("runs", "again"),
}
"""Verb -> the screen and the meaning of the key that does it; other verbs are in the palette."""
_EVERYWHERE: Mapping[str, str] = {"run": "day", "docs": "handbook"}
"""Verb -> the meaning of the key that does it on every screen; these verbs are not in the palette."""
_VARIANTS = "|".join(re.escape(word) for word in ISO9283.variants)
"""Words after the only verb that has some."""
_COMMAND = re.compile(
    r"(?:run )?'cellapp ([a-z][\w-]*)[^'\n]*'"
    rf"|\bcellapp ([a-z][\w-]*)(?: (?:{_VARIANTS})\b)?(?: (?:--[\w-]+|[A-Z_]+\b|\S*/\S*|\d+|\.(?=\s|$)))*"
)


def bind(meaning: str, action: str, label: str, tooltip: str = "", *, show: bool = True) -> Binding:
    """Return the binding of a meaning to an action of a screen or of the application."""
    key = KEYS[meaning]
    return Binding(key.keys, action, label, show=show, tooltip=tooltip, key_display=key.shown)


def key_table(bindings: Sequence[BindingType]) -> str:
    """Return the keys of a screen or of the application as a Markdown table, each with its effect."""
    rows = ["| key | what it does |", "| --- | --- |"]
    for one in bindings:
        if isinstance(one, Binding) and one.description:
            more = one.tooltip or next((key.meaning for key in KEYS.values() if key.keys == one.key), "")
            rows.append(f"| {one.key_display or one.key.title()} | {one.description}{f': {more}' if more else ''} |")
    return "\n".join(rows)


def way_to(verb: str) -> str:
    """Return the keys that do a verb from any screen: "keys 4, b"."""
    if verb in _EVERYWHERE:
        return f"key {SHOWN[_EVERYWHERE[verb]]}"
    if verb not in WAYS:
        return f"{SHOWN['palette']}, cellapp {verb}"
    step, meaning = WAYS[verb]
    return f"keys {STEPS.index(step) + 1}, {SHOWN[meaning]}"


def table_with_keys(table: Table) -> Table:
    """Return the table with commands in its cells replaced by keys."""
    rows = tuple(tuple(with_keys(cell) if isinstance(cell, str) else cell for cell in row) for row in table.rows)
    return replace(table, rows=rows)


_CHAPTERS = {"docs targets": "push", "docs planning": "plan"}
"""Chapters that a next step names where it knows no file for the command: here a screen asks for it."""


def with_keys(text: str) -> str:
    """Replace each command of the command line in a sentence by the keys that do it."""
    verbs = {name_of(verb) for verb in ALL}

    def keys(found: re.Match[str]) -> str:
        verb = found[1] or found[2]
        if verb not in verbs:
            return found[0]
        return way_to("discover --propose" if verb == "discover" and "--propose" in found[0] else verb)

    for words, verb in _CHAPTERS.items():
        text = re.sub(rf"'?cellapp {words}\b'?", way_to(verb), text)
    return _COMMAND.sub(keys, text)
