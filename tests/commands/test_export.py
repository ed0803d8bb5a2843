"""The verb: which files it writes, what it says of the rest of the model, what it refuses."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.exports.arm_export import POSES, ExportResult
from cellapp.cell.exports.export_format import CommandFormat, ExportFormat
from cellapp.cell.exports.formats import all_formats, export_lines, files_of_arms, form_line, formats_of
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.export.run import calibrated_arms, sentences
from cellapp.commands.stages import CALIBRATION_FILE, read_stages
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import CellModel
from tests.cell.exports import readers
from tests.interfaces.plugins.installed import add_example, run_commands
from tests.sure import sure
from tests.twin import PROFILES, finished_twin
from tests.verbs import export_as_run

FORMATS = formats_of(ExportFormat)


def test_each_arm_has_its_file_and_says_what_is_not_in_it(finished_run: Path, tmp_path: Path) -> None:
    with RunFile.open(finished_run) as run:
        result = export_as_run(run, "urdf", tmp_path / "cell.urdf")
    assert result.arms is not None
    assert [arm.file for arm in result.arms.values()] == [str(tmp_path / f"cell-{name}.urdf") for name in result.arms]
    model = CellModel.load(finished_run / CALIBRATION_FILE)
    for name, arm in model.arms.items():
        file = result.arms[name]
        text = Path(file.file).read_text("utf-8")
        q = np.random.default_rng(3).uniform(-3.0, 3.0, (100, 6))
        np.testing.assert_allclose(readers.urdf(text, name, q), smr_positions(arm.geometry, q), atol=1e-9)
        assert set(file.lost) >= {term.slug for term in arm.effects}
        assert file.lost
        for part, loss in file.lost.items():
            assert 0.0 < loss.rms_mm < loss.max_mm
            line = f"{part}: {loss.rms_mm:.3f} mm rms, {loss.max_mm:.3f} mm at most"
            assert line in text
            assert f"    {line}" in export_lines(result)
    assert ExportResult.from_json(result.to_json(), "test") == result


def test_the_loss_is_what_the_whole_model_predicts_beside_the_file(finished_run: Path, tmp_path: Path) -> None:
    """Compliance depends on the configuration alone: the stated error is found again at other configurations."""
    with RunFile.open(finished_run) as run:
        result = export_as_run(run, "dh", tmp_path / "left.yaml", "left")
        measured = run.readings("left").q
    assert set(sure(result.arms)["left"].lost) == {"joint_compliance"}
    arm = CellModel.load(finished_run / CALIBRATION_FILE).arms["left"]
    q = np.random.default_rng(9).uniform(measured.min(axis=0), measured.max(axis=0), (POSES, 6))
    off = np.linalg.norm(readers.dh((tmp_path / "left.yaml").read_text("utf-8"), q) - arm.predict(q), axis=1) * 1e3
    stated = sure(sure(result.arms)["left"].lost_together)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(stated.rms_mm, rel=0.1)


def test_the_format_of_a_plugin(finished_run: Path, tmp_path: Path) -> None:
    ended = run_commands(
        [add_example(tmp_path / "plugin")],
        f"export {finished_run} --as serial-link --arm right --out {tmp_path / 'arm.m'}",
        f"export {finished_run} --as serial-links --out {tmp_path / 'other.m'}",
    )
    assert ended.codes == [0, 2], ended.err
    assert "urscript, serial-link; 'cellapp docs exports' says more" in ended.err, "after those that are built in"
    with RunFile.open(finished_run) as run:
        export = calibrated_arms(run, read_stages(run))["right"]
    text = (tmp_path / "arm.m").read_text("utf-8")
    assert text.startswith(
        "% SerialLink of the Robotics Toolbox (MATLAB), by cellapp-example 1.0, a plug-in of cellapp, of a simulated"
        " cell."
    )
    rows = re.findall(r"'d', (\S+), 'a', (\S+), 'alpha', (\S+), 'offset', (\S+)\)", text)
    (base,) = re.findall(r"SE3\(\[(.*)\]\)", text)
    (tool,) = re.findall(r"SE3\(([^\[]*)\)", text)
    p_M = np.array([0.0, 0.0, 0.0, 1.0])
    p_M[:3] = [float(one) for one in tool.split(", ")]
    for (d, a, alpha, offset), angle in reversed([*zip(np.array(rows, float), export.q[0], strict=True)]):
        rotation = Rotation.from_euler("ZX", [angle + offset, alpha]).as_matrix()
        rotated = np.array([a * np.cos(angle + offset), a * np.sin(angle + offset), d])
        p_M[:3] = rotation @ p_M[:3] + rotated
    T_M_B = np.array([[float(one) for one in row.split()] for row in base.split("; ")])
    found = (T_M_B @ p_M)[:3]
    np.testing.assert_allclose(found, smr_positions(export.geometry, export.q[:1])[0], atol=1e-6)


@pytest.mark.parametrize("form", FORMATS)
def test_names_of_arms_are_only_text(finished_copy: Path, tmp_path: Path, form: str) -> None:
    """A name with line ends, hyphens and marks stays inside the comment; one that is a path names no file."""
    name = 'l\n]]--><x>"\nunits: mm'
    with RunFile.open(finished_copy) as run:
        export = replace(calibrated_arms(run, read_stages(run))["left"], name=name)
    plain, hostile = (
        FORMATS[form].text(one, sentences(FORMATS[form], run, one)) for one in (replace(export, name="l"), export)
    )
    if form == "urdf":
        assert [joint.get("type") for joint in ElementTree.fromstring(hostile).iter("joint")].count("revolute") == 6
    else:
        assert [line for line in plain.splitlines() if line[0] != "#"] == [
            line for line in hostile.splitlines() if line[0] != "#"
        ]


def test_an_arm_whose_name_is_a_path_is_written_alone(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'a/b' cannot be part of a file's name; write this arm alone with --arm"):
        files_of_arms(tmp_path / "arm.urdf", ["a/b", "right"])
    assert files_of_arms(tmp_path / "arm.urdf", ["a/b"]) == {"a/b": tmp_path / "arm.urdf"}


def test_the_cell_in_one_file_says_what_it_lacks_of_each_arm(finished_run: Path, tmp_path: Path) -> None:
    with RunFile.open(finished_run) as run:
        result = export_as_run(run, "urdf-cell", tmp_path / "cell.urdf")
        with pytest.raises(InputError, match="writes all arms in one file; leave --arm out, or take --as urdf"):
            export_as_run(run, "urdf-cell", tmp_path / "one.urdf", "left")
    text = (tmp_path / "cell.urdf").read_text("utf-8")
    model = CellModel.load(finished_run / CALIBRATION_FILE)
    for name, arm in model.arms.items():
        file = sure(result.arms)[name]
        assert file.file == str(tmp_path / "cell.urdf")
        for part, loss in file.lost.items():
            assert f"{part}: {loss.rms_mm:.3f} mm rms, {loss.max_mm:.3f} mm at most" in text
        q = np.random.default_rng(4).uniform(-3.0, 3.0, (100, 6))
        np.testing.assert_allclose(readers.urdf(text, name, q), smr_positions(arm.geometry, q), atol=1e-9)
    assert [path.name for path in tmp_path.iterdir()] == ["cell.urdf"]


# -- No file of a simulated cell passes for one of a real cell: its first line says so ---------------------------------


@pytest.fixture
def run(finished_copy: Path) -> Path:
    """A simulated run with commands at targets."""
    with RunFile.open(finished_copy, write=True) as run:
        compensate_run(run, load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[:2])
    return finished_copy


def test_the_first_line_of_every_export_says_that_the_cell_is_simulated(run: Path, tmp_path: Path) -> None:
    with RunFile.open(run) as opened:
        for name, form in all_formats().items():
            for_one = None if name == "urdf-cell" else "left"
            out = tmp_path / f"{name}{form.suffix}"
            export_as_run(opened, name, out, for_one)
            lines = [line for line in out.read_text("utf-8").splitlines() if not line.startswith(("<?xml", "<robot"))]
            first = lines[0] if lines[0].strip() != "<!--" else lines[1]
            assert "of a simulated cell" in first, (name, lines[:3])
            assert not isinstance(form, CommandFormat) or first.startswith("# ")


def test_those_of_a_real_cell_do_not(tmp_path: Path) -> None:
    assert not load_profile(PROFILES / "ur10-real.yaml").is_simulated
    assert load_profile(PROFILES / "twin-wire.yaml").is_simulated
    assert finished_twin().is_simulated
    for form in all_formats().values():
        assert "simulated" not in form_line(form, simulated=False)
