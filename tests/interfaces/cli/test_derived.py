"""What a command that is made from a record shows: announced results, refusals, results that are JSON themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from typer.testing import CliRunner

from cellapp.commands.record import Asked, Request, Verb, View, Work
from cellapp.ground.errors import InputError
from cellapp.ground.results import Result
from cellapp.interfaces.cli.command_outputs import Commands
from cellapp.interfaces.cli.derived import command_of


class ToyRequest(Request):
    """Say what kind of result it is."""

    kind: Annotated[Literal["served", "refused", "json"], Asked("Which.", argument=True)]


class ToyResult(Result, schema="cellapp-toy"):
    """What was asked for."""

    kind: str


class Toy(Verb):
    """A verb without a folder of its own."""

    def run(self, request: Request, work: Work) -> ToyResult:
        assert isinstance(request, ToyRequest)
        result = ToyResult(kind=request.kind)
        if request.kind == "served":
            work.announce(result)
            work.say("serving")
        return result

    def view(self, result: Result, request: Request | None = None) -> View:
        assert isinstance(result, ToyResult)
        refused = "not done" if result.kind == "refused" else ""
        return View((f"kind {result.kind}",), refused=refused, is_json=result.kind == "json")


def called(*arguments: str) -> tuple[str, BaseException | None]:
    app = Commands()
    app.command("toy")(command_of(Toy("toy", ToyRequest, chapter="")))
    ended = CliRunner().invoke(app, arguments)
    return ended.output, ended.exception


def test_a_result_that_was_announced_is_not_shown_again(tmp_path: Path) -> None:
    file = tmp_path / "served.json"
    assert called("served", "--json", str(file)) == ("kind served\nserving\n", None)
    assert json.loads(file.read_text("utf-8"))["kind"] == "served"


def test_a_refusal_that_the_work_showed_comes_after_the_result(tmp_path: Path) -> None:
    file = tmp_path / "refused.json"
    output, error = called("refused", "--json", str(file))
    assert (output, type(error), str(error)) == ("kind refused\n", InputError, "not done")
    assert file.is_file()


def test_a_result_that_is_json_is_shown_or_written(tmp_path: Path) -> None:
    assert called("json") == ("kind json\n", None)
    assert called("json", "--json", str(tmp_path / "new.json")) == ("", None)
