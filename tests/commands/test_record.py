"""What a record declares beyond plain fields reaches the command line: words, types."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pytest
from pydantic import BeforeValidator
from typer.testing import CliRunner

from cellapp.commands.record import Asked, Request, Variant, Verb, View, Work
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.derived import command_of, group_of


class ToyRequest(Request):
    """Do a toy's work."""

    cell: Annotated[Path | None, Asked("The cell.", "CELL", argument=True, needed=True)] = None
    sides: Annotated[
        tuple[str, ...],
        BeforeValidator(lambda given: ("left", "right") if given == "both" else given),
        Asked("Sides.", typed=Literal["both"] | None),
    ] = ()
    parts: Annotated[tuple[str, ...], Asked("Parts.")] = ()
    count: Annotated[int, Asked("How many.", label="how many")] = 3
    word: Annotated[str, Asked("A word.", label="word")] = ""


VERB = Verb(
    "toy",
    ToyRequest,
    chapter="toy",
    question="Toy?",
    variants={"all": Variant("All.", {"parts": ("a", "b")}), "one": Variant("One.", {"parts": ("a",)})},
)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[ToyRequest]:
    """The requests that the verb was run with."""
    requests: list[Any] = []

    def run(verb: Verb, request: Request, work: Work) -> Any:
        requests.append(request)

    monkeypatch.setattr(Verb, "run", run)
    monkeypatch.setattr(Verb, "view", lambda verb, result, request: View())
    monkeypatch.setattr("cellapp.interfaces.cli.job.Job.result", lambda job, result: None)
    return requests


def test_words_after_a_verb_fix_fields_and_the_first_may_be_left_out(asked: list[ToyRequest]) -> None:
    app = Commands()
    app.callback()(lambda: None)
    app.add_typer(group_of(VERB), name=VERB.name)
    for words in (["all", "c.yaml"], ["c.yaml", "--sides", "both"], ["one", "c.yaml", "--count", "1"]):
        assert CliRunner().invoke(app, ["toy", *words]).exit_code == 0
    assert asked == [
        ToyRequest(cell=Path("c.yaml"), parts=("a", "b")),
        ToyRequest(cell=Path("c.yaml"), parts=("a", "b"), sides=("left", "right")),
        ToyRequest(cell=Path("c.yaml"), parts=("a",), count=1),
    ]
    assert CliRunner().invoke(app, ["toy", "all"]).exit_code == 2, "the command line needs the cell"


def test_a_field_has_the_type_of_the_command_line() -> None:
    parameters = inspect.signature(command_of(VERB)).parameters
    assert list(parameters) == ["cell", "sides", "parts", "count", "word", "json_file"]
    assert get_args(parameters["sides"].annotation)[0] == Literal["both"] | None
