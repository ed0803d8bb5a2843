"""The record of a verb: its request with the words and bounds of every field, and where its run and view stand.

A verb is ``commands/NAME.py`` with

- the typed request, and ``VERB``, its record,
- ``run(request, work) -> Result``, which does the work,
- ``view(result, request) -> View``, which shows the result;

a larger one is a folder with these in ``request.py``, ``run.py`` and, if that grows long, ``view.py``. The help of its
command then waits for ``request.py`` alone: keep that light.

The command's options, the dialog of the terminal application and the handbook's list of commands follow from these.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from cellapp.ground.control import JobControl
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, Outputs, Writes

if TYPE_CHECKING:
    from cellapp.cell.run import RunFile
    from cellapp.commands.view.parts import Part
    from cellapp.ground.results import Result


@dataclass(frozen=True)
class Asked:
    """How to ask a person for a field of a request; part of the field's annotation.

    Attributes
    ----------
    help : str
        What the field means, as a sentence.
    metavar : str
        Placeholder of the value in the help of the command line, as ``DIR``.
    argument : bool
        Whether it is a positional argument of the command line instead of an option ``--name``.
    option : str
        Name of the option; if empty, ``--`` and the field's name.
    label, unit : str
        Words before the field in a dialog, and its unit. A dialog does not ask for a field without a label.
    hint : str
        What a dialog shows in the empty field.
    simulated : bool
        Whether it is for simulated cells only.
    suffixes : tuple of str
        Suffixes of the files that a dialog proposes for a path; any file if empty.
    words : mapping
        Value -> its name in a dialog, for a field with several values.
    of : str
        Field without which this one has no meaning: one that is given needs that one, too.
    writes : Writes or None
        How the file or folder that the path names is written.
    typed : type or None
        Type on the command line if it is not the field's type; a validator of the field converts it.
    """

    help: str
    metavar: str = ""
    argument: bool = False
    option: str = ""
    label: str = ""
    unit: str = ""
    hint: str = ""
    simulated: bool = False
    suffixes: tuple[str, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    of: str = ""
    writes: Writes | None = None
    typed: Any = None


class Request(BaseModel):
    """What a verb is asked for. Subclasses declare the fields, each ``Annotated`` with ``Asked``; immutable."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        defer_build=True,  # most starts of the program build at most one request
    )

    @classmethod
    def asked(cls) -> Iterator[tuple[str, Asked]]:
        """Yield the name and words of each field, in the order of their declaration."""
        for name, declared in cls.model_fields.items():
            yield name, next(one for one in declared.metadata if isinstance(one, Asked))

    @model_validator(mode="after")
    def _each_with_its_own(self) -> Self:
        """Refuse a field without the one that it belongs to."""
        for name, words in self.asked():
            given = getattr(self, name) != type(self).model_fields[name].default
            if words.of and given and not getattr(self, words.of):
                raise ValueError(f"{self.option_of(name)} belongs to {self.option_of(words.of)}; add it")
        return self

    def job_name(self) -> str:
        """Say what its job is called, where that says more than the verb's name; else empty."""
        return ""

    @classmethod
    def option_of(cls, name: str) -> str:
        """Say how the command line calls a field: its option, or the metavar of an argument."""
        words = dict(cls.asked())[name]
        return words.metavar if words.argument else words.option or f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class View:
    """A result for people: sentences, tables and charts in reading order. The interfaces draw it.

    Attributes
    ----------
    parts : sequence of Part
        Contents in reading order; plain text leaves the charts out.
    failed : sequence of str
        Checks that failed, a sentence each.
    checks : str
        Subject of the message that checks failed; if empty, ``checks`` of the verb.
    refused : str
        Why nothing was done, if only the work itself could find out; empty if something was done.
    is_json : bool
        Whether the parts are the result's JSON; they are not shown if that goes to a file.
    held : str
        One line for a run without failures, as "the calibration holds"; empty if "done" is enough.
    """

    parts: Sequence[Part] = ()
    failed: Sequence[str] = ()
    checks: str = ""
    refused: str = ""
    is_json: bool = False
    held: str = ""


def _no_page(*_: object) -> Any:
    raise InputError("this interface draws no page of a run or a certificate")


Ask = Callable[[str], bool]
"""Shows a person the first motion in words; returns whether the person allows it."""


@dataclass(frozen=True)
class Work:
    """What an interface gives to the job that it starts.

    Attributes
    ----------
    control : JobControl
        Takes the progress; asks for pause and stop.
    certificate_page : callable
        Result of a certificate -> its page as HTML.
    ask : callable
        Name of the profile -> callable that asks a person before real arms move first; None if nobody can be asked.
    outputs : Outputs
        Which existing files may be replaced.
    announce, say : callable
        Show a result, or a sentence, before the verb ends, as the addresses of a server. A result that was announced is
        not shown again at the end.
    choose : callable
        (question, possible answers) -> the answer of a person; empty if nobody can be asked.
    write_page : callable
        Write the page of a run into its folder; return its path.
    """

    control: JobControl = field(default_factory=JobControl)
    ask: Callable[[str], Ask | None] = field(default=lambda profile_name: None)
    outputs: Outputs = NEW_ONLY
    certificate_page: Callable[[Any], str] = field(default=_no_page)
    announce: Callable[[Result], None] = field(default=lambda result: None)
    say: Callable[[str], None] = field(default=lambda sentence: None)
    write_page: Callable[[RunFile], Path] = field(default=_no_page)
    choose: Callable[[str, tuple[str, ...]], str] = field(default=lambda question, answers: "")


@dataclass(frozen=True)
class Variant:
    """A word after the verb's name: its help, and the fields that it sets."""

    help: str
    fixed: Mapping[str, Any]


@dataclass(frozen=True)
class Stored:
    """How to show a result that a verb stored in a run.

    Attributes
    ----------
    part : str
        Its name on the command line of ``show``.
    missing : str
        Begin of the message if there is none, as "no calibration is".
    stages : tuple of str
        Names of the stages that may hold it; the first one present is shown.
    made_by : str
        The command that stores it, without ``cellapp``; the verb's name if empty.
    view : str
        Name of the function beside the verb's ``view`` that shows it.
    """

    part: str
    missing: str
    stages: tuple[str, ...]
    made_by: str = ""
    view: str = "view"


@dataclass(frozen=True)
class Verb:
    """The record of a verb.

    Attributes
    ----------
    name : str
        Name on the command line.
    request : type of Request
        Its fields are the options; its docstring is the help of the command.
    moves_arms : bool
        Whether arms may move. A person is asked before real arms do.
    chapter : str
        Chapter of the handbook about it.
    question : str
        Title of its dialog.
    checks : str
        Subject of the message that something in ``View.failed`` does not hold; the name if empty.
    variants : mapping
        Word -> fields that it sets, for a verb followed by one of several words; the first word may be left out.
    stored : tuple of Stored
        Results that it stores in a run and that can be shown.
    """

    name: str
    request: type[Request]
    chapter: str
    moves_arms: bool = False
    question: str = ""
    checks: str = ""
    variants: Mapping[str, Variant] = field(default_factory=dict)
    stored: tuple[Stored, ...] = ()

    @property
    def summary(self) -> str:
        """Summary in one sentence."""
        return (self.request.__doc__ or "").strip().split("\n", 1)[0]

    @property
    def results(self) -> tuple[type[Result], ...]:
        """Types of its result, from the annotation of ``run``."""
        declared = get_type_hints(self._part("run").run)["return"]
        return get_args(declared) or (declared,)

    @property
    def opens_run(self) -> bool:
        """Whether it works on an existing run, which its field ``folder`` names."""
        return ("folder", _RUN) in self.request.asked()

    def is_needed(self, field: str) -> bool:
        """Return whether a field of its request must be given."""
        return self.request.model_fields[field].is_required()

    def asked(self, values: Mapping[str, Any], named: Callable[[str], str] | None = None) -> Request:
        """Build the request from the values of its fields.

        Raises ``InputError`` with the field, as ``named`` calls it (by its option if not given), and the reason.
        """
        try:
            return self.request.model_validate(values)
        except ValidationError as error:
            from cellapp.cell.profile.messages import value_message  # late: needed only for a message

            first = error.errors(include_url=False)[0]
            name = (named or self.request.option_of)(str(first["loc"][0])) if first["loc"] else ""
            raise InputError(": ".join(filter(None, (self.name, name, value_message(first))))) from None

    def run(self, request: Request, work: Work) -> Result:
        """Run the verb."""
        result: Result = self._part("run").run(request, work)
        return result

    def view(self, result: Result, request: Request | None = None) -> View:
        """Show a result; ``request`` is what was asked for, None for a stored result."""
        view: View = self._part("view").view(result, request)
        return view

    def stored_view(self, stored: Stored, result: Result) -> View:
        """Show one of its stored results."""
        view: View = getattr(self._part("view"), stored.view)(result)
        return view

    def _part(self, name: str) -> Any:
        """Return a module of the verb's folder, or its only file; import it now: that may take a second."""
        folder, _, own = self.request.__module__.rpartition(".")
        if own == "request":
            own = name if importlib.util.find_spec(f"{folder}.{name}") else "run"
        return importlib.import_module(f"{folder}.{own}")


# -- fields that the requests of several verbs have --------------------------------------------------------------------

_RUN = Asked("The run's folder.", "DIR", argument=True)
RunFolder = Annotated[Path, _RUN]
ProfilePath = Annotated[Path, Asked("The cell, as YAML.", "PROFILE", argument=True)]
TargetsPath = Annotated[Path | tuple[Any, ...], Asked("Target list: .yaml or .csv.", "TARGETS", argument=True)]
"""A list's file; a program that has targets may give them as they are."""
NewRun = Annotated[Path, Asked("Folder of the new run; must not hold one yet.", "DIR", option="--run")]
OutOfDate = Annotated[bool, Asked("Use the latest model even if it no longer fits the run's data.")]
Strict = Annotated[bool, Asked("Exit code 1 if a result, the page or the certificate is out of date.")]


def six_numbers(option: str, text: str, expected: str) -> list[float]:
    """Parse six numbers that a person typed for an option. Raises ``InputError``, which says what is ``expected``."""
    with suppress(ValueError):
        numbers = [float(part) for part in text.removeprefix("p").strip("[] ").split(",")]
        if len(numbers) == 6 and all(map(math.isfinite, numbers)):
            return numbers
    raise InputError(f"{option}: expected {expected}; not '{text}'")
