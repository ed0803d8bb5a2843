"""A controller with its factory's calibration: nominal in the profile, read back, compared, its programs corrected."""

from __future__ import annotations

import gzip
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.profile.files import controller_file_text, controller_table
from cellapp.cell.run import RunFile
from cellapp.cell.run.arm_identity import recorded_controllers
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.correct import correct_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.sections import controllers_section
from cellapp.commands.view.table import Table
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import FactoryErrors
from cellapp.ground.profile.sections import ControllerTable
from cellapp.robot.model.nominal import controller_rows, published_rows
from drivers.plant.factory import factory_calibration
from tests.cell.programs.test_truth import FACTOR, Array, Cell, cell_of, corrected, errors, waypoint
from tests.made_once import made_once
from tests.twin import small_twin, with_arm

_CHAIN = ("deltaTheta", "d", "a", "alpha")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated run whose controllers have a calibration; that of the left one is nominal."""

    def make(folder: Path) -> None:
        twin = small_twin(30, plant={"factory": FactoryErrors(length=1e-4, angle=1e-4), "effects": {}})
        twin = twin.model_copy(update={"network": twin.network.model_copy(update={"kind": "none"})})
        own, left = factory_calibration(build_plant(twin), "left"), twin.arms["left"]
        assert own is not None
        text = controller_file_text((own.rows - published_rows(left)).tolist(), own.checksum, ("a comment",))
        table = ControllerTable.model_validate(controller_table(text, Path("left.conf")))
        with new_planned_run(with_arm(twin, "left", factory=table), folder) as run:
            collect_run(run)
            calibrate_run(run)

    return made_once(tmp_path_factory, "factory-run", make)


@pytest.fixture(scope="module")
def cell(folder: Path) -> Cell:
    found = cell_of(folder, "left")
    with RunFile.open(folder) as run:
        rows = controller_rows(run.profile.arms["left"])
    return replace(found, rows=rows)


def taught(cell: Cell, rows: Array) -> str:
    """A program whose waypoints were taught on a controller that computes by ``rows``."""
    values = "".join(
        f'<{tag} value="{", ".join(map(repr, column))}"/>' for tag, column in zip(_CHAIN, rows.T.tolist(), strict=True)
    )
    body = "".join(waypoint(number, q) for number, q in enumerate(cell.q))
    body = re.sub(r"<Kinematics.*?</Kinematics>", f'<Kinematics status="LINEARIZED">{values}</Kinematics>', body)
    return f'<URProgram name="cell"><children><Move motionType="MoveJ">{body}</Move></children></URProgram>\n'


def angles(program: str) -> Array:
    return np.array([[float(part) for part in one.split(",")] for one in re.findall(r'angles="([^"]*)"', program)])


def test_waypoints_of_a_calibrated_controller_reach_its_true_poses(cell: Cell, tmp_path: Path) -> None:
    source = taught(cell, cell.rows)
    new, result = corrected(cell, source, tmp_path, ".urp")
    assert "controller: computes by its own calibration, checksum" in result.assumptions[0]
    before, _ = errors(cell, angles(source))
    after, _ = errors(cell, angles(new))
    assert before.mean() > 0.05e-3
    assert after.mean() < before.mean() / FACTOR


def test_waypoints_of_another_controller_are_refused_by_name(cell: Cell, tmp_path: Path) -> None:
    other = cell.rows.copy()
    other[0, 0] += 1e-3
    (tmp_path / "old.urp").write_bytes(gzip.compress(taught(cell, other).encode()))
    with RunFile.open(cell.run.folder) as run:
        result = correct_run(run, tmp_path / "old.urp", tmp_path / "new.urp", "left")
        assert result.out is None
        assert "another one than that in arms.*.factory" in result.refused[0][2]
        (tmp_path / "old.script").write_text("movej([0,0,0,0,0,0])")
        with pytest.raises(InputError, match=r"controller of this run computes with another calibration.*factory"):
            correct_run(run, tmp_path / "old.script", tmp_path / "new.script", "right")


def test_the_report_compares_published_factory_and_identified_rows(folder: Path) -> None:
    with RunFile.open(folder) as run:
        assert all(one.dh_rows is not None for one in recorded_controllers(run).values())
        section = controllers_section(run, read_report_data(run))
    assert section is not None
    table = section.parts[0]
    assert isinstance(table, Table)
    mean = {(row[0], row[1]): row[2] for row in table.rows}
    for arm in ("left", "right"):
        published, factory, ours = (mean[arm, whose] for whose in ("published", "factory", "cellapp"))
        assert isinstance(published, float)
        assert isinstance(factory, float)
        assert isinstance(ours, float)
        assert ours < factory < 0.6 * published


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no section"),
        ("x", "no calibration.conf"),
        ("[mounting]\ndelta_theta = [0]\n", "has no delta_a"),
        ("[mounting]\ndelta_theta = [a]\n", "expected numbers between commas"),
        ("[mounting]\ndelta_theta = [nan]\n", "not a finite number"),
    ],
)
def test_a_file_that_is_no_calibration_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=f"left.conf: .*{words}"):
        controller_table(text, Path("left.conf"))
