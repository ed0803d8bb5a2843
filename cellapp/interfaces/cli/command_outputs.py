"""Files that a command may write, derived from the declarations of its options; ``--force`` for each that writes.

Arguments and options that several commands share.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

import typer
from rich.markup import escape

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, Writes
from cellapp.ground.shell import filled
from cellapp.interfaces.cli.requests import REMEDY

HELP_OPTIONS = ["-h", "--help"]
_FORCE = "force"
_OUTPUT = "Output"
"""Panel of the options that every command has."""
CommandFunction = TypeVar("CommandFunction", bound=Callable[..., Any])


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


_NAMED = {"DIR": "folder", "PROFILE": "profile", "TARGETS": "targets"}
"""Words for files in quoted commands, and the fields of requests that hold them."""
_ADDED_TO = (Writes.STORE, Writes.OWN_FOLDER)
_NOTHING_CALLED = CommandOutputs()
_current: ContextVar[CommandOutputs] = ContextVar("command_outputs", default=_NOTHING_CALLED)


def current_outputs() -> CommandOutputs:
    """Return the outputs of the running command; without one, outputs that replace no existing file."""
    return _current.get()


class Commands(typer.Typer):
    """A group of commands; each that has an option that writes also has ``--force``.

    All commands are registered before the first call, which builds their parameters; further calls reuse them.
    """

    @functools.cached_property
    def _built(self) -> Callable[..., Any]:
        command: Callable[..., Any] = _as_text(typer.main.get_command(self))
        return command

    def __call__(self, *args: Any, **settings: Any) -> Any:
        """Parse the arguments and call the command."""
        _current.set(_NOTHING_CALLED)
        return self._built(*args, **settings)

    def command(self, name: str | None = None, **settings: Any) -> Callable[[CommandFunction], CommandFunction]:
        """Register a command, as ``typer.Typer.command`` does."""
        register = super().command(name, **settings)

        def registered(function: CommandFunction) -> CommandFunction:
            register(with_force(function))
            return function

        return registered


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


def with_force(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the command with an option ``--force`` to replace files that it writes; unchanged if it writes none."""
    signature = inspect.signature(function, eval_str=True)
    written = {name: how for name, one in signature.parameters.items() if (how := _how(one.annotation)) is not None}
    if not written:
        return function
    options = {name: _option(signature.parameters[name]) for name in written}

    parameters = signature.parameters
    own = {
        word: name for word, name in _NAMED.items() if name in parameters and _said(parameters[name]).metavar == word
    }

    @functools.wraps(function)
    def command(*, force: bool = False, **values: Any) -> Any:
        token = _current.set(_outputs_of(written, options, own, values, force=force))
        result = function(**values)
        _current.reset(token)  # a call that failed keeps its files for the message about it
        return result

    replaced = [option for name, option in options.items() if written[name] not in _ADDED_TO]
    words = f"Replace files of {', '.join(replaced)} that are there."
    flag = typer.Option("--force", help=words, rich_help_panel=_OUTPUT)
    parameter = inspect.Parameter(
        _FORCE, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, flag]
    )
    others = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in parameters.values()]
    command.__signature__ = signature.replace(parameters=[*others, parameter])  # type: ignore[attr-defined]
    return command


def written_by(function: Callable[..., Any]) -> dict[str, Writes]:
    """Return the options of a command that write, and how they do."""
    parameters = inspect.signature(function, eval_str=True).parameters.values()
    return {_option(one): how for one in parameters if (how := _how(one.annotation)) is not None}


def _outputs_of(
    written: dict[str, Writes], options: dict[str, str], own: dict[str, str], values: dict[str, Any], *, force: bool
) -> CommandOutputs:
    named: dict[Writes, dict[str, Path]] = {how: {} for how in Writes}
    for name, how in written.items():
        if values[name] is not None and str(values[name]) != "-":
            named[how][options[name]] = Path(values[name])
    inputs = [path for name, value in values.items() if name not in written for path in _paths(value)]
    files = {word: values[name] for word, name in own.items() if isinstance(values[name], Path)}
    allowed = Outputs(force, tuple(inputs), REMEDY)
    return CommandOutputs(allowed, named[Writes.FILE], named[Writes.FILES], named[Writes.STORE], files)


def _paths(value: object) -> Iterator[Path]:
    """Yield the paths in the value of a parameter; a text may be one, like that of a public key."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str) and type(value) is str and value:
        yield Path(value)
    elif isinstance(value, (list, tuple)):
        for one in value:
            yield from _paths(one)


def _how(annotation: object) -> Writes | None:
    if get_origin(annotation) is not Annotated:
        return None
    return next((one for one in get_args(annotation)[1:] if isinstance(one, Writes)), None)


def _said(parameter: inspect.Parameter) -> Any:
    """Return typer's declaration of a parameter."""
    return next(one for one in get_args(parameter.annotation)[1:] if hasattr(one, "param_decls"))


def _option(parameter: inspect.Parameter) -> str:
    """Return the name of an option as it is typed; typer stores it as the default of the declaration."""
    return str(_said(parameter).default)


ProfilePath = Annotated[Path, typer.Argument(metavar="PROFILE", help="The cell, as YAML.")]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="The run's folder.")]
JsonOption = Annotated[
    str | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON to FILE; '-' is standard output.",
        rich_help_panel=_OUTPUT,
    ),
    Writes.FILE,
]
AllowMotion = Annotated[
    bool,
    typer.Option("--allow-motion", help="Let real arms move without asking: the cell is clear, a person watches it."),
]
Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        metavar="N",
        min=1,
        max=1024,
        help="Processes, each of one thread; all cores if left out; 1: no other.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Compute on the workers of a Dask scheduler, as tcp://HOST:8786."
    ),
]
