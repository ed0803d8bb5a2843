"""Arms that were not seen at rest after a stop stay in the run file until data or a person say otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.unseen_arms import BY_PERSON, note_at_rest, note_halt, unseen_arms
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.ground.errors import InputError
from cellapp.ground.progress import Halt
from tests.twin import small_twin

LOST = Halt("not seen at rest", "arm left: link lost")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    return RunFile.create(tmp_path / "run", small_twin(4))


def test_a_doubt_survives_a_restart_and_other_arms(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    note_halt(run, "right", Halt("not seen at rest", "arm right: link lost"))
    note_halt(run, "right", Halt("at rest", "seen"))
    note_halt(run, "left", Halt("braking", "commanded"))
    run.close()
    with RunFile.open(run.folder) as again:
        assert {name: arm.reason for name, arm in unseen_arms(again).items()} == {"left": "arm left: link lost"}
        levels = [(event.level, event.text.split(",")[0]) for event in again.events()]
        assert ("error", "arm left: NOT SEEN AT REST") in levels
        first = overview_sentences(run_overview(again))[0]
    assert first.startswith("arm left: NOT SEEN AT REST since 2")
    assert f"cellapp at-rest {run.folder} left" in first


def test_the_first_time_is_kept(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    since = unseen_arms(run)["left"].since
    note_halt(run, "left", Halt("not seen at rest", "again"))
    assert unseen_arms(run)["left"].since == since


def test_a_person_settles_it_once(run: RunFile) -> None:
    note_halt(run, "left", LOST)
    assert note_at_rest(run, "left", BY_PERSON)
    assert not note_at_rest(run, "left", BY_PERSON)
    assert unseen_arms(run) == {}
    assert run.events()[-1].text.startswith("arm left: at rest: a person has seen it at rest")
    with pytest.raises(InputError, match="arm 'middle' not found; arms are left, right"):
        note_at_rest(run, "middle", BY_PERSON)


def test_a_damaged_record_makes_no_arm_safe(run: RunFile) -> None:
    run.write_result("not seen at rest: left", "{}")
    assert "left" in unseen_arms(run)


def test_a_run_that_cannot_be_written_keeps_nothing_from_braking(run: RunFile) -> None:
    run.close()
    note_halt(run, "left", LOST)
