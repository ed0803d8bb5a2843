"""``report``: what it writes, what is refused, and when its exit code is 1."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cell.run import RunFile
from cellapp.commands.stages import DATA_MARK, data_mark
from cellapp.ground.errors import CheckFailed
from cellapp.interfaces.page import page
from tests.program import app

RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def blank_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands on the page is tested with the page; here it is only written."""

    def write(run: RunFile) -> Path:
        page = run.folder / "report.html"
        page.write_text(f'<meta name="{DATA_MARK}" content="{data_mark(run)}">', encoding="utf-8")
        return page

    monkeypatch.setattr(page, "write_page", write)


def test_strict_fails_only_where_something_is_out_of_date(finished_copy: Path) -> None:
    assert RUNNER.invoke(app, ["report", str(finished_copy), "--strict"]).exit_code == 0
    with RunFile.open(finished_copy, write=True) as run:
        name = run.arms()[0]
        readings = run.readings(name)
        again = readings.take([0])
        run.add_readings(name, type(again)(**{**vars(again), "configuration": again.configuration + 10_000}))
    assert RUNNER.invoke(app, ["report", str(finished_copy)]).exit_code == 0
    ended = RUNNER.invoke(app, ["report", str(finished_copy), "--strict", "--json", str(finished_copy / "r.json")])
    assert isinstance(ended.exception, CheckFailed)
    assert "'calibrate' is out of date (1 reading" in str(ended.exception)
    assert "'verify' is out of date" in str(ended.exception)
    assert "calibrate" in json.loads((finished_copy / "r.json").read_text("utf-8"))["out_of_date"]
    assert (finished_copy / "report.html").is_file(), "the page is written all the same"
