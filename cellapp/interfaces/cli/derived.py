"""Commands made from the records of verbs: options from the fields of the request, output from the view."""

from __future__ import annotations

import functools
import inspect
import operator
import os
import sys
from collections.abc import Callable
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import annotated_types
import typer
from pydantic.fields import FieldInfo

from cellapp.commands.record import Asked, Verb, View, Work
from cellapp.interfaces.cli.job import Job, require_none
from cellapp.interfaces.cli.motion import asking
from cellapp.interfaces.cli.options import AllowMotion, JsonOption
from cellapp.interfaces.page import write_page

PASSPHRASE_VARIABLE = "CELLAPP_KEY_PASSPHRASE"
"""Environment variable with the passphrase of a signing key, where nobody can be asked."""


def command_of(verb: Verb) -> Callable[..., None]:
    """The command of a verb, for ``Commands.command``: its signature has an option for each field of the request."""

    def command(*, json_file: str | None = None, allow_motion: bool = False, **values: Any) -> None:
        given = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        with Job(json_file) as job:
            request = verb.asked({name: value for name, value in given.items() if value is not None})
            result = verb.run(request, _work(job, allowed=allow_motion))
            shown = verb.view(result, request)
            show_view(job, shown)
            job.result(result)
            require_none(shown.failed, shown.checks or verb.checks or verb.name)

    own = [
        _parameter(name, field, words)
        for (name, words), field in zip(verb.request.asked(), verb.request.model_fields.values(), strict=True)
    ]
    if verb.moves_arms:
        own.append(_keyword("allow_motion", AllowMotion, False))
    own.append(_keyword("json_file", JsonOption, None))
    command.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]
    command.__doc__ = inspect.getdoc(verb.request)
    return command


def show_view(job: Job, shown: View) -> None:
    """Print the tables and sentences of a view in their order."""
    for part in shown.parts:
        if isinstance(part, str):
            job.say(part)
        else:
            job.show([part])


def _work(job: Job, *, allowed: bool) -> Work:
    return Work(
        job.listen,
        job.control,
        lambda profile_name: asking(job, profile_name, allowed=allowed),
        job.outputs,
        announce=job.result,
        say=job.say,
        write_page=write_page,
        choose=_choose,
        secret=_secret,
    )


def _choose(question: str, answers: tuple[str, ...]) -> str:
    """Ask a person; empty where nobody sits at a terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return ""
    said: str = typer.prompt(f"{question}\n{', '.join(answers)}", err=True, default=answers[0])
    return said.strip() if said.strip() in answers else ""


def _secret(question: str, twice: bool) -> str | None:
    """A passphrase from the environment, else typed unseen; None where nobody sits at a terminal."""
    given = os.environ.get(PASSPHRASE_VARIABLE)
    if given is not None or not sys.stdin.isatty():
        return given
    default = "" if twice else None  # a new one may be empty
    typed: str = typer.prompt(
        question, default=default, show_default=False, hide_input=True, err=True, confirmation_prompt=twice
    )
    return typed


def _parameter(name: str, field: FieldInfo, words: Asked) -> inspect.Parameter:
    """The parameter of a command for a field of a request."""
    bounds = {
        key: getattr(one, "ge" if key == "min" else "le")
        for one in field.metadata
        for key, kind in (("min", annotated_types.Ge), ("max", annotated_types.Le))
        if isinstance(one, kind)
    }
    settings: dict[str, Any] = {"help": words.help, **bounds, **({"metavar": words.metavar} if words.metavar else {})}
    option = words.option or f"--{name.replace('_', '-')}"
    shape = typer.Argument(**settings) if words.argument else typer.Option(option, **settings)
    annotated: Any = Annotated
    annotation = annotated[(_typed(field.annotation), shape, *([words.writes] if words.writes else []))]
    return _keyword(name, annotation, inspect.Parameter.empty if field.is_required() else field.default)


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    default = (list(default) or None) if isinstance(default, tuple) else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _typed(annotation: Any) -> Any:
    """The type as typer reads it: several values as a list; of what may be typed or given by a program, the former."""
    if get_origin(annotation) is tuple:
        return list.__class_getitem__(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return functools.reduce(operator.or_, (one for one in get_args(annotation) if get_origin(one) is not tuple))
    return annotation
