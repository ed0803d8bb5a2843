"""What is out of date is said, and is an error where that is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.sqlite_file import REPORT_FILE
from cellapp.commands.report.result import read_results
from cellapp.commands.report.run import report_run
from cellapp.commands.show.overview import run_overview
from cellapp.commands.stages import CERTIFICATE_FILE, append_stage, basis_of, complaints_in, complaints_of
from cellapp.ground.results import VERIFY
from cellapp.interfaces.page.page import write_page


def test_a_page_is_out_of_date_as_soon_as_the_run_holds_something_newer(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        assert complaints_of(run) == []
        report_run(run, write_page)
        assert complaints_of(run) == []
        verify = read_results(run).verify
        assert verify is not None
        append_stage(run, VERIFY, verify.model_copy(update={"stopped": "by hand"}), basis_of(run))
        (complaint,) = complaints_of(run)
        assert complaint.startswith(f"{REPORT_FILE} is out of date (the run has changed since)")
        assert run_overview(run).complaints == (complaint,)
    assert complaints_in(finished_copy) == [complaint]


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"<html>an older page</html>"], ids=["empty", "bytes", "older"])
def test_a_page_that_does_not_say_what_it_shows_is_out_of_date(finished_copy: Path, content: bytes) -> None:
    (finished_copy / REPORT_FILE).write_bytes(content)
    with RunFile.open(finished_copy) as run:
        (complaint,) = complaints_of(run)
    assert "an older version wrote it" in complaint


def test_a_certificate_that_the_run_does_not_store_is_named(finished_copy: Path) -> None:
    (finished_copy / CERTIFICATE_FILE).write_text("{}")
    with RunFile.open(finished_copy) as run:
        assert complaints_of(run) == [f"{CERTIFICATE_FILE} is not of this run: it stores no certificate"]
