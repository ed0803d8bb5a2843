"""The trial of a person at the cell: a missed bar is shown, and ends the command with exit code 1."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.ground.errors import CheckFailed, HardwareError
from tests.trials import links, person
from tests.trials.person_results import PersonResult, PersonRow, person_table

pytestmark = pytest.mark.fast


def result(*values: float) -> PersonResult:
    return PersonResult(busy=0, rows=(PersonRow.of("Escape", "168 ms", values, 100.0, 50.0),))


@pytest.mark.parametrize(
    ("values", "kept"), [((50.0, 10.0, 100.0), True), ((51.0, 51.0), False), ((1.0, 1.0, 101.0), False),
                         ((1.0, 1.0, float("inf")), False)]
)  # fmt: skip
def test_a_missed_bar_is_shown_and_the_command_fails(
    values: tuple[float, ...], kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = result(*values)
    assert person_table(found).rows[0][-1] == ("yes" if kept else "MISSED")
    assert PersonResult.from_json(found.to_json(), "it") == found
    monkeypatch.setattr(links, "person_trial", lambda *_: found)
    ended = CliRunner().invoke(links.app, ["--person", str(Path("cell.yaml"))])
    assert isinstance(ended.exception, CheckFailed) != kept
    assert kept or getattr(ended.exception, "exit_code", 1) == 1


def test_a_part_that_cannot_be_measured_keeps_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: object) -> list[PersonRow]:
        raise HardwareError("the arms do not move\nwhat was drawn")

    for part in ("pressed", "lost", "from_elsewhere", "connecting"):
        monkeypatch.setattr(person._Trial, part, lambda _: list(result(1.0).rows))
    monkeypatch.setattr(person._Trial, "left", fails)
    monkeypatch.setattr(fails, "__name__", "left")
    found = person.person_trial(Path("cell.yaml"))
    assert len(found.rows) == 4
    assert found.missed() == ("left: the arms do not move",)
