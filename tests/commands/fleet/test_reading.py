"""What is read of a run: parts of the results that the verbs store, and identities of its arms."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import CONTROLLERS_RESULT, ArmIdentity, ControllerIdentity, arm_identities
from cellapp.commands.fleet.reading import read_record
from cellapp.commands.report.result import read_results
from cellapp.commands.stages import read_stages
from cellapp.ground.profile import Profile
from cellapp.ground.profile.acceptance import Traceability, TraceableArm
from cellapp.ground.results import DISCOVER, VERIFY
from tests.cell.run.small_runs import planned_run
from tests.cell.run.two_arm_cell import two_arms
from tests.twin import small_twin


def test_the_record_of_a_finished_run(finished_run: Path) -> None:
    record = read_record(finished_run)
    assert (record.problem, record.stage, record.notes) == ("", DISCOVER, ())
    with RunFile.open(finished_run) as run:
        results = read_results(run)
        tolerance = run.profile.tolerances.position
    assert tolerance is not None
    assert record.tolerance_mm == pytest.approx(1e3 * tolerance)
    assert results.calibrate is not None
    assert results.discover is not None
    assert results.verify is not None
    for name, arm in record.arms.items():
        own = results.calibrate.arms[name]
        assert arm.geometry is not None
        assert arm.geometry.determined == tuple(own.identified)
        assert arm.effects is not None
        assert [one.effect for one in arm.effects] == [one.effect for one in results.discover.arms[name].accepted]
        assert {one.effect for one in results.discover.arms[name].not_found} == set(arm.smallest)
        (heldout,) = arm.figures["heldout"]
        assert heldout.value == own.validate_["effects"].position_mm.mean
        verified = [point.value for point in arm.figures.get("verified", ())]
        assert verified == [one.compensated_mm.max for one in [results.verify.arms.get(name)] if one is not None]
        assert set(arm.figures) >= {"noise", "temperature"}
    assert set(record.transforms) >= {"method_1", "effects"}


def identities(folder: Path, profile: Profile, serials: dict[str, str]) -> dict[str, ArmIdentity]:
    with planned_run(folder, profile=profile) as run:
        if serials:
            recorded = {name: ControllerIdentity("UR10", serial, "5.1", "") for name, serial in serials.items()}
            run.write_result(CONTROLLERS_RESULT, json.dumps({name: vars(one) for name, one in recorded.items()}))
        return dict(arm_identities(run))


def test_keys_of_another_version_are_passed_over(finished_copy: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        stored = read_stages(run).current[VERIFY]
        later = json.loads(stored.text) | {"of_later": 1}
        for arm in later["arms"].values():
            arm["of_later"] = {"too": 2}
        basis = None if stored.basis is None else stored.basis.model_dump_json()
        run.append_stage(VERIFY, basis, json.dumps(later), None)
    record = read_record(finished_copy)
    assert record.notes == ()
    values = [one.value for arm in record.arms.values() for one in arm.figures.get("verified", ())]
    assert values[0::2] == values[1::2] != []


@pytest.mark.fast
def test_an_arm_is_known_by_its_controller_then_by_the_profile_then_by_names(tmp_path: Path) -> None:
    profile = two_arms()
    given = profile.model_copy(
        update={
            "traceability": Traceability(arms={"left": TraceableArm(serial="P-1"), "right": TraceableArm(serial="P-2")})
        }
    )
    bare = identities(tmp_path / "bare", profile, {})
    assert bare["left"] == ArmIdentity("two, left (left)", "names")
    by_profile = identities(tmp_path / "profile", given, {"right": ""})
    assert [one.key for one in by_profile.values()] == ["P-1", "P-2"]
    by_controller = identities(tmp_path / "controller", given, {"left": "C-1"})
    assert by_controller["left"] == ArmIdentity("C-1", "controller", "C-1")
    assert by_controller["right"].known_by == "profile"
    assert by_controller["right"].is_other_than(ArmIdentity("P-3", "profile", "P-3"))
    assert not by_controller["right"].is_other_than(by_controller["left"]), "numbers of different things"
    assert not bare["left"].is_other_than(bare["right"])


@pytest.mark.fast
def test_a_damaged_record_of_controllers_leaves_the_names(tmp_path: Path) -> None:
    with planned_run(tmp_path / "run") as run:
        run.write_result(CONTROLLERS_RESULT, "[]")
        assert arm_identities(run)["left"].known_by == "names"


@pytest.mark.fast
def test_simulated_arms_have_no_serial_number_of_their_own(tmp_path: Path) -> None:
    profile = small_twin()
    with RunFile.create(tmp_path / "run", profile) as run:
        recorded = {name: vars(ControllerIdentity("simulated", f"SIM-{name}", "", "")) for name in profile.arms}
        run.write_result(CONTROLLERS_RESULT, json.dumps(recorded))
        assert {one.known_by for one in arm_identities(run).values()} == {"names"}
