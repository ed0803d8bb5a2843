"""Registries of built-in entries and of those that installed distributions add through entry points.

A plug-in is code of somebody else and runs with the rights of the user: who installs it trusts it. Nothing is imported
before a registry is first used. A plug-in that cannot be used is skipped with a sentence that says why; all others
work.
"""

from __future__ import annotations

import configparser
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from importlib.metadata import Distribution

T = TypeVar("T")

PREFIX = "cellapp."
"""Prefix of the names of all groups."""
_LONGEST_REASON = 200
"""Longest exception message in a sentence [characters]; pydantic writes several lines."""


@dataclass(frozen=True)
class Plugin:
    """One entry point ``name = target`` of an installed distribution, in the group of a registry.

    Attributes
    ----------
    what : str
        What the registry contains: "effect", "kind of arm".
    name, target : str
        Empty if the distribution's list of entry points cannot be read.
    problem : str
        Why it is not used, as a sentence about it; empty if it is used.
    """

    distribution: str
    version: str
    group: str
    what: str
    name: str
    target: str
    problem: str = ""

    @property
    def refusal(self) -> str:
        """Why and where the plug-in is not used, and what to do; empty if it is used."""
        if not self.problem:
            return ""
        entry = f", {self.what} '{self.name}' = {self.target} of [{self.group}]" if self.name else ""
        return (
            f"plug-in {self.distribution} {self.version}{entry}: {self.problem}; it is not used: correct it, or remove"
            f" it with 'pip uninstall {self.distribution}'"
        )


@dataclass(frozen=True)
class _Found(Generic[T]):
    entries: Mapping[str, T]
    plugins: tuple[Plugin, ...]


class Registry(Mapping[str, T]):
    """Entries by name, in this order: built-in ones, those of plug-ins by distribution and name, ``last``.

    Parameters
    ----------
    group : str
        The group of entry points that adds entries. The name of an entry point is the name of the entry.
    what : str
        What an entry is, for people: "effect".
    built_in : mapping
        Entries that a plug-in cannot replace.
    accept : callable
        Takes name and object of an entry point; returns the entry or raises ``ValueError`` with what is wrong.
    last : mapping
        Name -> function that makes an entry from all others.
    """

    def __init__(
        self,
        group: str,
        what: str,
        built_in: Mapping[str, T],
        accept: Callable[[str, object], T],
        last: Mapping[str, Callable[[Mapping[str, T]], T]] | None = None,
    ) -> None:
        self.group, self.what = group, what
        self._built_in, self._accept, self._last = built_in, accept, last or {}

    def __getitem__(self, name: str) -> T:
        return self._found.entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found.entries)

    def __len__(self) -> int:
        return len(self._found.entries)

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """All entry points of the group, by distribution and name, including those that are not used."""
        return self._found.plugins

    def plugin(self, name: str) -> Plugin | None:
        """Return the plug-in that provides an entry; None for a built-in one."""
        return next((one for one in self.plugins if one.name == name and not one.problem), None)

    def refusal(self, name: str) -> str:
        """Return why a plug-in's entry of this name is missing, if a plug-in has or may have one; else empty."""
        if name in self:
            return ""
        return "; ".join(one.refusal for one in self.plugins if one.problem and one.name in (name, ""))

    @cached_property
    def _found(self) -> _Found[T]:
        offered = _offered(self.group, self.what)
        times = Counter(one.name for one in offered)
        entries, plugins = dict(self._built_in), []
        for plugin in offered:
            problem = plugin.problem or self._taken(plugin, offered if times[plugin.name] > 1 else ())
            entry, problem = (None, problem) if problem else _loaded(plugin, self._accept)
            plugins.append(replace(plugin, problem=problem))
            if entry is not None:
                entries[plugin.name] = entry
        entries |= {name: make(dict(entries)) for name, make in self._last.items()}
        return _Found(entries, tuple(plugins))

    def _taken(self, plugin: Plugin, offered: Sequence[Plugin]) -> str:
        """Return who else has the name. Of two plug-ins neither is used: nobody can say which one was meant."""
        if plugin.name in self._built_in or plugin.name in self._last:
            return f"'{plugin.name}' is built in and stays as it is; the plug-in needs another name"
        others = [f"{one.distribution} {one.version}" for one in offered if one.name == plugin.name and one != plugin]
        return f"'{plugin.name}' is also in {', '.join(others)}, so neither is used" if others else ""


def _loaded(plugin: Plugin, accept: Callable[[str, object], T]) -> tuple[T | None, str]:
    """Return the entry of an entry point, or None and what is wrong with it."""
    from importlib.metadata import EntryPoint

    entry_point = EntryPoint(plugin.name, plugin.target, plugin.group)
    if EntryPoint.pattern.fullmatch(plugin.target) is None:
        return None, f"'{plugin.target}' is not of the form MODULE:OBJECT"
    try:
        found = entry_point.load()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - code of others may raise anything
        return None, f"cannot be imported ({_reason(error)}); 'python -c \"import {entry_point.module}\"' shows where"
    try:
        return accept(plugin.name, found), ""
    except Exception as error:  # noqa: BLE001 - constructors of others may raise anything
        return None, str(error) if type(error) is ValueError else _reason(error)


def _reason(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:_LONGEST_REASON]}"


def _offered(group: str, what: str) -> list[Plugin]:
    """Return the entry points of a group by distribution and name, without importing them."""
    from importlib.metadata import distributions

    found: dict[str, list[Plugin]] = {}
    for one in distributions():
        text = _text(one.read_text)
        if f"[{PREFIX}" not in text:  # before parsing any metadata: an environment has hundreds of distributions
            continue
        name, version = _name_and_version(one)
        problem = "" if name and version else "its metadata has no name or no version"
        shown = name or f"(a distribution without a name in {one.locate_file('')})"
        key = re.sub(r"[-_.]+", "-", shown).lower()
        if key in found:  # shadowed by another one of the same name on sys.path: its modules cannot be imported
            continue
        plugin = Plugin(shown, version or "(no version)", group, what, "", "", problem)
        found[key] = _entries(plugin, text)
    return [plugin for key in sorted(found) for plugin in found[key]]


def _name_and_version(one: Distribution) -> tuple[str, str]:
    """Return name and version of a distribution; empty if missing or unreadable."""
    try:
        metadata = one.metadata
    except (UnicodeDecodeError, OSError):  # the backport of importlib.metadata replaces it once it is imported
        return "", ""
    name, version = ("".join(metadata.get_all(key) or ()) for key in ("Name", "Version"))
    return name, version


def _text(read: Callable[[str], str | None]) -> str:
    try:
        return read("entry_points.txt") or ""
    except UnicodeDecodeError:  # not a plug-in's list: the format is UTF-8
        return ""


def _entries(plugin: Plugin, text: str) -> list[Plugin]:
    parser = configparser.ConfigParser(delimiters=("=",), comment_prefixes=("#", ";"), interpolation=None)
    parser.optionxform = str  # type: ignore[assignment, method-assign]  # names keep their case
    try:
        parser.read_string(text, f"entry_points.txt of {plugin.distribution}")
    except configparser.Error as error:
        return [replace(plugin, problem=f"its entry points cannot be read ({_reason(error)})")]
    section = parser[plugin.group] if parser.has_section(plugin.group) else {}
    return [replace(plugin, name=name, target=target.strip()) for name, target in sorted(section.items())]
