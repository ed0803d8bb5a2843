"""``calibrate`` finds readings with gross errors, leaves them out of everything, and says which."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import import_csv
from cellapp.commands.calibrate.result import arm_result
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.headlines import warnings
from cellapp.estimation.calibration.calibrate import (
    ArmCalibration,
    calibrate_arm,
    calibrate_readings,
    left_out_words,
    train_arm,
)
from cellapp.estimation.calibration.quantities import position_errors
from cellapp.estimation.readings import Readings
from cellapp.estimation.readings.readings import FIRST_SAMPLE
from cellapp.robot.kinematics.chain import smr_positions
from tests.evidence.gross_errors import disturbed
from tests.evidence.shared.series import Entrant, load_entrant

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def ur5() -> Entrant:
    """A measured arm, 300 of its rows: a quarter held out, a quarter to train on."""
    entrant = load_entrant("UR5")
    words = ("validate", "identify", "train", "identify")
    some = entrant.readings.take(np.arange(0, 900, 3))
    return replace(entrant, readings=replace(some, split=tuple(words[k % 4] for k in range(300))))


@pytest.fixture(scope="module")
def plain(ur5: Entrant) -> ArmCalibration:
    """The calibration of the clean readings."""
    arm, notes = calibrate_arm(ur5.profile, ur5.arm, ur5.readings)
    assert arm.left_out == ()
    assert arm.left_out_counts == {}
    assert notes == []
    return arm


def error_mm(arm: ArmCalibration, readings: Readings, rows: np.ndarray) -> float:
    computed = smr_positions(arm.model.geometry, readings.q[rows])
    return float(position_errors(readings.p_M[rows], computed).mean()) * 1e3


@pytest.mark.parametrize("share", [0.01, 0.05])
@pytest.mark.parametrize("kind", [1e-3, 1e-1, 1.0, "swapped"])
def test_gross_errors_hardly_change_the_geometry(
    ur5: Entrant, plain: ArmCalibration, share: float, kind: float | str
) -> None:
    spoilt, rows = disturbed(ur5.readings, share, kind, np.random.default_rng(3))
    arm, notes = calibrate_arm(ur5.profile, ur5.arm, spoilt)
    wrong = sorted(ur5.readings.configuration[rows].tolist())
    assert sorted(arm.left_out) == wrong
    good = np.setdiff1d(ur5.readings.in_split("validate"), rows)
    assert error_mm(arm, ur5.readings, good) < 1.03 * error_mm(plain, ur5.readings, good)
    (note,) = notes
    named = ", ".join(map(str, sorted(wrong)[:8])) + (", ..." if len(wrong) > 8 else "")
    assert f"{len(wrong)} readings with gross errors were left out (configurations {named})" in note
    held_out = arm.validate["geometry"].position_mm.n
    assert held_out == len(good) == arm.counts["validate"]
    assert f"held-out errors are those of {held_out} readings, without {75 - held_out} of these" in note


def test_one_joint_position_in_degrees_does_not_ruin_the_geometry(ur5: Entrant, plain: ArmCalibration) -> None:
    q = ur5.readings.q.copy()
    q[101, 1] = np.degrees(q[101, 1])
    arm, notes = calibrate_arm(ur5.profile, ur5.arm, replace(ur5.readings, q=q))
    number = int(ur5.readings.configuration[101])
    assert arm.left_out == (number,)
    assert f"1 reading with a gross error was left out (configuration {number})" in notes[0]
    rows = ur5.readings.in_split("validate")
    assert error_mm(arm, ur5.readings, rows) < 1.03 * error_mm(plain, ur5.readings, rows)
    again, _ = calibrate_arm(ur5.profile, ur5.arm, replace(ur5.readings, q=q))
    assert np.array_equal(again.identification.values, arm.identification.values)


def test_no_network_is_trained_or_judged_on_rows_left_out(ur5: Entrant) -> None:
    """A calibration of the readings without them is the same to the bit."""
    spoilt, rows = disturbed(ur5.readings, 0.03, 0.5, np.random.default_rng(5))
    network = ur5.profile.network.model_copy(update={"kind": "mlp", "iterations": 20})
    profile = ur5.profile.model_copy(update={"network": network})
    arm, _ = calibrate_arm(profile, ur5.arm, spoilt)
    trained = train_arm(profile, arm, spoilt)
    without = train_arm(profile, arm, spoilt.take(np.setdiff1d(np.arange(len(spoilt)), rows)))
    assert trained.training is not None
    assert trained.training.left_out_rms == without.training.left_out_rms  # type: ignore[union-attr]
    assert trained.validate == without.validate
    result = arm_result(trained)
    assert sorted(result.left_out_configurations) == sorted(spoilt.configuration[rows].tolist())
    assert sum(result.left_out_splits.values()) == len(rows)
    assert sum(result.splits.values()) == len(spoilt) - len(rows)


def test_a_geometry_that_is_hardly_better_than_the_nominal_one_is_said(ur5: Entrant) -> None:
    """Where too many readings are wrong to leave them out, the figures say so, and a sentence does."""
    spoilt, _ = disturbed(ur5.readings, 0.4, 0.05, np.random.default_rng(6))
    arm, notes = calibrate_arm(ur5.profile, ur5.arm, spoilt)
    assert arm.left_out == ()
    assert any("the identified geometry is hardly better than the nominal one (mean held-out error" in n for n in notes)


@pytest.fixture
def spoilt_csv(tmp_path: Path) -> tuple[Path, list[int]]:
    lines = (ROOT / "tests" / "fixtures" / "ur5-real" / "readings.csv").read_text(encoding="utf-8").splitlines()[:301]
    header = lines[0].split(",")
    place, wrong = header.index("z_m"), [40, 150, 222]
    for row in wrong:
        cells = lines[row + 1].split(",")
        cells[place] = str(float(cells[place]) + 0.02)
        lines[row + 1] = ",".join(cells)
    path = tmp_path / "in.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path, wrong


def test_a_run_names_them_in_json_and_on_the_page(tmp_path: Path, spoilt_csv: tuple[Path, list[int]]) -> None:
    path, wrong = spoilt_csv
    profile = load_profile(ROOT / "profiles" / "ur5-real.yaml")
    profile = profile.model_copy(
        update={
            "network": profile.network.model_copy(update={"kind": "none"}),
            "splits": profile.splits.model_copy(update={"identify": 150}),
        }
    )
    text = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(line.rsplit(",", 1)[0] for line in text), encoding="utf-8")  # the program draws splits
    with import_csv(profile, path, tmp_path / "run") as run:
        result = calibrate_run(run)
        data = read_report_data(run)
    (arm,) = result.arms.values()
    assert list(arm.left_out_configurations) == wrong
    assert '"left_out_configurations"' in result.to_json()
    ((name, held_out),) = data.held_out.items()
    assert len(held_out.readings) == arm.validate_["geometry"].position_mm.n
    assert not np.isin(held_out.readings.configuration, wrong).any()
    assert any("left out (configurations 40, 150, 222)" in line for line in warnings(data))
    assert any("left out (configurations 40, 150, 222)" in note for note in result.notes)
    assert name in data.readings


def test_the_whole_cell_leaves_them_out_of_the_pair(twin_readings: tuple) -> None:
    profile, readings = twin_readings
    names = list(readings)
    p_M = readings[names[0]].p_M.copy()
    p_M[[3, 60]] += 0.4
    spoilt = {**readings, names[0]: replace(readings[names[0]], p_M=p_M)}
    plain, found = (calibrate_readings(profile, its) for its in (readings, spoilt))
    assert sorted(found.arms[names[0]].left_out) == [3, 60]
    assert found.arms[names[1]].left_out == ()
    assert plain.pair is not None
    assert found.pair is not None
    for method, its in found.pair.methods.items():
        assert its.by_distances.mean < 1.3 * plain.pair.methods[method].by_distances.mean, "other stops are drawn"
    assert not np.isin(found.pair.stops, [3, 60]).any()


@pytest.fixture(scope="module")
def twin_readings() -> tuple:
    """A simulated cell without networks, and its readings at 160 random stops."""
    from tests.evidence.shared.cells import measured_plan

    profile = load_profile(ROOT / "profiles" / "twin.yaml")
    profile = profile.model_copy(
        update={
            "network": profile.network.model_copy(update={"kind": "none"}),
            "splits": profile.splits.model_copy(
                update={"identify": 100, "train": 0, "pair_identify": 60, "pair_validate": 30}
            ),
        }
    )
    rng = np.random.default_rng(2)
    plan = {name: rng.uniform(-2.5, 2.5, (160, len(arm.type.joints))) for name, arm in profile.arms.items()}
    return profile, measured_plan(profile, plan, 1)


def test_readings_that_were_left_out_are_named_by_what_a_person_knows():
    assert left_out_words([7]) == "1 reading with a gross error was left out (configuration 7)"
    assert left_out_words([7, FIRST_SAMPLE + 3, FIRST_SAMPLE + 4]) == (
        "3 readings with gross errors were left out (configuration 7, 2 samples of recordings)"
    )
