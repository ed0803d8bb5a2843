"""A plan is rehearsed on emulated controllers, rung by rung; the record beside the profile is found by collect."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.driving.records import RehearsedMotion, RehearseResult
from cellapp.cell.driving.rehearsal_rungs import RUNGS
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.file import note_profile, rehearsals_path
from cellapp.commands.rehearse.request import RehearseRequest
from cellapp.commands.rehearse.result import RehearsalLog, arms_hash, keep_log, kept_log, read_log, write_log
from cellapp.commands.rehearse.run import run as rehearse
from cellapp.commands.rehearse.view import log_section, view
from cellapp.commands.view.table import Table
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import ignore_words
from drivers.arms.ur_settings import UrSettings
from tests.commands.emulated_cell import emulated, patiently, quiet_work, stalled
from tests.commands.test_emulate import CLI_HOSTS, PACE, wire_profile
from tests.sure import sure

pytestmark = pytest.mark.waits


def one_rung(path: Path, say: Callable[[str], None] = ignore_words, **asked: Any) -> RehearseResult:
    """A rung; a person begins it again where this computer stalled."""
    request = RehearseRequest(profile=path, run_folder=path.parent / "rehearsal", **asked)

    def begun(_: int) -> tuple[RehearseResult, list[str]]:
        said = list[str]()
        result = rehearse(request, quiet_work(said.append))
        if stalled(result.ended):
            raise HardwareError(result.ended)
        return result, said

    result, said = patiently(begun)
    for words in said:
        say(words)
    assert RehearseResult.from_json(result.to_json(), "test") == result
    return result


def on_real_arms(profile: Profile) -> Profile:
    """The same cell at addresses that are not on this computer."""
    arms = {
        name: arm.model_copy(update={"driver": UrSettings(host=f"192.0.2.{number}")})
        for number, (name, arm) in enumerate(profile.arms.items(), start=1)
    }
    return profile.model_copy(update={"arms": arms})


def test_the_rungs_are_climbed_one_by_one(tmp_path: Path) -> None:
    path, said = wire_profile(tmp_path), list[str]()
    profile = load_profile(path)
    with emulated(profile, CLI_HOSTS, PACE, simulation=True):
        whole = one_rung(path)
        too_early = one_rung(path, said.append, rung="one-arm")
    assert (whole.rung, whole.ended, whole.arms) == ("simulation", "", ("left", "right"))
    assert len(whole.visited) + len(whole.refused) == profile.plan.stops - len(
        profile.plan.reserves(profile.plan.stops)
    )
    assert len(whole.visited) >= 10
    assert all(math.isfinite(one.seconds) and one.seconds > 0.0 for one in whole.motions)
    assert max(off for one in whole.motions for off in one.off_mrad.values()) < 1.0
    assert whole.missing == ("one-arm", "ten-stops", "both-arms")
    assert "simulation mode" in too_early.ended, "real rungs need real arms"
    assert view(too_early).failed == (too_early.ended,)
    assert not too_early.visited
    assert said == []
    with emulated(profile, CLI_HOSTS, PACE):
        refused = one_rung(path, rung="simulation")
        assert "it drives the real arm" in refused.ended
        first = one_rung(path, said.append, rung="one-arm", arm="right")
        assert (first.arms, len(first.visited), first.missing[0]) == (("right",), 1, "simulation")
        assert said == ["rehearse: not passed yet before 'one-arm': simulation"]
    slow = next(one for one in first.motions if one.stop is not None)
    fast = next(one for one in whole.motions if one.stop == slow.stop)
    assert slow.expected_s > 5.0 * fast.expected_s
    log = read_log(path, profile)
    assert log.rungs["one-arm"] == first.model_copy(update={"missing": ()})


def test_collect_says_what_is_missing_of_real_arms_only(tmp_path: Path) -> None:
    path = wire_profile(tmp_path)
    profile = load_profile(path)
    with RunFile.create(tmp_path / "emulated", profile) as run:
        note_profile(run, path)
        assert keep_log(run) == ""
        assert kept_log(run) is None, "nothing was rehearsed"
    with RunFile.create(tmp_path / "real", on_real_arms(profile)) as run:
        assert keep_log(run).startswith(f"not rehearsed with these arms: {', '.join(RUNGS)}; ")
        note_profile(run, path)
        rehearsals_path(path).write_text("{}")
        assert "rehearsals.json" in keep_log(run)


def test_a_run_keeps_what_was_rehearsed_before_it_was_collected(tmp_path: Path) -> None:
    path = wire_profile(tmp_path)
    profile = load_profile(path)
    driven = RehearsedMotion(stop=1, seconds=2.0, expected_s=1.9, off_mrad={"left": 0.25, "right": 0.5})
    passed = RehearseResult(
        rung="simulation", arms=("left", "right"), when="2026-11-26T10:00:00+00:00", controllers={}, visited=(1,),
        refused={2: "a link would touch the table"}, motions=(driven,),
    )  # fmt: skip
    ended = passed.model_copy(update={"rung": "one-arm", "arms": ("left",), "visited": (), "ended": "protective stop"})
    write_log(path, RehearsalLog(arms=arms_hash(profile), rungs={"simulation": passed, "one-arm": ended}))
    with RunFile.create(tmp_path / "run", profile) as run:
        note_profile(run, path)
        keep_log(run)
        rehearsals_path(path).unlink()
        kept = kept_log(run)
    section = log_section(sure(kept))
    assert section.message == "1 of 4 rungs passed before the readings were taken."
    (table,) = section.parts
    assert isinstance(table, Table)
    assert table.rows[0] == ("simulation", passed.when, "left, right", 1, 1, 0.5, "passed")
    assert [row[-1] for row in table.rows[1:]] == ["protective stop", "not driven", "not driven"]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"rung": "one-arm", "arm": "third"}, "no such arm; arms are left, right"),
        ({"rung": "both-arms", "arm": "left"}, "'both-arms' drives all arms"),
    ],
)
def test_bad_requests_are_one_sentence(tmp_path: Path, asked: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        one_rung(wire_profile(tmp_path), **asked)


def test_simulated_arms_have_nothing_to_rehearse(tmp_path: Path) -> None:
    path = wire_profile(tmp_path).with_name("twin.yaml")
    with pytest.raises(InputError, match=r"arm left, right of .* has no controller"):
        one_rung(path)
