"""The comparison with peers: its problems, and what becomes of a peer that fails. No peer is installed here."""

from __future__ import annotations

import json
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

from cellapp.robot.kinematics.chain import smr_positions
from tests.benchmarks.peers.__main__ import main
from tests.benchmarks.peers.cases import NOMINAL_ROWS, NOMINAL_TOOL, make_case, positions, write_case
from tests.benchmarks.peers.drive_cellapp import start_geometry
from tests.benchmarks.peers.environments import Failed, run
from tests.benchmarks.peers.table import Fit, Row, case_text

STRAIGHT = np.zeros(6)


def fit(seed, mean_um, seconds=1e-3, floor_s=None):
    return Fit(seed, "1.0", 27, seconds, mean_um, 2.0 * mean_um, "converged", floor_s)


@pytest.mark.fast
def test_a_case_is_the_same_for_the_same_seed_and_differs_in_beta_alone():
    one, again, turned = make_case("mdh", 30, 4), make_case("mdh", 30, 4), make_case("hayati", 30, 4)
    np.testing.assert_array_equal(one.p_M, again.p_M)
    np.testing.assert_array_equal(one.q, turned.q)
    apart = np.linalg.norm(one.p_test_M - turned.p_test_M, axis=1)
    assert 1e-4 < apart.max() < 2e-2  # 0.1 deg at the length of the arm


@pytest.mark.fast
def test_the_start_fits_to_millimetres():
    case = make_case("mdh", 30, 1)
    off = np.linalg.norm(positions(NOMINAL_ROWS, STRAIGHT, NOMINAL_TOOL, case.T_M_B, case.q) - case.p_M, axis=1)
    assert 1e-4 < off.mean() < 1e-2


@pytest.mark.fast
def test_all_solvers_get_the_same_nominal_arm(tmp_path):
    case = make_case("mdh", 30, 1)
    write_case(case, tmp_path)
    nominal = json.loads((tmp_path / "nominal.json").read_text())
    expected = positions(NOMINAL_ROWS, STRAIGHT, NOMINAL_TOOL, case.T_M_B, case.q)
    ours = start_geometry(*(np.array(nominal[name]) for name in ("rows", "tool", "T_M_B")))
    np.testing.assert_allclose(smr_positions(ours, case.q), expected, atol=1e-12)
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "nominal.urdf"))
    data, smr = model.createData(), model.getFrameId("smr")
    for q, p_M in zip(case.q, expected, strict=True):
        pinocchio.framesForwardKinematics(model, data, q)
        p_B = data.oMf[smr].translation
        np.testing.assert_allclose(case.T_M_B[:3, :3] @ p_B + case.T_M_B[:3, 3], p_M, atol=1e-12)
    assert len(ElementTree.parse(tmp_path / "nominal.urdf").findall("joint")) == 7


@pytest.mark.fast
def test_a_solver_is_not_told_the_true_positions(tmp_path):
    write_case(make_case("mdh", 30, 1), tmp_path)
    assert sorted(np.load(tmp_path / "readings.npz").files) == ["p_M", "q", "q_test"]


@pytest.mark.fast
def test_a_command_that_fails_or_does_not_end_says_why():
    with pytest.raises(Failed, match="no such model"):
        run([sys.executable, "-c", "raise SystemExit('no such model')"], 60.0)
    with pytest.raises(Failed, match=r"no answer after 0\.2 s"):
        run([sys.executable, "-c", "import time; time.sleep(60)"], 0.2)


@pytest.mark.fast
def test_failures_and_misses_are_rows_with_a_reason():
    ours = Row("cellapp", (fit(0, 3.0, floor_s=5e-4), fit(1, 3.3, floor_s=5e-4)), ())
    wrong = Row("wrong", (fit(0, 700.0, 2.0),), ("no answer after 600 s",))
    absent = Row("absent", (), ("not installed: ERROR: no matching distribution",))
    text = case_text("mdh", 400, [ours, wrong, absent])
    assert "cellapp / lstsq 2.00; fastest peer (wrong) / cellapp 2000" in text
    assert "| 1 failed: no answer after 600 s; 1 of 1 missed; the worst says: converged |" in text
    assert "| absent | | | | | | failed: not installed: ERROR: no matching distribution |" in text


def test_cellapp_alone_is_measured_beside_lstsq(tmp_path, capsys):
    main(["--venvs", str(tmp_path), "--only", "--cases", "mdh", "--configurations", "60", "--seeds", "1"])
    assert "numpy lstsq, 180 x 27" in capsys.readouterr().out
