"""A long job whose output goes to a file is not silent."""

from __future__ import annotations

import pytest

from cellapp.ground import progress
from cellapp.ground.progress import Progress
from cellapp.interfaces.cli.job import Job

pytestmark = pytest.mark.fast


def test_lines_on_standard_error_where_that_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with Job(None) as job:
        job.listen(Progress("iso9283", 3, 10, "pose of left"))
    assert capfd.readouterr() == ("", ""), "a short job says nothing"
    monkeypatch.setattr(progress, "_SILENCE_S", 0.0)
    with Job(None) as job:
        job.listen(Progress("iso9283", 3, 10, "pose of left"))
    assert capfd.readouterr() == ("", "cellapp: iso9283: 3 of 10, pose of left\n")
