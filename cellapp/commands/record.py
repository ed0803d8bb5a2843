"""What a verb is: the request with words and bounds of every field, and by convention where its run and view stand.

A verb is a folder of ``commands`` with

- ``request.py``: the typed request, and ``VERB``, its record; light, as every start of the program loads it;
- ``run.py``: ``run(request, work) -> Result``, which does it;
- ``view.py``: ``view(result, request) -> View``, how the result is shown.

Options of the command line, dialogs of the terminal application and the handbook's list of commands are derived.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError

from cellapp.ground.errors import InputError
from cellapp.ground.outputs import Writes

if TYPE_CHECKING:
    from pathlib import Path

    from cellapp.cell.run import RunFile
    from cellapp.commands.view.parts import Part
    from cellapp.ground.control import JobControl
    from cellapp.ground.outputs import Outputs
    from cellapp.ground.progress import Listener
    from cellapp.ground.results import Result


PASSPHRASE_VARIABLE = "CELLAPP_KEY_PASSPHRASE"
"""Environment variable with the passphrase of a signing key, where nobody can be asked."""


@dataclass(frozen=True)
class Asked:
    """How a person is asked for a field of a request; stands in the field's annotation.

    Attributes
    ----------
    help : str
        What the field means, as a sentence.
    metavar : str
        What stands for its value in the help of the command line, as ``DIR``.
    argument : bool
        Whether the command line takes it by its place instead of by ``--name``.
    option : str
        The option where it is not ``--`` and the field's name.
    label, unit : str
        What stands before it in a dialog, and its unit; a field without a label is not asked for there.
    hint : str
        What an empty field of a dialog shows.
    simulated : bool
        Whether it is for simulated cells only.
    suffixes : tuple of str
        Endings of the files that are proposed for a path; empty: any file.
    words : mapping
        Value -> how a dialog calls it, of a field that takes some of several values.
    writes : Writes or None
        How the path is written that it names.
    secret : str
        "new" or "known" for what is typed unseen, a new one twice; no option takes it: the verb asks ``Work.secret``.
    needed : bool
        Whether the command line needs it although the request has a default.
    typed : type or None
        What the command line takes where that is not the field's type; the field has a validator that reads it.
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
    writes: Writes | None = None
    secret: Literal["", "new", "known"] = ""
    needed: bool = False
    typed: Any = None


class Request(BaseModel):
    """What a verb is asked for. Subclasses declare the fields, each ``Annotated`` with ``Asked``; immutable."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        defer_build=True,  # most starts of the program make one request or none
    )

    @classmethod
    def asked(cls) -> Iterator[tuple[str, Asked]]:
        """Yield the name and words of each field, in the order of their declaration."""
        for name, declared in cls.model_fields.items():
            yield name, next(one for one in declared.metadata if isinstance(one, Asked))

    def moves(self) -> bool:
        """Return whether the arms may move for this request of a verb that moves arms."""
        return True

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
    """A result for people: sentences, tables and charts in the order in which they are read. Interfaces draw it.

    Attributes
    ----------
    parts : sequence of Part
        Plain text leaves the charts out.
    failed : sequence of str
        What did not hold.
    checks : str
        What is said to have failed, where that is not what the verb checks.
    refused : str
        Why nothing was done, where only the work showed that; empty where something was.
    is_json : bool
        Whether the parts are the result's JSON, which is not shown where it is written to a file.
    held : str
        What one line says where nothing failed: "the calibration holds"; empty where "done" says it all.
    """

    parts: Sequence[Part] = ()
    failed: Sequence[str] = ()
    checks: str = ""
    refused: str = ""
    is_json: bool = False
    held: str = ""


def _no_run_page(run: RunFile) -> Path:
    raise InputError(f"{run.path}: no page can be written from here")


def _no_result_page(result: Result, path: Path) -> Path:
    raise InputError(f"{path}: this interface writes no page")


def _no_certificate_page(result: Result) -> str:
    raise InputError("this interface draws no page of a certificate")


def _no_screens(profile: Path, run: Path | None, folder: Path) -> Sequence[Path]:
    raise InputError(f"{folder}: this interface draws no screens")


@dataclass(frozen=True)
class Work:
    """What a job has from the interface that started it.

    Attributes
    ----------
    listener, control
        Progress goes to the one, pause and stop come from the other.
    result_page : callable
        Result and a file -> the HTML page of the result, written to that file.
    certificate_page : callable
        The result of a certificate -> its page as HTML.
    screens : callable
        Profile, folder of a run or None, and a folder -> pictures of the terminal application, written there.
    verbs : sequence of Verb
        All of them, for a verb that speaks of others.
    ask : callable
        Profile's name -> what asks a person before the first motion of real arms; None where nobody can be asked.
    outputs : Outputs
        What may be replaced.
    announce, say : callable
        Show a result, or a sentence, before the verb ends, as the addresses of a server. A result that was announced is
        not shown again when the verb returns it.
    choose : callable
        Question and possible answers -> the answer of a person; empty where nobody can be asked.
    write_page : callable
        Write the page of a run into its folder; its path.
    line : callable
        Question -> a line that a person or a program types; None at the end of the input, or where nobody can be asked.
    secret : callable
        Question, and whether it is asked twice -> what a person typed unseen; None where nobody can be asked.
    """

    listener: Listener
    control: JobControl
    ask: Callable[[str], Callable[[str], bool] | None]
    outputs: Outputs
    verbs: Sequence[Verb] = ()
    result_page: Callable[[Result, Path], Path] = field(default=_no_result_page)
    certificate_page: Callable[[Any], str] = field(default=_no_certificate_page)
    screens: Callable[[Path, Path | None, Path], Sequence[Path]] = field(default=_no_screens)
    announce: Callable[[Result], None] = field(default=lambda result: None)
    say: Callable[[str], None] = field(default=lambda sentence: None)
    write_page: Callable[[RunFile], Path] = field(default=_no_run_page)
    choose: Callable[[str, tuple[str, ...]], str] = field(default=lambda question, answers: "")
    line: Callable[[str], str | None] = field(default=lambda question: None)
    secret: Callable[[str, bool], str | None] = field(default=lambda question, twice: None)


@dataclass(frozen=True)
class Variant:
    """A word after the verb's name: its help, and the fields that it fixes."""

    help: str
    fixed: Mapping[str, Any]


@dataclass(frozen=True)
class Stored:
    """How what a verb stored in a run is shown.

    Attributes
    ----------
    part : str
        What it is called there.
    missing : str
        Subject and verb where there is none, as "no calibration is".
    stages : tuple of str
        Names of the stages in which it is; the first one that is there is shown.
    made_by : str
        What follows ``cellapp`` on the command line to store it; empty: the verb's name.
    view : str
        The function of the verb's view that shows it.
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
        As it is typed on the command line.
    request : type of Request
        Its docstring is the help of the command.
    moves_arms : bool
        Whether arms may move; a person is asked before real ones do.
    chapter : str
        Chapter of the handbook that explains it.
    question : str
        Title of its dialog.
    checks : str
        What is said to have failed where the view names something that does not hold; the name where empty.
    variants : mapping
        Word -> what it fixes, of a verb that is followed by one of several words. The first one may be left out.
    stored : tuple of Stored
        What it stores in a run, as far as that is shown.
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
        """What it does, in one sentence."""
        return (self.request.__doc__ or "").strip().split("\n", 1)[0]

    @property
    def results(self) -> tuple[type[Result], ...]:
        """Types of its result, as its run declares them."""
        declared = get_type_hints(self._part("run").run)["return"]
        return get_args(declared) or (declared,)

    @property
    def opens_run(self) -> bool:
        """Whether it works on a run that is there, which its field ``folder`` names."""
        return any(
            name == "folder" and words.argument and words.metavar == "DIR" for name, words in self.request.asked()
        )

    def is_needed(self, field: str) -> bool:
        """Return whether a field of its request must be given."""
        return self.request.model_fields[field].is_required()

    def asked(self, values: Mapping[str, Any], named: Callable[[str], str] | None = None) -> Request:
        """Return the request with these values of its fields.

        Raises ``InputError`` with the field, as ``named`` calls it (by its option if not given), and the reason.
        """
        try:
            return self.request.model_validate(values)
        except ValidationError as error:
            from cellapp.cell.profile.messages import value_message  # late: only where something is wrong

            first = error.errors(include_url=False)[0]
            name = (named or self.request.option_of)(str(first["loc"][0])) if first["loc"] else ""
            raise InputError(": ".join(filter(None, (self.name, name, value_message(first))))) from None

    def run(self, request: Request, work: Work) -> Result:
        """Do it."""
        do: Callable[[Work], Result] = partial(self._part("run").run, request)
        if not (self.moves_arms or self.stored):
            return do(work)
        from cellapp.commands.notifying import run_notified  # late: it reads profiles and runs

        return run_notified(
            request.job_name() or self.name,
            getattr(request, "profile", None),
            getattr(request, "folder", None),
            work.listener,
            lambda listener: do(replace(work, listener=listener)),
            lambda result: self.view(result, request).failed,
        )

    def view(self, result: Result, request: Request | None = None) -> View:
        """Show how a result is shown; ``request`` is what was asked for, None for a result that is stored."""
        view: View = self._part("view").view(result, request)
        return view

    def stored_view(self, stored: Stored, result: Result) -> View:
        """Show how one of its stored results is shown."""
        view: View = getattr(self._part("view"), stored.view)(result)
        return view

    def _part(self, name: str) -> Any:
        """Return a module of the verb's folder, loaded when it is needed: each may take a second."""
        return importlib.import_module(f"{self.request.__module__.rpartition('.')[0]}.{name}")
