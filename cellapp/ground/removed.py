"""What earlier versions had and this one has not: commands and keys of profiles, each with what to do instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

VERSION = "0.1.0"
"""The version in which everything below was removed."""
COMMANDS: Mapping[str, str] = {}
"""Name of a removed command, as it is typed -> what to do instead."""
PROFILE_KEYS: Mapping[str, str] = {
    "plant.torques": "leave it out; masses are those that the profile states",
}
"""Removed key of a profile, with dots, ``*`` for any name or index -> what to do instead."""


def removed_command(name: str) -> str:
    """Return the sentence about a removed command; empty if no earlier version had it."""
    instead = COMMANDS.get(name)
    return f"'cellapp {name}' was removed in {VERSION}: {instead}" if instead else ""


def removed_key(path: Sequence[str | int]) -> str:
    """Return what to say of a removed key at its path in a profile; empty if no earlier version had it."""
    for key, instead in PROFILE_KEYS.items():
        parts = key.split(".")
        if len(parts) == len(path) and all(part in ("*", str(at)) for part, at in zip(parts, path, strict=True)):
            return f"was removed in {VERSION}: {instead}"
    return ""


def without_removed_keys(content: Any, path: tuple[str | int, ...] = ()) -> tuple[Any, list[str]]:
    """Return plain data of a profile without its removed keys, and these keys with dots."""
    if isinstance(content, list):
        parts = [without_removed_keys(value, (*path, index)) for index, value in enumerate(content)]
        return [value for value, _ in parts], [key for _, keys in parts for key in keys]
    if not isinstance(content, dict):
        return content, []
    kept, found = {}, list[str]()
    for key, value in content.items():
        at = (*path, key)
        if removed_key(at):
            found.append(".".join(map(str, at)))
        else:
            kept[key], below = without_removed_keys(value, at)
            found += below
    return kept, found
