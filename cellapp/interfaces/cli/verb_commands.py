"""Commands derived from the records of verbs: options from the fields of the request, output from the view.

Permission of a person to move real arms: ``--allow-motion``, or the profile's name typed at the terminal.
"""

from __future__ import annotations

import functools
import inspect
import operator
import queue
import sys
import threading
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

import typer
from typer.core import TyperGroup

from cellapp.commands.record import Ask, Asked, Request, Verb, View, Work
from cellapp.commands.registry import MOVES
from cellapp.ground.errors import CheckFailed, InputError
from cellapp.ground.removed import removed_command
from cellapp.interfaces.cli.command_outputs import (
    ADDED_TO,
    JSON,
    NAMED,
    AllowMotion,
    Commands,
    JsonOption,
    calling,
    forcing,
)
from cellapp.interfaces.cli.job import CommandJob
from cellapp.interfaces.page import certificate_page, write_page

if TYPE_CHECKING:
    from cellapp.ground.results import Result


_LOOK_S = 0.1
"""Interval at which a waiting question checks whether the job must end."""
_SHOWN: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("run", "report"), ("calibration", "discovery", "verification")),
    "plan": ("plan",),
}
"""Verb -> the parts of a run that ``show`` shows of it, beside those that it stores."""
_ENDS = (("gt", "more than"), ("ge", "at least"), ("le", "at most"))
"""Ends of a field's range in the words in which the request refuses what is beyond; typer would have its own."""


def asking(job: CommandJob, profile_name: str, *, allowed: bool) -> Ask | None:
    """Return a function that shows the first motion and returns whether it is allowed; None if nobody can be asked."""
    if allowed:

        def show(words: str) -> bool:
            job.warn(words)
            return True

        return show
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None

    def ask(words: str) -> bool:
        job.warn(words)
        question = f"Type '{profile_name}' and Enter to let the arms move; anything else ends this."
        return typed_line(job, question) == profile_name

    return ask


def typed_line(job: CommandJob, question: str) -> str | None:
    """Return the next line of standard input, stripped; None at its end. Ctrl-C also ends the question."""
    job.warn(question)
    answers: queue.Queue[str] = queue.Queue()
    threading.Thread(target=lambda: answers.put(sys.stdin.readline()), name="answer", daemon=True).start()
    while True:
        job.control.check()
        try:
            line = answers.get(timeout=_LOOK_S)
        except queue.Empty:
            continue
        return line.strip() if line else None


class _FirstByDefault(TyperGroup):
    """A group whose first command word may be omitted; it answers for removed words."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and (removed := removed_command(" ".join([*ctx.command_path.split()[1:], args[0]]))):
            raise InputError(removed)
        if args and args[0] not in self.commands and args[0] != "--help":
            args = [next(iter(self.commands)), *args]
        return super().parse_args(ctx, args)


def add_verb(app: Commands, verb: Verb, name: str, panel: str | None = None) -> None:
    """Add the command of a verb; a verb with variants is a group, with a command for each word."""
    if not verb.variants:
        app.command(name, rich_help_panel=panel)(command_of(verb))
        return
    group = Commands(cls=_FirstByDefault, no_args_is_help=True, help=_help(verb))
    for word, variant in verb.variants.items():
        group.command(word, help=_help(verb, variant.help))(command_of(verb, variant.fixed))
    app.add_typer(group, name=name, rich_help_panel=panel)


def _help(verb: Verb, text: str = "") -> str:
    """Return a text about a verb, by default what its request says; marked if arms may move."""
    return (MOVES if verb.moves_arms else "") + (text or inspect.getdoc(verb.request) or "")


def command_of(verb: Verb, fixed: Mapping[str, Any] = MappingProxyType({})) -> Callable[..., None]:
    """Return the command of a verb, for ``Commands.command``; it has an option for each field of the request.

    ``fixed`` are values of fields without an option.
    """

    asked = {name: words for name, words in verb.request.asked() if name not in fixed}
    option = verb.request.option_of
    written = {name: (option(name), words.writes) for name, words in asked.items() if words.writes} | JSON
    named = [words.metavar for name, words in asked.items() if NAMED.get(words.metavar) == name]

    def command(
        *, json_file: str | None = None, allow_motion: bool = False, force: bool = False, **values: Any
    ) -> None:
        given = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        with calling({**values, "json_file": json_file}, written, named, force=force), CommandJob(json_file) as job:
            request = verb.asked({**fixed, **{name: value for name, value in given.items() if value is not None}})
            announced: list[Result] = []

            def announce(result: Result) -> None:
                announced.append(result)
                _show(job, verb, verb.view(result, request), result)

            result = verb.run(request, _work(job, announce, allowed=allow_motion))
            shown = verb.view(result, request)
            if result not in announced:
                _show(job, verb, shown, result)
            if shown.refused:
                raise InputError(shown.refused)
            if shown.failed:
                raise CheckFailed(f"{shown.checks or verb.checks or verb.name}: {'; '.join(shown.failed)}")

    own = [_parameter(verb.request, name, words) for name, words in asked.items()]
    if verb.moves_arms:
        own.append(_keyword("allow_motion", AllowMotion, False))
    own.append(_keyword("json_file", JsonOption, None))
    replaced = [option for option, how in written.values() if how not in ADDED_TO]
    own.append(_keyword("force", Annotated[bool, forcing(*replaced)], False))
    command.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]
    command.__doc__ = _help(verb)
    return command


def _show(job: CommandJob, verb: Verb, shown: View, result: Result) -> None:
    """Print the tables and sentences of a view in their order, then write the JSON of its result."""
    if not (shown.is_json and job.writes_json):
        stored = _SHOWN.get(verb.name) or [one.part for one in verb.stored]
        # a plan that was only checked has no run
        rest = " or ".join("'cellapp show DIR " + part + "'" for part in stored) if getattr(result, "run", "-") else ""
        job.show_view(shown.parts, rest and f"More is stored: {rest} shows all of it.")
    job.result(result)


def _work(job: CommandJob, announce: Callable[[Result], None], *, allowed: bool) -> Work:
    return Work(
        job.control,
        lambda profile_name: asking(job, profile_name, allowed=allowed),
        job.outputs,
        write_page=write_page,
        certificate_page=certificate_page,
        announce=announce,
        say=job.say,
        choose=partial(_choose, job),
    )


def _choose(job: CommandJob, question: str, answers: tuple[str, ...]) -> str:
    """Ask a person; return an empty answer if nobody sits at a terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return ""
    said = typed_line(job, f"{question}\n{', '.join(answers)} [{answers[0]}]:") or answers[0]
    return said if said in answers else ""


def _parameter(request: type[Request], name: str, words: Asked) -> inspect.Parameter:
    """Return the command's parameter for a field of a request."""
    field = request.model_fields[name]
    said = f"With {request.option_of(words.of)}: {words.help}" if words.of else words.help
    ends = [f"{word} {getattr(one, end):g}" for one in field.metadata for end, word in _ENDS if hasattr(one, end)]
    said += f" {', '.join(ends).capitalize()}." if ends else ""
    settings: dict[str, Any] = {"help": said, **({"metavar": words.metavar} if words.metavar else {})}
    shape = typer.Argument(**settings) if words.argument else typer.Option(request.option_of(name), **settings)
    annotated: Any = Annotated
    annotation = annotated[words.typed or _typed(field.annotation), shape]
    return _keyword(name, annotation, inspect.Parameter.empty if field.is_required() else field.default)


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    default = (list(default) or None) if isinstance(default, tuple) else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _typed(annotation: Any) -> Any:
    """Return the type for typer: several values as a list; of a union with a form for programs, the typed form."""
    if get_origin(annotation) is tuple:
        return list.__class_getitem__(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return functools.reduce(operator.or_, (one for one in get_args(annotation) if get_origin(one) is not tuple))
    return annotation
