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
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError

from cellapp.ground.errors import InputError

if TYPE_CHECKING:
    from cellapp.commands.confirm import Ask
    from cellapp.commands.view.table import Table
    from cellapp.ground.control import JobControl
    from cellapp.ground.outputs import Outputs
    from cellapp.ground.progress import Listener
    from cellapp.ground.results import Result


class Writes(Enum):
    """How a path that a field names is written."""

    FILE = "the file itself; looked at before the command begins"
    FILES = "a file, or several that are named after it; looked at when they are written"
    FOLDER = "files in a folder; looked at when they are written"
    STORE = "a store of results, to which is added; never replaced"
    OWN_FOLDER = "a folder that is new, or is continued; never replaced"


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
    needed: bool = False
    typed: Any = None


class Request(BaseModel):
    """What a verb is asked for. Subclasses declare the fields, each ``Annotated`` with ``Asked``; immutable."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @classmethod
    def asked(cls) -> Iterator[tuple[str, Asked]]:
        """Name and words of each field, in the order of their declaration."""
        for name, declared in cls.model_fields.items():
            yield name, next(one for one in declared.metadata if isinstance(one, Asked))

    def moves(self) -> bool:
        """Whether the arms may move for this request of a verb that moves arms."""
        return True

    @classmethod
    def option_of(cls, name: str) -> str:
        """How the command line calls a field: its option, or the metavar of an argument."""
        words = dict(cls.asked())[name]
        return words.metavar if words.argument else words.option or f"--{name.replace('_', '-')}"


@dataclass(frozen=True)
class View:
    """A result for people: tables and sentences in the order in which they are read; ``failed`` says what did not hold.

    Interfaces draw it: as text in a terminal, as widgets, as HTML.
    """

    parts: Sequence[Table | str] = ()
    failed: Sequence[str] = ()


@dataclass(frozen=True)
class Work:
    """What a job has from the interface that started it.

    Attributes
    ----------
    listener, control
        Progress goes to the one, pause and stop come from the other.
    ask : callable
        Profile's name -> what asks a person before the first motion of real arms; None where nobody can be asked.
    outputs : Outputs
        What may be replaced.
    announce, say : callable
        Show a result, or a sentence, before the verb ends, as the addresses of a server.
    choose : callable
        Question and possible answers -> the answer of a person; empty where nobody can be asked.
    secret : callable
        Question, and whether it is asked twice -> what a person typed unseen; None where nobody can be asked.
    """

    listener: Listener
    control: JobControl
    ask: Callable[[str], Ask | None]
    outputs: Outputs
    announce: Callable[[Result], None] = field(default=lambda result: None)
    say: Callable[[str], None] = field(default=lambda sentence: None)
    choose: Callable[[str, tuple[str, ...]], str] = field(default=lambda question, answers: "")
    secret: Callable[[str, bool], str | None] = field(default=lambda question, twice: None)


@dataclass(frozen=True)
class Variant:
    """A word after the verb's name: its help, and the fields that it fixes."""

    help: str
    fixed: Mapping[str, Any]


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
    """

    name: str
    request: type[Request]
    chapter: str
    moves_arms: bool = False
    question: str = ""
    checks: str = ""
    variants: Mapping[str, Variant] = field(default_factory=dict)

    @property
    def summary(self) -> str:
        """What it does, in one sentence."""
        return (self.request.__doc__ or "").strip().split("\n", 1)[0]

    @property
    def result(self) -> Any:
        """Type of its result, as its run declares it."""
        return get_type_hints(self._part("run").run)["return"]

    def asked(self, values: Mapping[str, Any], named: Callable[[str], str] | None = None) -> Request:
        """The request with these values of its fields.

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
        result: Result = self._part("run").run(request, work)
        return result

    def view(self, result: Result, request: Request | None = None) -> View:
        """How a result is shown; ``request`` is what was asked for, None for a result that is stored."""
        view: View = self._part("view").view(result, request)
        return view

    def _part(self, name: str) -> Any:
        """A module of the verb's folder, loaded when it is needed: each may take a second."""
        return importlib.import_module(f"{self.request.__module__.rpartition('.')[0]}.{name}")
