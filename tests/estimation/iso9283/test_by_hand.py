"""Tests of ISO 9283 with a person at the arm, driven in a simulated cell whose truth is known."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellapp.cell.driving import motion
from cellapp.cell.driving.attendance import SimulatedPerson, by_person
from cellapp.cell.driving.iso9283.findings import missing_words
from cellapp.estimation.iso9283.coverage import coverage
from cellapp.estimation.iso9283.evaluate_compliance import FORCE_DIRECTIONS, force_direction
from cellapp.estimation.iso9283.evaluate_paths import PathTrack
from cellapp.estimation.iso9283.evaluate_weaving import WeavingRuns, weaving_characteristics
from cellapp.estimation.iso9283.records import IsoConditions
from cellapp.ground.control import JobControl
from cellapp.ground.profile import Arm, Profile
from cellapp.ground.progress import Progress, StateChange
from cellapp.robot.model.nominal import joint_rates
from drivers.arms.simulated import SimulatedArm
from tests.cell.planning.planned_cells import one_arm
from tests.estimation.iso9283.test_driving import cell_of, driven, results, task_of

STIFFNESS = 4e4


def elastic(profile: Profile) -> Profile:
    """The cell with springs of 4e4 Nm/rad in all joints of its arms, without noise."""
    assert profile.plant is not None
    effects = {name: {"joint_compliance": {"stiffness": [STIFFNESS] * 6}} for name in profile.arms}
    return profile.model_copy(update={"plant": profile.plant.model_copy(update={"effects": effects, "noise": False})})


def test_static_compliance_is_that_of_the_true_arm_and_nothing_moves_meanwhile() -> None:
    task = task_of(elastic(one_arm()), "compliance", forces=(20.0, 50.0))
    findings, plant = driven(task)
    found = results(task, findings)["left"].tests["nominal"].compliance
    assert [one.direction for one in found] == list(FORCE_DIRECTIONS)
    q = findings.programmes["left", "nominal"].q["P1", "P2"][None]
    assert findings.model is not None
    base_M = findings.model.arms["left"].nominal.T_M_B()[:3, :3]  # near the true one, in which the force is
    free = plant.smr_positions("left", q)[0]
    for one in found:
        plant.set_pull("left", 50.0 * force_direction(one.direction))
        moved = (plant.smr_positions("left", q)[0] - free) @ base_M
        np.testing.assert_allclose(one.steps[-1].displacement_mm, 1e3 * moved, atol=2e-5)
        assert one.compliance_um_n == pytest.approx(1e6 * moved @ force_direction(one.direction) / 50.0, rel=5e-3)
        assert one.left_mm == pytest.approx(0.0, abs=1e-6)
    assert max(one.compliance_um_n for one in found) > 5.0
    steps = [one.words for one in findings.by_person]
    assert len(steps) == 6 * 2 * 4, "six directions, two cycles: none, two forces, none again"
    assert "with 20 N along +x of its base" in steps[1]
    assert all(one.simulated for one in findings.by_person)
    assert missing_words(findings, task.tests) == ()


def test_the_pose_test_with_another_load_is_that_of_the_loaded_arm() -> None:
    task = task_of(elastic(one_arm()), "pose", also_loads=(4.0,))
    findings, plant = driven(task)
    tests = results(task, findings)["left"].tests["nominal"]
    (loaded,) = tests.loads
    assert loaded.payload_kg == 4.0
    programme = findings.programmes["left", "nominal"]
    for light, heavy in zip(tests.pose, loaded.pose, strict=True):
        q = findings.cubes["left"].q[heavy.pose][None]
        error = plant.smr_positions("left", q, payload=np.array([4.0]))[0] - programme.position_M[heavy.pose]
        assert heavy.accuracy.value_mm == pytest.approx(1e3 * np.linalg.norm(error), abs=1e-4)
        assert abs(heavy.accuracy.value_mm - light.accuracy.value_mm) > 0.01
    mass, _ = plant.payload("left")
    assert mass == task.profile.arms["left"].payload.mass, "the profile's load hangs there again"
    arms = results(task, findings)
    made = IsoConditions(
        cycles=2, speed_share=1.0, dwell_s=1.0, averaging_s=1.0, commands=("nominal",), also_loads=(4.0,)
    )
    line = next(one for one in coverage(task.tests, arms, made) if one.clause == "6.6")
    assert "4, " in line.words
    assert "a tenth of the largest: not asked for" in line.words


def test_an_arm_whose_controller_does_not_know_its_load_is_not_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of(cell_of(one_arm()), "pose", also_loads=(4.0,))
    known = SimulatedArm.state
    monkeypatch.setattr(SimulatedArm, "state", lambda arm: replace(known(arm), payload_kg=0.5))
    findings, _ = driven(task)
    tests = results(task, findings)["left"]
    assert tests.tests["nominal"].loads == ()
    assert "not with 4 kg: the payload of its controller is set to 0.500 kg" in tests.refused["pose"]
    assert any("with 4 kg: 0 of 2 cycles" in words for words in missing_words(findings, task.tests))


def test_the_first_motions_with_another_load_are_slow_where_real_arms_move(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[str | float] = []
    hang = SimulatedPerson.hang

    def listened(arm: Arm, speed: float) -> Any:
        heard.append(speed)
        return joint_rates(arm, speed)

    def hung(person: SimulatedPerson, name: str, load_kg: float) -> None:
        heard.append(f"{load_kg:g} kg")
        hang(person, name, load_kg)

    task = task_of(cell_of(one_arm()), "pose", also_loads=(4.0,))
    monkeypatch.setattr(motion, "joint_rates", listened)
    monkeypatch.setattr(SimulatedPerson, "hang", hung)
    monkeypatch.setattr(Profile, "moves_hardware", property(lambda _: True))
    findings, _ = driven(task)
    assert missing_words(findings, task.tests) == ()
    slow = task.profile.collection.slow_start.speed
    after = heard[heard.index("4 kg") + 1 :]
    assert after[:5] == [slow] * 5, "each pose once"
    assert 1.0 in after, "then at the speed of the test"


@pytest.mark.fast
def test_without_a_simulated_person_the_job_pauses_and_says_what_to_do() -> None:
    control, heard, asked = JobControl(), list[Progress](), threading.Event()

    def listen(event: Progress) -> None:
        heard.append(event)
        asked.set()

    def hold() -> None:
        assert control.request == "pause"
        control.wait_while("pause", timeout_s=20.0)

    def forbidden(person: SimulatedPerson) -> None:
        raise AssertionError("nobody acts on a real arm")

    def resume() -> None:
        assert asked.wait(20.0)
        control.resume()

    other = threading.Thread(target=resume)
    other.start()
    by_person(None, forbidden, "hang 4 kg on arm left", control, listen, hold)
    other.join(20.0)
    first, last = (one.detail for one in heard)
    assert first == StateChange("paused", "hang 4 kg on arm left; then resume")
    assert isinstance(last, StateChange)
    assert last.state == "running"


def weaving(**changes: Any) -> WeavingRuns:
    """A zigzag of five waves of 40 mm, 30 mm high, at 50 mm/s, without noise and rounding."""
    half, height = 0.02, 0.03
    legs = np.arange(11)
    corners = np.column_stack([legs * half, np.where(legs % 2 == 1, height, 0.0), np.zeros(11)])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    s = np.linspace(0.0, way[-1], 4001)
    path = np.column_stack([np.interp(s, way, corners[:, k]) for k in range(3)])
    runs = WeavingRuns(
        arm="left",
        commands="nominal",
        speed=0.05,
        commanded_M=path,
        along_M=np.array([1.0, 0.0, 0.0]),
        across_M=np.array([0.0, 1.0, 0.0]),
        turns=half * np.arange(1.0, 10.0),
        tracker=np.zeros((3, 3)),
        wanted=2,
    )
    return replace(runs, **changes)


@pytest.mark.fast
def test_weaving_deviations_of_a_narrow_and_slow_zigzag() -> None:
    runs = weaving()
    narrow = runs.commanded_M * np.array([1.0, 0.9, 1.0])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(runs.commanded_M, axis=0), axis=1))])
    runs.tracks.extend(PathTrack(7.0 + k + way / 0.04, narrow) for k in range(2))
    found = weaving_characteristics(runs)
    assert found is not None
    assert found.waves == 4
    assert found.stroke_mm == pytest.approx(30.0, rel=1e-3)
    assert found.frequency_hz == pytest.approx(0.05 / (2.0 * np.hypot(0.02, 0.03)), rel=1e-3)
    assert found.stroke_percent == pytest.approx(-10.0, abs=0.1)
    assert found.frequency_percent == pytest.approx(-20.0, abs=0.1)
    assert found.n == 2


@pytest.mark.fast
def test_cycles_that_end_early_give_no_weaving_deviations() -> None:
    runs = weaving()
    runs.tracks.extend(PathTrack(np.arange(1000.0), runs.commanded_M[:1000]) for _ in range(2))
    assert weaving_characteristics(runs) is None
    assert weaving_characteristics(weaving()) is None
