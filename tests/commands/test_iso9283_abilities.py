"""A tolerance below what the tracker can tell is said before the first visit, and stands in the result."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.driving.iso9283 import reach
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283.run import iso9283_run
from cellapp.commands.iso9283.view import iso9283_sentences, iso9283_tables
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Notice, Progress
from tests.commands.test_iso9283 import asked, left_alone


def strict(decision: str) -> Profile:
    profile = left_alone()
    tolerances = {"pose_repeatability": 0.02e-3, "distance_repeatability": 5e-3, "decision": decision}
    return profile.model_copy(update={"tolerances": profile.tolerances.model_copy(update=tolerances)})


@pytest.mark.parametrize("decision", ["guarded", "simple"])
def test_it_is_said_before_the_first_visit(decision: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reach, "_SEEDS", 4)
    heard: list[str] = []

    def listen(event: Progress) -> None:
        if isinstance(event.detail, Notice):
            heard.append(event.detail.text)
        elif event.job == "iso9283":
            heard.append("visit")

    with RunFile.create(tmp_path / "run", strict(decision)) as run:
        result = iso9283_run(run, asked(run, tests=["pose", "distance"], cycles=2), listen)
    if decision == "simple":
        assert set(heard) == {"visit"}
        assert result.abilities == ()
        return
    said = [words for words in heard if words != "visit"]
    assert heard.index("visit") == len(said)
    (words,) = [one for one in said if one.startswith("pose repeatability of arm left: the tolerance of 0.02 mm")]
    assert "would do" in words
    assert words in iso9283_sentences(result)
    assert {one.characteristic for one in result.abilities} >= {"pose_repeatability", "distance_repeatability"}
    (told,) = [one for one in result.abilities if one.characteristic == "distance_repeatability"]
    assert told.shown_mm < told.tolerance_mm
    assert any(table.title == "Tolerances against what the tracker can tell" for table in iso9283_tables(result))
