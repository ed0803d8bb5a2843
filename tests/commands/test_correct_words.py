"""What ``correct`` prints explains each of its columns."""

from __future__ import annotations

import pytest

from cellapp.cell.programs.records import CorrectedTarget, CorrectResult
from cellapp.commands.correct import view
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.view.table import Table

pytestmark = pytest.mark.fast


def test_each_size_in_the_table_is_explained_below_it_and_in_the_chapter() -> None:
    target = CorrectedTarget(
        line=3, command="movej", kind="pose", old=(0.1, 0.2, 0.3, 0.0, 0.0, 0.0), new=(0.1, 0.2, 0.301, 0.0, 0.0, 0.0),
        correction_mm=1.0, correction_mrad=0.1, uncertainty_mm=0.02,
    )  # fmt: skip
    table, *lines = view(
        CorrectResult(program="day.script", arm="left", targets=(target,), left=(), assumptions=(), out="out.script")
    ).parts
    assert isinstance(table, Table)
    words = " ".join(map(str, lines))
    chapter = chapter_text("programs")
    for column in ("moves", "turns", "sigma"):
        assert column in [one.title for one in table.columns]
        assert column in words
        assert f"*{column}*" in chapter
    assert "standard uncertainty of a coordinate" in words
