"""Commands for a payload that no reading had: the bound covers what the arm really does, and says what it adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.run import RunFile
from cellapp.cell.targets.compensate import compensate
from cellapp.cell.targets.ranges import ConditionRanges, OpenElasticity, payload_covariance
from cellapp.cell.targets.targets import Target, WorkingConditions
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.effects.joint_compliance import LINEAR
from cellapp.robot.kinematics.transforms import zyx_angles
from cellapp.robot.model import CellModel
from tests.twin import HIDDEN

LOAD_KG = 2.0
"""The readings of the twin have 0.3 kg."""


def errors_and_parts(
    run: RunFile, model: CellModel, ranges: dict[str, ConditionRanges], load_kg: float
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """True errors (n, 3) [mm] of the left arm, whose joints give way, where its planned stops were; the uncertainty
    (n,) of its position, notes."""
    plan = run.read_plan()
    assert plan is not None
    p_M = model.arms["left"].predict(plan["left"])
    rotation_M, _ = model.arms["left"].flange(plan["left"])
    loaded = WorkingConditions(payload=load_kg)
    targets = [
        Target(name=f"stop-{k}", arm="left", position=p, rpy=zyx_angles(R)[::-1], frame="tracker", conditions=loaded)
        for k, (p, R) in enumerate(zip(p_M.tolist(), rotation_M, strict=True))
    ]
    commands = [one for one in compensate(run.profile, model, targets, ranges=ranges) if not one.refusal]
    q = np.array([one.q_compensated for one in commands])
    sides = np.array([one.side or (0,) * 6 for one in commands], dtype=float)
    true_M = build_plant(run.profile).smr_positions("left", q, approach=sides, payload=np.full(len(q), load_kg))
    errors = (true_M - np.array([one.expected_M for one in commands])) * 1e3
    parts = [one.prediction.parts for one in commands if one.prediction is not None]
    own = [np.hypot(np.hypot(one.parameters, one.effects), np.hypot(one.network, one.extrapolation)) for one in parts]
    return errors, np.array(own), [one.note for one in commands]


def normalised(errors: np.ndarray, own: np.ndarray) -> float:
    """Root mean square of coordinates in units of their standard uncertainty, without noise of measuring: some 1."""
    return float(np.sqrt(np.mean(errors**2 / own[:, None] ** 2)))


def test_a_payload_that_was_never_measured_widens_the_bound_to_what_the_arm_does(
    run: RunFile, model: CellModel
) -> None:
    ranges = {name: ConditionRanges.of(run.readings(name), arm) for name, arm in model.arms.items()}
    silent = {name: replace(one, elasticity=None) for name, one in ranges.items()}
    errors, own, notes = errors_and_parts(run, model, ranges, LOAD_KG)
    _, narrow, _ = errors_and_parts(run, model, silent, LOAD_KG)
    assert normalised(errors, own) < 1.2
    assert np.mean(own) > 1.2 * np.mean(narrow)
    assert np.mean(np.linalg.norm(errors, axis=1) <= 2.8 * own) >= 0.93, "95 % of three coordinates"
    words = "payload 2 kg was never measured (the readings had 0.3 kg); this adds "
    assert [note for note in notes if words not in note] == []
    measured, as_measured, silent_notes = errors_and_parts(run, model, ranges, 0.3)
    assert [note for note in silent_notes if "payload" in note] == []
    assert np.mean(as_measured) < np.mean(own)
    assert len(measured) == len(errors)


def test_what_readings_leave_open(run: RunFile, model: CellModel) -> None:
    """A joint that the arm's own weight loads is known, the last one is not; without draws nothing is."""
    arm, readings = model.arms["left"], run.readings("left")
    found = OpenElasticity.of(arm, readings)
    assert found is not None
    size = np.sqrt(np.diag(found.covariance))[:6]
    assert size[1] < 5e-6 < 5e-5 < size[5]
    assert found.values[1] == pytest.approx(1.0 / HIDDEN["left"]["joint_compliance"]["stiffness"][1], rel=0.2)
    assert OpenElasticity.of(replace(arm, posterior=None), readings) is None
    assert OpenElasticity.of(arm, readings.take(np.empty(0, dtype=np.intp))) is None


def test_a_law_that_only_the_measured_load_makes_true_is_doubted_under_another_one(
    run: RunFile, model: CellModel
) -> None:
    """A correction by the load stands for the joint's compliance where all readings have one load: it grows with it."""
    arm, readings = model.arms["left"], run.readings("left")
    rest = [term for term in arm.effects if term.slug != "joint_compliance"]
    (term,) = [term for term in arm.effects if term.slug == "joint_compliance"]
    wrong = replace(
        term,
        names=("load2", *term.names),
        values=np.array([3e-4, *term.values]),
        standard_errors=np.array([1e-6, *term.standard_errors]),
        units=("rad/Nm", *term.units),
        law=LINEAR.law(),
        modulations=(),
    )
    q, load_kg = readings.q[:20], np.full(20, 5.0)
    far_F = np.tile([0.0, 0.0, 0.4], (20, 1))
    asked = MeasurementConditions(payload_kg=load_kg, payload_center_F=far_F)
    sizes = {}
    for name, its in {"right": arm, "wrong": replace(arm, effects=(*rest, wrong))}.items():
        ranges = ConditionRanges.of(readings, its)
        near = ranges.nearest_loaded(its, q, asked)
        assert near.payload_center_F is not None
        assert not (near.payload_center_F == far_F).any(), "the centre of what was measured, not of what is asked"
        found = payload_covariance(its, q, asked, near, ranges.elasticity)
        assert not payload_covariance(its, q, near, near, ranges.elasticity).any()
        sizes[name] = np.sqrt(np.trace(found, axis1=1, axis2=2))
    assert np.median(sizes["wrong"]) > 3.0 * np.median(sizes["right"])
