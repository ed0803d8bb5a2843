"""What is read of URScript: targets with their values and lines, and why others are left."""

from __future__ import annotations

import contextlib
import gzip
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.driving.collect import collect_run
from cellapp.cell.profile.controller_file import controller_file_text, controller_table
from cellapp.cell.programs.records import CorrectedTarget, ProgramTarget, ReadProgram
from cellapp.cell.programs.script_targets import read_script, read_urp
from cellapp.cell.programs.solving import Workplace, controller_chain, flange_of, rewritten, solve_targets
from cellapp.cell.programs.urscript import pose_matrix, pose_numbers
from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import recorded_controllers
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.commands.report.data import read_report_data
from cellapp.commands.report.sections import controllers_section
from cellapp.commands.run_state import RunState
from cellapp.commands.view.table import Table
from cellapp.ground.errors import InputError
from cellapp.ground.profile.schema import FactoryErrors
from cellapp.ground.profile.sections import ControllerTable
from cellapp.robot.kinematics.statics import Bodies
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import controller_rows, published_rows
from drivers.plant.factory import factory_calibration
from tests.approved import assert_refused
from tests.arms import OFF_AXIS, UR10, UR10_CENTERS, UR10_MASSES, at_station, true_geometry
from tests.cell.programs.test_truth import FACTOR, Array, Cell, angles, cell_of, corrected, errors, waypoint
from tests.made_once import made_once
from tests.sure import sure
from tests.twin import altered, small_twin, with_arm
from tests.verbs import correct_run

TCP = "set_tcp(p[0, 0, 0.1, 0, 0, 0])\n"
POSE, JOINTS = "p[0.4, -0.2, 0.3, 0, 3.1, 0]", "[0.1, -1.2, 1.3, -1.4, 1.5, 0.6]"
OTHER = "p[0.5, -0.2, 0.3, 0, 3.1, 0]"


def read(source: str) -> ReadProgram:
    return read_script((TCP + source).encode(), "a.script")


def reasons(source: str) -> dict[int, str]:
    return {one.line - 1: one.reason for one in read(source).left if one.refused}


def result_of(one: ProgramTarget, new: Sequence[float], **more: Any) -> CorrectedTarget:
    return CorrectedTarget(
        line=one.line, command=one.command, kind=one.kind, old=one.numbers, new=tuple(new), **more  # type: ignore[arg-type]
    )  # fmt: skip


def moved(source: str, by: float = 0.001) -> str:
    """The program with all numbers of its targets moved."""
    program = read(source)
    q_new = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    results = [result_of(one, [value + by for value in one.numbers], q_new=q_new) for one in program.targets]
    return rewritten(program.text, program.targets, results).removeprefix(TCP)


NEW = "p[0.4010000000, -0.1990000000, 0.3010000000, 0.0010000000, 3.1010000000, 0.0010000000]"


def test_new_numbers_stand_where_the_old_ones_did_as_approved() -> None:
    """Below each program: what it becomes; NEW stands for the moved POSE, all other text is kept."""

    def changed(source: str) -> str:
        for word, text in (("POSE", POSE), ("JOINTS", JOINTS), ("\\r", "\r")):
            source = source.replace(word, text)
        shown = moved(source)
        for word, text in (("NEW", NEW), ("POSE", POSE), ("JOINTS", JOINTS), ("\\r", "\r")):
            shown = shown.replace(text, word)
        return shown.replace("$ ", "\\$ ")  # which would begin a line of the text

    assert_refused(Path(__file__).parent / "approved" / "new-numbers.txt", changed)


def test_what_is_no_constant_is_named_by_line() -> None:
    def refused(source: str) -> str:
        found = reasons(source.replace("POSE", POSE).replace("JOINTS", JOINTS))
        return "\n".join(f"{line}: {reason}" for line, reason in found.items())

    assert_refused(Path(__file__).parent / "approved" / "no-constants.txt", refused)


def test_motions_without_a_target_are_left() -> None:
    program = read("speedl([0, 0, 0.1, 0, 0, 0], 0.5, 0.1)\n" + f"movel({POSE})")
    assert [(one.command, one.refused) for one in program.left] == [("speedl", False)]
    assert len(program.targets) == 1


def test_the_tcp_is_that_of_the_program() -> None:
    assert read(f"movel({POSE})").targets[0].tcp == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    two = f"def p1():\n  set_tcp(p[0,0,0.2,0,0,0])\n  movel({POSE})\n"
    again = read_script((two + f"  set_tcp(p[0,0,0.3,0,0,0])\n  movel({POSE})\nend").encode(), "a")
    assert [one.tcp[2] for one in again.targets if one.tcp] == [0.2, 0.3]
    looped = read_script((two + "  while True:\n    set_tcp(p[0,0,0.3,0,0,0])\n  end\nend").encode(), "a")
    assert "decides which holds here" in looped.left[0].reason
    bare = read_script(f"movel({POSE})\nmovej({JOINTS})".encode(), "a")
    assert "give --tcp" in bare.left[0].reason
    assert bare.targets[0].kind == "joints"
    with pytest.raises(InputError, match="a:1: the program sets its own TCP; leave --tcp out"):
        read_script(TCP.encode(), "a", (0.0,) * 6)
    own = read(f"movej(get_inverse_kin({POSE}, tcp=p[0,0,0.4,0,0,0]))").targets[0]
    assert own.tcp == (0.0, 0.0, 0.4, 0.0, 0.0, 0.0)
    broken = read(f"set_tcp(p[0 0])\nmovel({POSE})")
    assert [one.reason for one in broken.left] == [
        "this line cannot be read",
        "the TCP is not known: a line with set_tcp cannot be read",
    ]


def test_the_payload_and_the_point_on_the_way() -> None:
    program = read(f"set_payload(2.5, [0,0,0.05])\nmovec({POSE}, {OTHER}, mode=1)")
    assert program.payload_kg == 2.5
    via, to = program.targets
    assert (via.position_only, to.position_only) == (True, False)
    assert via.facing == to.numbers
    assert read("set_payload(1)\nset_payload(2)").payload_kg is None


@pytest.mark.parametrize(
    ("source", "words"), [("end", "a.script:2: 'end' without"), ("if x:\n", "a.script:2: 'if' has no")]
)
def test_blocks_that_do_not_match_are_refused(source: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(source)


NUMBERS = st.lists(st.floats(-3.0, 3.0, allow_nan=False).map(lambda value: round(value, 6)), min_size=6, max_size=6)
LINES = ["# movel(p[1,2,3,4,5,6])", 'textmsg("end")', "x = x + 1", "", "  sleep(0.1)", "set_digital_out(1, True)"]
NOISE = st.lists(st.sampled_from(LINES))


@given(poses=st.lists(NUMBERS, min_size=1, max_size=5), noise=NOISE, ends=st.sampled_from(["\n", "\r\n"]))
def test_programs_come_back_byte_for_byte(poses: list[list[float]], noise: list[str], ends: str) -> None:
    lines = [*noise]
    for pose in poses:
        lines += [f"movel(p{[float(value) for value in pose]}, v=0.1)", *noise]
    source = ends.join(lines)
    program = read(source)
    assert [one.numbers for one in program.targets] == [tuple(pose) for pose in poses]
    assert program.encode(program.text) == (TCP + source).encode()
    there = moved(source, 0.25)
    back = read(there)
    for one, pose in zip(back.targets, poses, strict=True):
        np.testing.assert_allclose(one.numbers, np.array(pose) + 0.25, atol=1e-10)
    kept = [line for line in source.split("\n") if "movel(p[" not in line or "#" in line]
    assert [line for line in there.split("\n") if "movel(p[" not in line or "#" in line] == kept


@given(st.text(alphabet='movel(p[1,2.e-]+*)\n"#:= end if def', max_size=60))
def test_any_text_is_read_or_refused_in_words(text: str) -> None:
    with contextlib.suppress(InputError):
        program = read_script(text.encode(), "a")
        assert program.encode(program.text) == text.encode()


def test_very_long_chains_of_variables_are_named() -> None:
    chain = "".join(f"x{k} = x{k - 1}\n" for k in range(1, 3000))
    found = reasons(f"x0 = {POSE}\n{chain}movel(x2999)")
    assert "stands behind more than 40 other variables" in found[3001]


# -- A controller with its factory's calibration: nominal in the profile, read back, compared, its programs corrected --

_CHAIN = ("deltaTheta", "d", "a", "alpha")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated run whose controllers have a calibration; that of the left one is nominal."""

    def make(folder: Path) -> None:
        twin = small_twin(
            30, plan={"method": "random"}, plant={"factory": FactoryErrors(length=1e-4, angle=1e-4), "effects": {}}
        )
        twin = altered(twin, network={"kind": "none"})
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
        section = controllers_section(run, read_report_data(RunState(run)))
    table = sure(section).parts[0]
    assert isinstance(table, Table)
    mean = {(row[0], row[1]): row[2] for row in table.rows}
    for arm in ("left", "right"):
        published, factory, ours = (mean[arm, whose] for whose in ("published", "factory", "cellapp"))
        assert isinstance(published, float)
        assert isinstance(factory, float)
        assert isinstance(ours, float)
        assert ours < factory < 0.6 * published


def test_a_file_that_is_no_calibration_is_refused_as_approved() -> None:
    assert_refused(
        Path(__file__).parent / "approved" / "no-calibration.txt",
        lambda text: controller_table(text, Path("left.conf")),
    )


# -- Corrections of single targets: exact by the model, on the branch of the controller, refused with a reason ---------

HOME = np.array([0.3, -1.4, 1.6, -1.7, 1.2, 0.4])
TCP_OF_SOLVING = (0.02, -0.03, 0.15, 0.1, 0.2, 0.3)
LIMITS = np.tile([-2.0 * np.pi, 2.0 * np.pi], (6, 1))


def arm_model(seed: int | None = 1) -> ArmModel:
    nominal = at_station(UR10, OFF_AXIS)
    true = nominal if seed is None else true_geometry(nominal, np.random.default_rng(seed))
    bodies = Bodies(UR10_MASSES, UR10_CENTERS, 2.0, np.array([0.0, 0.0, 0.05]))
    return ArmModel(true, nominal, bodies, np.array([0.1, 0.0, 0.99498744]))


def solved(arm: ArmModel, program: ReadProgram) -> list[CorrectedTarget]:
    around = np.array([HOME - 1.0, HOME + 1.0])
    return solve_targets(Workplace(arm, LIMITS, HOME, around, 7, None, extrapolate=False), program.targets)


def test_an_arm_without_errors_leaves_the_program_byte_for_byte() -> None:
    T_B_T = flange_of(controller_chain(arm_model()), HOME[None] + 0.1)[0] @ pose_matrix(TCP_OF_SOLVING)
    pose = [round(value, 9) for value in pose_numbers(T_B_T)]
    source = f"movej({HOME.tolist()})\nmovel(p{pose}, v = .1)\n"
    program = read_script(source.encode(), "a", TCP_OF_SOLVING)
    results = solved(arm_model(None), program)
    assert [one.correction_mm for one in results] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert rewritten(program.text, program.targets, results) == source


def test_targets_without_a_correction_say_why_as_approved() -> None:
    def refused(source: str) -> str:
        (result,) = solved(arm_model(), read_script(source.encode(), "a", TCP_OF_SOLVING))
        assert result.new is None
        return result.reason

    assert_refused(Path(__file__).parent / "approved" / "no-correction.txt", refused)


# -- Programs of the pendant (.urp) ------------------------------------------------------------------------------------


ANGLES = '<JointAngles angles="0.1, -1.2, 1.3, -1.4, 1.5, 0.6"/>'
CALIBRATED = (
    '<Kinematics status="LINEARIZED"><deltaTheta value="0, 0.001, 0, 0, 0, 0"/><a value="0, -0.612, -0.5723, 0, 0, 0"/>'
    '<d value="0.1273, 0, 0, 0.163941, 0.1157, 0.0922"/>'
    '<alpha value="1.570796327, 0, 0, 1.570796327, -1.570796327, 0"/></Kinematics>'
)
PUBLISHED = CALIBRATED.replace("0.001", "0")
EARLIER = '<JointAngles angles="1, 1, 1, 1, 1, 1"/><Kinematics status="LINEARIZED"/>'
UNKNOWN = CALIBRATED.replace("LINEARIZED", "NOT_INITIALIZED")
OF_UR3E = (
    '<Kinematics status="NOT_INITIALIZED"><deltaTheta value="0, 0, 0, 0, 0, 0"/>'
    '<a value="0, -0.24355, -0.2132, 0, 0, 0"/><d value="0.15185, 0, 0, 0.13105, 0.08535, 0.0921"/>'
    '<alpha value="1.570796327, 0, 0, 1.570796327, -1.570796327, 0"/></Kinematics>'
)
FOREIGN = b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>\n<URProgram>&b;</URProgram>'
GROWING = b'<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]><URProgram>&c;</URProgram>'


def urp(body: str) -> bytes:
    return gzip.compress(f"<URProgram name='a'>\n{body}\n</URProgram>".encode())


def read_of_urp(body: str) -> ReadProgram:
    return read_urp(urp(body), "a.urp", UR10, UR10)


def waypoint_of_urp(position: str, kind: str = "Fixed") -> str:
    return (
        f'<Move motionType="MoveL">\n<Waypoint type="{kind}" name="P"><position>{position}</position></Waypoint></Move>'
    )


@pytest.mark.parametrize("position", [ANGLES, ANGLES + PUBLISHED, ANGLES + UNKNOWN, EARLIER + ANGLES + UNKNOWN])
def test_fixed_waypoints_are_targets(position: str) -> None:
    (target,) = read_of_urp(waypoint_of_urp(position)).targets
    assert (target.line, target.command, target.kind) == (3, "MoveL P", "joints")
    assert target.numbers == (0.1, -1.2, 1.3, -1.4, 1.5, 0.6)


@pytest.mark.parametrize(
    ("body", "line", "reason"),
    [
        (waypoint_of_urp(ANGLES + CALIBRATED), 3, "a calibration of its own"),
        (
            waypoint_of_urp(ANGLES + UNKNOWN.replace("-0.612", "-0.425")),
            3,
            "an arm of another type: its rows are those of no arm",
        ),
        (OF_UR3E.replace("Kinematics", "kinematics") + waypoint_of_urp(ANGLES), 3, "its rows are those of ur3e"),
        (waypoint_of_urp(ANGLES + OF_UR3E), 3, "an arm of another type: its rows are those of ur3e"),
        (waypoint_of_urp(ANGLES, "Variable"), 3, "type Variable"),
        (waypoint_of_urp(ANGLES, "Relative"), 3, "type Relative"),
        (waypoint_of_urp(""), 3, "no six joint positions"),
        (waypoint_of_urp('<JointAngles angles="1, 2, nan, 4, 5, 6"/>'), 3, "no six joint positions"),
        ('<Waypoint><position joints="1,2,3,4,5,6" pose="1,2,3,4,5,6"/></Waypoint>', 2, "with a pose of its own"),
        (waypoint_of_urp(ANGLES + '<position joints="1,2,3,4,5,6" pose=""/>'), 3, "with a pose of its own"),
        (waypoint_of_urp('<position joints="1,2,3,4,5,6" pose=""/>' + ANGLES), 3, "with a pose of its own"),
        ("<Script>\n<cachedContents>x = 1\nmovel(p[1,2,3,4,5,6])</cachedContents></Script>", 3, "script text"),
    ],
)
def test_other_motions_are_named_by_line(body: str, line: int, reason: str) -> None:
    program = read_of_urp(body)
    assert program.targets == ()
    (left,) = program.left
    assert (left.line, left.refused) == (line, True)
    assert reason in left.reason


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no gzip", "a.urp: no PolyScope program: it is not packed by gzip"),
        (urp("")[:-12], "a.urp: the file ends too early"),
        (urp("<a>"), "a.urp:3: not XML"),
        (gzip.compress(b"<html/>"), "its XML is 'html' instead of 'URProgram'"),
        (gzip.compress(FOREIGN), "document type"),
        (gzip.compress(GROWING), "document type"),
        (gzip.compress(b" " * (33 * 2**20)), "more than 32 MB"),
    ],
    ids=["unpacked", "cut", "open element", "page", "foreign entity", "growing entity", "too large"],
)  # fmt: skip
def test_damaged_and_hostile_files_are_refused_in_words(data: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read_urp(data, "a.urp", UR10, UR10)


NUMBERS_OF_URP = st.lists(st.floats(-6.0, 6.0, allow_nan=False), min_size=6, max_size=6)


@given(angles=st.lists(NUMBERS_OF_URP, min_size=1, max_size=4), name=st.text(alphabet="aé&lt; ,'1", max_size=8))
def test_only_joint_positions_change(angles: list[list[float]], name: str) -> None:
    safe = name.replace("&", "&amp;").replace("<", "&lt;")
    texts = [" ,".join(map(repr, q)) for q in angles]
    body = "\n".join(
        f"<Waypoint name=\"{safe}\"><position><JointAngles a='1' angles = '{text}'/></position></Waypoint>"
        for text in texts
    )
    program = read_of_urp(body)
    results = [result_of(one, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) for one in program.targets]
    np.testing.assert_allclose([one.numbers for one in program.targets], angles)
    back = gzip.decompress(program.encode(rewritten(program.text, program.targets, results))).decode()
    new = " ,".join(f"{value:.10f}" for value in range(1, 7))
    for text in texts:
        body = body.replace(f"'{text}'", f"'{new}'")
    assert back == f"<URProgram name='a'>\n{body}\n</URProgram>"
