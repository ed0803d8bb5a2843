"""A corrected program, run by a plain controller on the simulated cell, reaches the true poses."""

from __future__ import annotations

import dataclasses
import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.programs.records import CorrectResult
from cellapp.cell.run import RunFile
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.ground.errors import InputError
from cellapp.robot.model import CellModel
from drivers.plant import Plant
from tests.approved import assert_refused
from tests.cell.programs.plain_controller import PlainController, Pose, forward, matrix, pose_of
from tests.postures import far_from_singular
from tests.verbs import correct_run

Array = NDArray[np.float64]
FACTOR = 15.0
ANGLES = re.compile(r'angles="([^"]*)"')


@dataclasses.dataclass(frozen=True)
class Cell:
    """One arm of the simulated cell and a program for it.

    Attributes
    ----------
    rows : array, shape (6, 4)
    tcp : tuple
        The TCP at the SMR.
    base : array, shape (4, 4)
        The published chain's base in the tracker frame.
    q : array, shape (n, 6)
        Postures within the range of the readings.
    """

    name: str
    run: RunFile
    plant: Plant
    rows: Array
    tcp: Pose
    base: Array
    q: Array


@pytest.fixture(scope="module")
def cell(finished_run: Path) -> Cell:
    return cell_of(finished_run, "left")


def cell_of(folder: Path, name: str) -> Cell:
    with RunFile.open(folder) as run:
        model = CellModel.load(folder / CALIBRATION_FILE).arms[name]
        measured = run.readings(name).q
        tcp = Pose((*model.geometry.tool, 0.3, -0.2, 0.5))
        q = measured + np.random.default_rng(3).uniform(-0.02, 0.02, measured.shape)
        q = np.clip(q, measured.min(axis=0) + 0.02, measured.max(axis=0) - 0.02)
        q = q[far_from_singular(model.geometry, q)][:12]  # at singular ones a correction is refused
        rows = model.nominal.rows[:, :4]
        return Cell(name, run, build_plant(run.profile), rows, tcp, model.nominal.T_M_B(), q)


def text(numbers: object) -> str:
    return "[" + ", ".join(f"{float(value):.9f}" for value in numbers) + "]"  # type: ignore[attr-defined]


def program(cell: Cell) -> str:
    """A program with every way to say a target; all mean the postures of the cell, in their order."""
    poses = [text(pose_of(forward(cell.rows, q) @ matrix(cell.tcp))) for q in cell.q]
    feature = Pose((0.1, -0.2, 0.05, 0.1, 0.2, -0.3))
    local = text(pose_of(np.linalg.inv(matrix(feature)) @ forward(cell.rows, cell.q[3]) @ matrix(cell.tcp)))
    lines = [
        f"  set_tcp(p{text(cell.tcp)})  # TCP p[9, 9, 9, 9, 9, 9]",
        f"  global P1_p = p{poses[1]}",
        f"  global P1_q = {text(cell.q[1])}",
        f"  local feature = p{text(feature)}",
        f"  movej({text(cell.q[0])}, a=1.4, v=1.05)",
        "  movej(get_inverse_kin(P1_p, qnear=P1_q), a=1.4, v=1.05)",
        '  textmsg("movel(p[1, 2, 3, 4, 5, 6])")',
        f"  movel(get_inverse_kin(p{poses[2]}, qnear={text(cell.q[2])}), 1.2, 0.25)",
        f"  movej(get_inverse_kin(pose_trans(feature, p{local}), {text(cell.q[3])}))",
        "  i = 0",
        "  while (i < 1):",
        f"    movep(get_inverse_kin(p{poses[4]}, {text(cell.q[4])}), r=0.01)",
        "    i = i + 1",
        "  end",
    ]
    lines += [f"  movej({text(q)})" for q in cell.q[5:]]
    return "def prog():\n" + "\n".join(lines) + "\nend\nprog()\n"


def corrected(cell: Cell, source: str, folder: Path, kind: str = ".script") -> tuple[str, CorrectResult]:
    (folder / f"old{kind}").write_bytes(source.encode() if kind == ".script" else gzip.compress(source.encode()))
    with RunFile.open(cell.run.folder) as run:
        result = correct_run(run, folder / f"old{kind}", folder / f"new{kind}", cell.name)
        assert result.refused == ()
        with pytest.raises(InputError, match="is a corrected copy"):
            correct_run(run, folder / f"new{kind}", folder / f"twice{kind}", cell.name)
    data = (folder / f"new{kind}").read_bytes()
    text = (data if kind == ".script" else gzip.decompress(data)).decode()
    *lines, mark, empty = text.split("\n")
    assert "never correct this copy again" in mark
    return "\n".join([*lines, empty]), result


def driven(cell: Cell, source: str) -> Array:
    return np.array(PlainController(cell.rows, cell.q[0]).run(source))


def errors(cell: Cell, q: Array) -> tuple[Array, Array]:
    """True distances (n,) [m] of the TCP, and angles (n,) [rad] of the flange up to how it sits on the last axis."""
    wanted = np.array([cell.base @ forward(cell.rows, one) @ matrix(cell.tcp) for one in cell.q])
    apart = np.linalg.norm(cell.plant.smr_positions(cell.name, q) - wanted[:, :3, 3], axis=1)
    flanges = np.array([cell.base[:3, :3] @ forward(cell.rows, one)[:3, :3] for one in cell.q])
    off = Rotation.from_matrix(flanges.transpose(0, 2, 1) @ true_rotations(cell, q))
    return apart, (off.mean().inv() * off).magnitude()


def true_rotations(cell: Cell, q: Array) -> Array:
    """True rotations (n, 3, 3) of the flange in the tracker frame, by reflectors 0.1 m apart on the same plant."""
    config = cell.plant.config
    points = []
    for shift in (np.zeros(3), *(0.1 * np.eye(3))):
        arms = tuple(
            dataclasses.replace(arm, smr_offset=arm.smr_offset + shift) if arm.name == cell.name else arm
            for arm in config.arms
        )
        points.append(Plant(dataclasses.replace(config, arms=arms)).smr_positions(cell.name, q))
    axes = np.stack([(point - points[0]) / 0.1 for point in points[1:]], axis=2)
    u, _, vt = np.linalg.svd(axes)
    return np.asarray(u @ vt)


def test_a_corrected_program_reaches_the_true_poses(cell: Cell, tmp_path: Path) -> None:
    source = program(cell)
    new, result = corrected(cell, source, tmp_path)
    assert len(result.targets) == len(cell.q)
    before, turned_before = errors(cell, driven(cell, source))
    after, turned_after = errors(cell, driven(cell, new))
    assert before.mean() > 0.3e-3
    assert after.mean() < before.mean() / FACTOR
    assert turned_after.mean() < turned_before.mean() / FACTOR
    asked = [one.correction_mm for one in result.targets]
    assert all(size is not None and 0.05 < size < 20.0 for size in asked)
    changed = [(a, b) for a, b in zip(source.split("\n"), new.split("\n"), strict=True) if a != b]
    assert len(changed) == len(cell.q), "a line for each target, all others byte for byte"


def test_a_posture_that_the_gate_refuses_is_said_by_its_line(cell: Cell, tmp_path: Path) -> None:
    under = cell.q[0].copy()
    under[1:3] = 0.9, 0.3
    (tmp_path / "old.script").write_text(f"movej({text(cell.q[0])})\nmovej({text(under)})\n")
    with RunFile.open(cell.run.folder) as run:
        result = correct_run(run, tmp_path / "old.script", tmp_path / "new.script", "left", extrapolate=True)
    (note,) = [note for note in result.notes if note.startswith("line ")]
    assert note.startswith("line 2: movej: with the other arms at home, arm left: collides with the floor")


def waypoint(number: int, q: Array) -> str:
    return (
        f'<Waypoint type="Fixed" name="Way point {number} &amp; \u00e9" kinematicsFlags="1">\n<motionParameters/>\n'
        f'<position>\n<JointAngles angles="{", ".join(map(repr, q.tolist()))}"/>\n'
        '<TCPOffset pose="0.0, 0.0, 0.1, 0.0, 0.0, 0.0"/>\n<Kinematics status="NOT_INITIALIZED">'
        '<deltaTheta value="0.0, 0.0, 0.0, 0.0, 0.0, 0.0"/></Kinematics>\n</position>\n</Waypoint>\n'
    )


def angles(program: str) -> Array:
    return np.array([[float(part) for part in one.split(",")] for one in ANGLES.findall(program)])


def test_a_corrected_urp_reaches_the_true_poses(cell: Cell, tmp_path: Path) -> None:
    body = "".join(waypoint(number, q) for number, q in enumerate(cell.q))
    source = f'<URProgram name="cell"><children><Move motionType="MoveJ">{body}</Move></children></URProgram>\n'
    new, result = corrected(cell, source, tmp_path, ".urp")
    assert result.targets[0].command == "MoveJ Way point 0 & \u00e9"
    before, _ = errors(cell, angles(source))
    after, _ = errors(cell, angles(new))
    assert after.mean() < before.mean() / FACTOR
    for one, other in zip(ANGLES.findall(source), ANGLES.findall(new), strict=True):
        new = new.replace(other, one)
    assert new == source, "nothing but joint positions has changed"


def test_nothing_is_written_where_a_target_cannot_be_corrected(cell: Cell, tmp_path: Path) -> None:
    (tmp_path / "old.script").write_text("movej(somewhere())\n" + f"movej({text(cell.q[0])})\n")
    with RunFile.open(cell.run.folder) as run:
        result = correct_run(run, tmp_path / "old.script", tmp_path / "new.script", "left")
        assert result.refused == ((1, "movej", "somewhere(...) is known only while the program runs"),)
        assert result.out is None
        assert not (tmp_path / "new.script").exists()
        part = correct_run(run, tmp_path / "old.script", tmp_path / "new.script", "left", partly=True)
    first, second, _ = (tmp_path / "new.script").read_text().splitlines()
    assert first == "movej(somewhere())"
    assert second != f"movej({text(cell.q[0])})"
    assert CorrectResult.from_json(part.to_json(), "test") == part
    with RunFile.open(cell.run.folder) as run, pytest.raises(InputError, match="exists already"):
        correct_run(run, tmp_path / "old.script", tmp_path / "new.script", "right", partly=True, extrapolate=True)


def test_bad_requests_are_one_sentence_as_approved(cell: Cell, tmp_path: Path) -> None:
    """Lines name a program, where its correction goes, and its arm."""
    (tmp_path / "old.script").write_text("movej([0,0,0,0,0,0])")
    (tmp_path / "empty.script").write_text("x = 1")
    (tmp_path / "blocks.script").write_text("def f():")
    (tmp_path / "old.urp").write_text("<URProgram/>")

    def refused(program: str, out: str, arm: str | None = None) -> object:
        with RunFile.open(cell.run.folder) as run:
            return correct_run(run, tmp_path / program, tmp_path / out, arm)

    assert_refused(Path(__file__).parent / "approved" / "requests.txt", refused, tmp_path, cell.run.folder)
    assert not list(tmp_path.glob("new.*"))
