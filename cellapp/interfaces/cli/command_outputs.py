"""Files that a command may write and name, and the options of every command about them."""

from __future__ import annotations

import contextlib
import functools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, Writes
from cellapp.ground.shell import filled
from cellapp.interfaces.cli.requests import REMEDY

HELP_OPTIONS = ["-h", "--help"]
_OUTPUT = "Output"
"""Panel of the options that every command has."""


@dataclass(frozen=True)
class CommandOutputs:
    """Output files of one command call: ``outputs`` writes them, ``files`` are those it names, by option.

    ``later`` are base paths from which file names are derived; they are checked at writing. ``stores`` are appended to.
    ``named`` are its own run, profile and list of targets, by the words for them in commands that messages quote.
    """

    outputs: Outputs = NEW_ONLY
    files: dict[str, Path] = field(default_factory=dict)
    later: dict[str, Path] = field(default_factory=dict)
    stores: dict[str, Path] = field(default_factory=dict)
    named: dict[str, Path] = field(default_factory=dict)

    def filled(self, text: str) -> str:
        """Put the files of this call, and those that its run knows, into the commands that a message quotes."""
        files = dict(self.named)
        if "DIR" in files and re.search(r"'cellapp [^']*\b(PROFILE|TARGETS)\b", text):  # else no run is opened
            from cellapp.commands.stages import known_files  # late: a help needs none

            known = zip(("PROFILE", "TARGETS"), known_files(files["DIR"]), strict=True)
            files = {word: path for word, path in known if path is not None} | files
        return filled(text, files)

    def check(self) -> None:
        """Check all files before anything is done. Raises ``InputError`` for one that may not be written."""
        for option, path in self.stores.items():
            self.outputs.check_added_to(path, option)
        named: dict[str, str] = {}
        for option, path in {**self.files, **self.later, **self.stores}.items():
            if option in self.files:
                self.outputs.check(path, option)
            place = os.path.realpath(path)
            if place in named and (path.is_file() or not path.exists()):
                raise InputError(f"{named[place]} and {option} both name {path}; nothing was done. Give two files")
            named[place] = option


NAMED = {"DIR": "folder", "PROFILE": "profile", "TARGETS": "targets"}
"""Words for files in quoted commands, and the fields of requests that hold them."""
ADDED_TO = (Writes.STORE, Writes.OWN_FOLDER)
"""Ways of writing that replace nothing."""
_NOTHING_CALLED = CommandOutputs()
_current: ContextVar[CommandOutputs] = ContextVar("command_outputs", default=_NOTHING_CALLED)


def current_outputs() -> CommandOutputs:
    """Return the outputs of the running command; without one, outputs that replace no existing file."""
    return _current.get()


@contextlib.contextmanager
def calling(
    values: Mapping[str, Any], written: Mapping[str, tuple[str, Writes]], named: Iterable[str], *, force: bool
) -> Iterator[None]:
    """Know the files of a call while it runs; one that failed keeps them for the message about it.

    ``values`` are those of its parameters, ``written`` the option and the way of each that writes, and ``named`` the
    words for files of its own.
    """
    files: dict[Writes, dict[str, Path]] = {how: {} for how in Writes}
    for name, (option, how) in written.items():
        if values[name] is not None and str(values[name]) != "-":
            files[how][option] = Path(values[name])
    inputs = [path for name, value in values.items() if name not in written for path in _paths(value)]
    own = {word: values[NAMED[word]] for word in named if isinstance(values[NAMED[word]], Path)}
    allowed = Outputs(force, tuple(inputs), REMEDY)
    token = _current.set(CommandOutputs(allowed, files[Writes.FILE], files[Writes.FILES], files[Writes.STORE], own))
    yield
    _current.reset(token)


class Commands(typer.Typer):
    """A group of commands. All are registered before the first call, which builds their parameters once."""

    @functools.cached_property
    def _built(self) -> Callable[..., Any]:
        command: Callable[..., Any] = _as_text(typer.main.get_command(self))
        return command

    def __call__(self, *args: Any, **settings: Any) -> Any:
        """Parse the arguments and call the command."""
        _current.set(_NOTHING_CALLED)
        return self._built(*args, **settings)


def _as_text(command: Any) -> Any:
    """Mark brackets in help texts as text, which Rich takes for markup as in "[kg]"; join the lines of paragraphs.

    A flag shows no type.
    """
    for one in (*command.params, command.get_help_option(typer.Context(command, help_option_names=HELP_OPTIONS))):
        if getattr(one, "is_flag", False):
            one.metavar = ""
    for one in (command, *command.params):
        if one_help := getattr(one, "help", None):
            one.help = "\n\n".join(escape(part.replace("\n", " ")) for part in one_help.split("\n\n"))
    for below in getattr(command, "commands", {}).values():
        _as_text(below)
    return command


def _paths(value: object) -> Iterator[Path]:
    """Yield the paths in the value of a parameter; a text may be one, like that of a public key."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str) and type(value) is str and value:
        yield Path(value)
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _paths(one)


def forcing(*options: str) -> Any:
    """Declare the option that lets a command replace what these name."""
    words = f"Replace files of {', '.join(options)} that are there."
    return typer.Option("--force", help=words, rich_help_panel=_OUTPUT)


JSON = {"json_file": ("--json", Writes.FILE)}
"""How every command writes its result."""
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The run's folder.")]
JsonOption = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON to FILE; '-' is standard output.",
        rich_help_panel=_OUTPUT,
    ),
]
AllowMotion = Annotated[
    bool,
    typer.Option("--allow-motion", help="Let real arms move without asking: the cell is clear, a person watches it."),
]
