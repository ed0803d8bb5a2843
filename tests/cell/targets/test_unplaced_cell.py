"""Commands for an arm of which only readings are known: they bring the true arm to its targets; nothing is driven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.targets.goals import UNPLACED, is_unplaced
from cellapp.cell.targets.targets import Target
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.export.run import export_as_run
from cellapp.commands.import_ import import_new_run
from cellapp.commands.init.own_data import OwnData, write_own_data
from cellapp.commands.show.overview import run_overview
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import nominal_geometry, smr_positions
from cellapp.robot.kinematics.transforms import rotation_from_vector, transform
from tests.arms import UR5

RNG = np.random.default_rng(5)
TRUE = nominal_geometry(
    UR5 + RNG.normal(0.0, [1e-3, 5e-4, 5e-4, 1e-3], (6, 4)),
    np.array([0.01, 0.02, 0.08]),
    transform(rotation_from_vector(RNG.normal(size=3)), RNG.uniform(-2.0, 2.0, 3)),
)
"""Where the floor of a cell would be, nobody knows: the base stands anyhow."""


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    q = np.random.default_rng(6).uniform(-2.0, 2.0, (120, 6))
    p_M = smr_positions(TRUE, q) + np.random.default_rng(7).normal(0.0, 1e-5, (120, 3))
    rows = [",".join(f"{v:.9f}" for v in (*a, *b)) for a, b in zip(q, p_M, strict=True)]
    (folder / "mine.csv").write_text("\n".join(["q1,q2,q3,q4,q5,q6,x_m,y_m,z_m", *rows]))
    written = write_own_data(OwnData(folder / "mine.csv", arm="ur5"), folder)
    import_new_run(load_profile(written.profile), written.readings, folder / "run")
    with RunFile.open(folder / "run", write=True) as run:
        calibrate_run(run)
    return folder / "run"


def test_the_commands_bring_the_true_arm_to_its_targets(calibrated: Path) -> None:
    q = np.array([[0.3, -1.1, 1.4, -0.6, 1.2, 0.4], [-0.8, -0.7, 1.1, 0.5, -1.3, 0.9]])
    wanted = smr_positions(TRUE, q)
    targets = [Target(name=f"t{i}", arm="robot", frame="tracker", position=tuple(p)) for i, p in enumerate(wanted)]
    with RunFile.open(calibrated, write=True) as run:
        assert is_unplaced(run.profile)
        found = compensate_run(run, targets)
        assert UNPLACED in found.notes
        commands = np.array([one.q_compensated for one in found.targets])
        errors_mm = 1e3 * np.linalg.norm(smr_positions(TRUE, commands) - wanted, axis=1)
        assert errors_mm.max() < 0.1
        assert not any("tracker" in one.note for one in found.targets)


def test_the_next_step_is_never_one_that_moves(calibrated: Path) -> None:
    with RunFile.open(calibrated) as run:
        assert "push" not in run_overview(run).next_step


def test_a_table_is_written_and_a_program_refused(calibrated: Path, tmp_path: Path) -> None:
    target = Target(name="t", arm="robot", frame="robot", position=(-0.4, -0.3, 0.4))
    with RunFile.open(calibrated, write=True) as run:
        compensate_run(run, [target])
        export_as_run(run, "commands", tmp_path / "commands.csv")
        assert "\nt,robot," in (tmp_path / "commands.csv").read_text("utf-8")
        with pytest.raises(InputError, match="no motion can be checked"):
            export_as_run(run, "urscript", tmp_path / "program.script")
    assert not (tmp_path / "program.script").exists()
