"""AP and RP of the orientation by ISO 9283, from a 6-D probe: from the points, against the truth."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.iso9283 import programme
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283.request import VERB, Iso9283Request
from cellapp.commands.iso9283.run import iso9283_run
from cellapp.commands.iso9283.view import iso9283_tables
from cellapp.estimation.iso9283.evaluate import orientation_characteristics
from cellapp.ground.profile.sections import Smr
from tests.cell.planning.planned_cells import one_arm

SIGMA = 5e-5
PROBE = {"rpy": [0.2, -0.1, 0.4], "sigma": SIGMA}


def test_orientation_is_measured_stored_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programme, "_SEEDS", 4)
    profile = one_arm()
    assert profile.plant is not None
    plant = profile.plant.model_copy(update={"effects": {}, "repeatability": 1e-4})
    left = profile.arms["left"]
    smr = Smr.model_validate({**left.smr.model_dump(), "probe": PROBE})
    arms = {"left": left.model_copy(update={"smr": smr})}
    with RunFile.create(tmp_path / "run", profile.model_copy(update={"plant": plant, "arms": arms})) as run:
        request = VERB.asked({"folder": run.folder, "tests": ["pose"], "cycles": 6})
        assert isinstance(request, Iso9283Request)
        result = iso9283_run(run, request)
    poses = result.arms["left"].tests["nominal"].pose
    (line,) = (one for one in result.coverage if one.characteristic == "AP, RP of the orientation")
    assert (line.status, line.words) == ("in part", "6 of 30 cycles, nominal commands")
    assert not any(note.startswith("positions only") for note in result.notes)
    (table,) = (one for one in iso9283_tables(result) if one.title.startswith("Orientation accuracy"))
    assert len(table.rows) == len(poses) == 5
    with (tmp_path / "run" / result.points_file).open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["test"] == "pose"]
    for pose in poses:
        own = [row for row in rows if row["place"] == pose.pose]
        commanded, *attained = (
            Rotation.from_quat([float(row[f"quat_{axis}"]) for axis in "xyzw"])
            for row in sorted(own, key=lambda row: row["row"])
        )
        assert pose.orientation is not None
        off = np.array([(one * commanded.inv()).as_rotvec() for one in attained])
        assert np.linalg.norm(pose.orientation.accuracy_mrad) == pytest.approx(1e3 * np.linalg.norm(off.mean(axis=0)))
        # six joints that stop with 0.1 mrad each, beside the probe
        assert 0.1 < max(pose.orientation.repeatability_mrad) < 2.0
        assert pose.orientation.accuracy_expanded_mrad > 2e3 * SIGMA
        assert np.linalg.norm(pose.orientation.accuracy_mrad) < 5.0


@pytest.mark.fast
def test_the_formulas_are_those_of_angles_about_the_base() -> None:
    rng = np.random.default_rng(1)
    base_M, commanded_M = Rotation.random(2, random_state=1).as_matrix()
    off_B = np.array([1e-3, -2e-3, 5e-4]) + 1e-4 * rng.standard_normal((30, 3))
    attained = Rotation.from_rotvec(off_B @ base_M.T) * Rotation.from_matrix(commanded_M)
    quaternions = list(np.roll(attained.as_quat(), 1, axis=1))
    found = orientation_characteristics(quaternions, commanded_M, base_M, [4e-5] * 30)
    assert found is not None
    np.testing.assert_allclose(found.accuracy_mrad, 1e3 * off_B.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.repeatability_mrad, 3e3 * off_B.std(axis=0, ddof=1), rtol=1e-6)
    assert orientation_characteristics(quaternions[:1], commanded_M, base_M, [4e-5]) is None
