"""What is read of PolyScope's files, and what is refused without being unpacked or followed."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.cell.programs.records import CorrectedTarget, ReadProgram
from cellapp.cell.programs.script_targets import read_urp
from cellapp.cell.programs.solving import rewritten
from cellapp.ground.errors import InputError
from tests.arms import UR10

ANGLES = '<JointAngles angles="0.1, -1.2, 1.3, -1.4, 1.5, 0.6"/>'
CALIBRATED = (
    '<Kinematics status="LINEARIZED"><deltaTheta value="0, 0.001, 0, 0, 0, 0"/><a value="0, -0.612, -0.5723, 0, 0, 0"/>'
    '<d value="0.1273, 0, 0, 0.163941, 0.1157, 0.0922"/>'
    '<alpha value="1.570796327, 0, 0, 1.570796327, -1.570796327, 0"/></Kinematics>'
)
PUBLISHED = CALIBRATED.replace("0.001", "0")
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


def read(body: str) -> ReadProgram:
    return read_urp(urp(body), "a.urp", UR10, UR10)


def waypoint(position: str, kind: str = "Fixed") -> str:
    return (
        f'<Move motionType="MoveL">\n<Waypoint type="{kind}" name="P"><position>{position}</position></Waypoint></Move>'
    )


@pytest.mark.parametrize("position", [ANGLES, ANGLES + PUBLISHED, ANGLES + UNKNOWN])
def test_fixed_waypoints_are_targets(position: str) -> None:
    (target,) = read(waypoint(position)).targets
    assert (target.line, target.command, target.kind) == (3, "MoveL P", "joints")
    assert target.numbers == (0.1, -1.2, 1.3, -1.4, 1.5, 0.6)


@pytest.mark.parametrize(
    ("body", "line", "reason"),
    [
        (waypoint(ANGLES + CALIBRATED), 3, "a calibration of its own"),
        (
            waypoint(ANGLES + UNKNOWN.replace("-0.612", "-0.425")),
            3,
            "an arm of another type: its rows are those of no arm",
        ),
        (OF_UR3E.replace("Kinematics", "kinematics") + waypoint(ANGLES), 3, "its rows are those of ur3e"),
        (waypoint(ANGLES + OF_UR3E), 3, "an arm of another type: its rows are those of ur3e"),
        (waypoint(ANGLES, "Variable"), 3, "type Variable"),
        (waypoint(ANGLES, "Relative"), 3, "type Relative"),
        (waypoint(""), 3, "no six joint positions"),
        (waypoint('<JointAngles angles="1, 2, nan, 4, 5, 6"/>'), 3, "no six joint positions"),
        ('<Waypoint><position joints="1,2,3,4,5,6" pose="1,2,3,4,5,6"/></Waypoint>', 2, "with a pose of its own"),
        ("<Script>\n<cachedContents>x = 1\nmovel(p[1,2,3,4,5,6])</cachedContents></Script>", 3, "script text"),
    ],
)
def test_other_motions_are_named_by_line(body: str, line: int, reason: str) -> None:
    program = read(body)
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


NUMBERS = st.lists(st.floats(-6.0, 6.0, allow_nan=False), min_size=6, max_size=6)


@given(angles=st.lists(NUMBERS, min_size=1, max_size=4), name=st.text(alphabet="aé&lt; ,'1", max_size=8))
def test_only_joint_positions_change(angles: list[list[float]], name: str) -> None:
    safe = name.replace("&", "&amp;").replace("<", "&lt;")
    texts = [" ,".join(map(repr, q)) for q in angles]
    body = "\n".join(
        f"<Waypoint name=\"{safe}\"><position><JointAngles a='1' angles = '{text}'/></position></Waypoint>"
        for text in texts
    )
    program = read(body)
    results = [
        CorrectedTarget(
            line=one.line, command=one.command, kind=one.kind, old=one.numbers, new=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        )
        for one in program.targets
    ]
    np.testing.assert_allclose([one.numbers for one in program.targets], angles)
    back = gzip.decompress(program.encode(rewritten(program.text, program.targets, results))).decode()
    new = " ,".join(f"{value:.10f}" for value in range(1, 7))
    for text in texts:
        body = body.replace(f"'{text}'", f"'{new}'")
    assert back == f"<URProgram name='a'>\n{body}\n</URProgram>"
