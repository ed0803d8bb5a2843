"""Stages of a run: verbs append, nothing edits, and what rests on something that changed is out of date."""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.file import note_profile
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.commands.stages import CALIBRATION_FILE, append_stage, basis_of, read_stages, readings_digest
from cellapp.ground.errors import InputError
from cellapp.ground.results import CALIBRATE, COMPENSATE, DISCOVER, VERIFY
from cellapp.interfaces.page.page import write_page
from cellapp.interfaces.tui.keys import way_to, with_keys
from cellapp.robot.model import CellModel
from tests.sure import sure
from tests.twin import PROFILES, altered, small_twin
from tests.verbs import push_run, report_run

OLD_RUN = Path(__file__).parents[1] / "fixtures" / "run-schema-2"
TARGETS = load_targets(PROFILES / "targets" / "twin.yaml", small_twin())[:2]


def slugs(folder: Path) -> dict[str, list[str]]:
    """Effects of each arm in the exported model."""
    return {
        name: [term.slug for term in arm.effects]
        for name, arm in CellModel.load(folder / CALIBRATION_FILE).arms.items()
    }


def rows(folder: Path) -> list[tuple[Any, ...]]:
    """Every column of every stored stage."""
    connection = sqlite3.connect(folder / "run.sqlite")
    try:
        return list(connection.execute("SELECT * FROM stage ORDER BY number"))
    finally:
        connection.close()


def swap_splits(run: RunFile) -> None:
    """Use ten readings that validated to identify, and the other way round, in both arms alike."""
    for name in run.profile.arms:
        words = list(run.readings(name).split or ())
        identify = [i for i, word in enumerate(words) if word == "identify"][:10]
        validate = [i for i, word in enumerate(words) if word == "validate"][:10]
        for one, other in zip(identify, validate, strict=True):
            words[one], words[other] = words[other], words[one]
        run.assign_splits(name, words)


def test_a_tolerance_of_iso_9283_that_nothing_measured_comes_next(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        write_page(run)
        overview = run_overview(RunState(run))
    assert overview.next_verb == "iso9283"
    assert overview.next_step == f"cellapp iso9283 pose --run {finished_copy}"
    assert with_keys(f"next: {overview.next_step}") == f"next: {way_to('iso9283')}"


@pytest.mark.parametrize(
    ("change", "verb", "says"),
    [
        ("undecided", "push", "Add targets of right and cooperative targets (partner) to the list"),
        ("stopped", "push", "targets/twin.yaml --verify"),
        ("outside", "push", "targets/twin.yaml --verify --iterate 2"),
        ("ambiguous", "discover", "discover DIR --propose 30"),
        ("out of date", "compensate", "targets/twin.yaml"),
    ],
)
def test_something_comes_next_while_anything_is_undecided_failed_or_out_of_date(
    change: str, verb: str, says: str, finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cellapp.commands.next_step._missing_tests", lambda *given: ())
    with RunFile.open(finished_copy, write=True) as run:
        note_profile(run, PROFILES / "twin.yaml")
        results = read_results(run)
        assert results.verify is not None
        assert results.compensate is not None
        assert results.discover is not None
        if change == "stopped":
            verify = results.verify.model_copy(update={"stopped": "stopped after 1 of 2 targets: link lost"})
            append_stage(run, VERIFY, verify, basis_of(run))
        elif change == "outside":
            far = tuple(
                one.model_copy(update={"verdict": "out", "tolerance_mm": 1e-6}) for one in results.verify.targets
            )
            append_stage(run, VERIFY, results.verify.model_copy(update={"targets": far}), basis_of(run))
        elif change == "ambiguous":
            found = {
                name: arm.model_copy(update={"verdict": "ambiguous"}) for name, arm in results.discover.arms.items()
            }
            changed = altered(results, discover={"arms": found})
            monkeypatch.setattr("cellapp.commands.run_state.read_results", lambda run, stages: changed)
        elif change == "out of date":
            append_stage(run, COMPENSATE, results.compensate, basis_of(run).model_copy(update={"profile": "changed"}))
        write_page(run)
        overview = run_overview(RunState(run))
    (said,) = [one for one in overview_sentences(overview) if one.startswith("next: ")]
    assert overview.next_verb == verb
    assert says in said.replace(str(finished_copy), "DIR")


def test_every_stage_states_what_it_rests_on(finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        stages = read_stages(run)
        assert list(stages.current) == ["calibrate", "discover", "compensate", "verify"]
        assert stages.out_of_date == {}
        assert stages.stale_model() == ""
        assert stages.next_step(finished_run) == ""
        assert run_overview(RunState(run)).next_verb == "report"
        calibrate, discover = stages.current[CALIBRATE], stages.current[DISCOVER]
        assert stages.in_force == discover
        assert calibrate.basis is not None
        assert calibrate.basis.readings["left"].sha256 == readings_digest(run.readings("left"))
        assert calibrate.basis.readings["left"].n == 120
        assert calibrate.basis.stages == {}
        assert sure(discover.basis).stages == {"calibrate": calibrate.digest}
        verify = sure(stages.current[VERIFY].basis)
        assert verify.stages == {"discover": discover.digest}
        assert verify.targets is not None
        exported = json.loads((finished_run / CALIBRATION_FILE).read_text("utf-8"))["provenance"]
        assert exported["stage"] == "discover"
        assert exported["basis"]["stages"] == {"calibrate": calibrate.digest}


def test_the_calibration_keeps_its_own_model_and_is_shown_with_the_effects(finished_run: Path) -> None:
    with RunFile.open(finished_run) as run:
        calibrate = read_stages(run).current[CALIBRATE]
        stored = json.loads(calibrate.text)
        assert all("effects" not in arm["validate"] for arm in stored["arms"].values())
        assert "effects" not in stored["pair"]
        assert not any(arm.effects for arm in CellModel.from_json(sure(calibrate.model)).arms.values())
        shown = read_results(run)
    for name, arm in sure(shown.calibrate).arms.items():
        assert arm.best_stage == "effects"
        assert arm.validate_["effects"] == sure(shown.discover).arms[name].validate_["effects"]
    assert sure(shown.calibrate).pair["effects"] == sure(shown.discover).pair["effects"]
    assert slugs(finished_run) == {"left": ["joint_compliance"], "right": ["backlash"]}


def test_calibrating_again_with_the_same_outcome_keeps_the_discovery(finished_copy: Path) -> None:
    before = json.loads((finished_copy / CALIBRATION_FILE).read_text("utf-8"))
    with RunFile.open(finished_copy, write=True) as run:
        notes = calibrate_run(run).notes
        stages = read_stages(run)
    assert stages.out_of_date == {}
    assert stages.in_force == stages.current[DISCOVER]
    assert json.loads((finished_copy / CALIBRATION_FILE).read_text("utf-8")) == before
    assert f"the discovery still holds; {CALIBRATION_FILE} keeps the effects that were found" in notes


def test_calibrating_again_with_another_outcome_outdates_what_rested_on_it(
    finished_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = rows(finished_copy)
    with RunFile.open(finished_copy, write=True) as run:
        swap_splits(run)
        calibrate_run(run)
        reasons = read_stages(run).out_of_date
        assert set(reasons) == {"discover", "compensate", "verify"}
        assert slugs(finished_copy) == {"left": [], "right": []}
        assert report_run(run, write_page).out_of_date == reasons
        monkeypatch.setattr(
            "cellapp.cell.driving.supervision.open_cell", lambda *_, **__: pytest.fail("a device was opened")
        )
        with pytest.raises(InputError, match=r"'discover' is out of date .* nothing was moved. Run 'cellapp discover"):
            push_run(run, TARGETS, verify=True)
    assert rows(finished_copy)[: len(earlier)] == earlier, "no earlier row was touched"


def test_readings_that_are_added_outdate_everything(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        for name in run.profile.arms:
            readings = run.readings(name).take(range(5))
            readings.configuration[:] += 1000
            run.add_readings(name, readings)
        stages = read_stages(run)
        assert set(stages.out_of_date.values()) == {"10 readings were added since"}
        assert set(stages.out_of_date) == set(stages.current)
        assert stages.next_step(finished_copy) == f"cellapp calibrate {finished_copy}"
        with pytest.raises(InputError, match=r"'calibrate' is out of date \(10 readings were added since\)"):
            push_run(run, TARGETS, verify=False)


def test_another_profile_outdates_everything(finished_copy: Path) -> None:
    connection = sqlite3.connect(finished_copy / "run.sqlite")
    text = json.loads(connection.execute("SELECT value FROM meta WHERE key = 'profile'").fetchone()[0])
    text["seed"] += 1
    connection.execute("UPDATE meta SET value = ? WHERE key = 'profile'", (json.dumps(text),))
    connection.commit()
    connection.close()
    with RunFile.open(finished_copy) as run:
        assert set(read_stages(run).out_of_date.values()) == {"the profile was changed since"}


# -- runs of versions before the table of stages ----------------------------------------------------------------------


def test_a_run_from_before_stages_keeps_its_readings_and_is_calibrated_anew(tmp_path: Path) -> None:
    with RunFile.open(Path(shutil.copytree(OLD_RUN, tmp_path / "old"))) as run:
        assert read_stages(run).current == {}
        assert run_overview(RunState(run)).next_step.startswith("cellapp calibrate")
        assert len(run.readings("left"))


def test_a_result_that_cannot_be_read_is_named(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        run.append_stage(DISCOVER, basis_of(run).model_dump_json(), '{"schema": "cellapp-discover"}', None)
        shown = read_results(run)
    assert shown.discover is None
    assert "another version of cellapp stored it" in shown.out_of_date[DISCOVER]
