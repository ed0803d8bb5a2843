"""Bindings of the keys of the table to actions, and the keys that do a command of the command line.

A meaning has the same key on every screen, and a key has one meaning. Sentences from elsewhere that name a command are
shown here with the keys that do it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from textual.binding import Binding, BindingType

from cellapp.commands.docs.keys import KEYS, SHOWN, STEPS, Step
from cellapp.commands.iso9283.request import VERB as ISO9283
from cellapp.commands.registry import ALL, GROUPS, name_of

WAYS: Mapping[str, tuple[Step, str]] = {
    "doctor": ("cell", "go"),
    "plan": ("plan", "go"),
    "collect": ("collect", "go"),
    "calibrate": ("calibrate", "go"),
    "discover": ("discover", "go"),
    "discover --propose": ("discover", "add"),
    "compensate": ("targets", "go"),
    "push": ("targets", "measure"),
    "check": ("accept", "check"),
    "check --tracker-moved": ("targets", "locate"),
    "iso9283": ("accept", "measure"),
    "certificate": ("accept", "export"),
    "report": ("accept", "go"),
    "export": ("calibrate", "export"),
}
"""Verb, or verb and option -> the screen and the meaning of the key that does it; other verbs are in the palette."""
_EVERYWHERE: Mapping[str, str] = {"run": "day", "docs": "handbook", "runs": "runs"}
"""Verb -> the meaning of the key that does it on every screen; these verbs are not in the palette."""
_PARTS: Mapping[str, Step] = {
    "locate": "targets",
    "verify": "targets",
    "path": "targets",
    "run": "plan",
    "compare": "plan",
    "forecast": "plan",
}
"""Name of a stage, or of a part of a day -> its step; planning ends with comparing designs."""
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


def step_of(name: str) -> Step | None:
    """Return the step that a verb, a stage or a part of a day belongs to; None if none."""
    return WAYS[name][0] if name in WAYS else _PARTS.get(name)


def way_of(command: str) -> tuple[Step, str] | None:
    """Return the screen and the meaning of the key that do a command; None for words, or if no key does."""
    if not command.startswith("cellapp "):
        return None
    return WAYS.get(_done_by(command.split()[1], command))


def _done_by(verb: str, command: str) -> str:
    """Return the verb of a command, with the option that has a key of its own."""
    return next((one for one in WAYS if one.startswith(f"{verb} ") and one.split()[1] in command), verb)


def way_to(verb: str) -> str:
    """Return the keys that do a verb from any screen: "keys 4, b"."""
    if verb in _EVERYWHERE:
        return f"key {SHOWN[_EVERYWHERE[verb]]}"
    if verb not in WAYS:
        return f"{SHOWN['palette']}, cellapp {verb}"
    step, meaning = WAYS[verb]
    return f"keys {STEPS.index(step) + 1}, {SHOWN[meaning]}"


_CHAPTERS = {"docs targets": "push", "docs planning": "plan"}
"""Chapters that a next step names where it knows no file for the command: here a screen asks for it."""


def with_keys(text: str) -> str:
    """Replace each command of the command line in a sentence by the keys that do it."""
    verbs = {name_of(verb) for verb in ALL} - GROUPS.keys()

    def keys(found: re.Match[str]) -> str:
        verb = found[1] or found[2]
        if verb not in verbs:
            return found[0]
        return way_to(_done_by(verb, found[0]))

    for words, verb in _CHAPTERS.items():
        text = re.sub(rf"'?cellapp {words}\b'?", way_to(verb), text)
    return _COMMAND.sub(keys, text)
