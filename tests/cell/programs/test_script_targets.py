"""What is read of URScript: targets with their values and lines, and why others are left."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellapp.cell.programs.records import CorrectedTarget, ReadProgram
from cellapp.cell.programs.script_targets import read_script
from cellapp.cell.programs.solving import rewritten
from cellapp.cell.programs.urscript import Unreadable, parse_expression, pose_matrix, pose_numbers, tokens_of
from cellapp.ground.errors import InputError

pytestmark = pytest.mark.fast

TCP = "set_tcp(p[0, 0, 0.1, 0, 0, 0])\n"
POSE, JOINTS = "p[0.4, -0.2, 0.3, 0, 3.1, 0]", "[0.1, -1.2, 1.3, -1.4, 1.5, 0.6]"
OTHER = "p[0.5, -0.2, 0.3, 0, 3.1, 0]"


def read(source: str) -> ReadProgram:
    return read_script((TCP + source).encode(), "a.script")


def reasons(source: str) -> dict[int, str]:
    return {one.line - 1: one.reason for one in read(source).left if one.refused}


def moved(source: str, by: float = 0.001) -> str:
    """The program with all numbers of its targets moved."""
    program = read(source)
    results = [
        CorrectedTarget(
            line=one.line,
            command=one.command,
            kind=one.kind,
            old=one.numbers,
            new=tuple(value + by for value in one.numbers),  # type: ignore[arg-type]
            q_new=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        )
        for one in program.targets
    ]
    return rewritten(program.text, program.targets, results).removeprefix(TCP)


NEW = "p[0.4010000000, -0.1990000000, 0.3010000000, 0.0010000000, 3.1010000000, 0.0010000000]"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (f"movel({POSE}, a=1.2, v=0.25)  # {POSE}", f"movel({NEW}, a=1.2, v=0.25)  # {POSE}"),
        (f"movel(pose={POSE})\r\n", f"movel(pose={NEW})\r\n"),
        ("movel( p[ 0.4,-0.2 ,.3,\n  0, 3.1,0 ] )", "movel( p[ 0.4010000000,-0.1990000000 ,0.3010000000,\n"
         "  0.0010000000, 3.1010000000,0.0010000000 ] )"),
        (f"P = {POSE}\nmovel(P)\nmovej(P)", f"P = {NEW}\nmovel(P)\nmovej(P)"),
        (f"P = {POSE}\nmovel(P)\nx = pose_dist(P, Q)", f"P = {POSE}\nmovel({NEW})\nx = pose_dist(P, Q)"),
        (f"P = {POSE}\nR = P\nmovel(R)", f"P = {POSE}\nR = P\nmovel({NEW})"),
        (f"movej(get_inverse_kin({POSE}, qnear={JOINTS}))", f"movej(get_inverse_kin({NEW}, qnear={JOINTS}))"),
        (f"q = get_inverse_kin({POSE})\nmovej(q)", f"q = get_inverse_kin({NEW})\nmovej(q)"),
        (f"q = get_inverse_kin({POSE})\nmovej(q)\ntextmsg(q)", f"q = get_inverse_kin({POSE})\n"
         "movej([1.0000000000, 2.0000000000, 3.0000000000, 4.0000000000, 5.0000000000, 6.0000000000])\ntextmsg(q)"),
        (f"movel(pose_trans({POSE}, p[0,0,0,0,0,0]))", f"movel({NEW})"),
        ("z = 0.3\nmovel(p[0.4, -0.2, z, 0, 3.1, 0])", f"z = 0.3\nmovel({NEW})"),
        (f'textmsg("movel({POSE})")\nmovel({POSE})', f'textmsg("movel({POSE})")\nmovel({NEW})'),
        (f"if x > 1: movel({POSE}) end", f"if x > 1: movel({NEW}) end"),
        (f"thread t():\n  movel({POSE})\nend\nrun t()", f"thread t():\n  movel({NEW})\nend\nrun t()"),
        (f'$ 3 "Waypoint_1" "breakAfter"\nmovel({POSE})', f'$ 3 "Waypoint_1" "breakAfter"\nmovel({NEW})'),
    ],
)  # fmt: skip
def test_new_numbers_stand_where_the_old_ones_did(source: str, expected: str) -> None:
    assert moved(source) == expected


@pytest.mark.parametrize(
    ("source", "line", "reason"),
    [
        (f"x = {POSE}\nwhile i < 3:\n  movel(x)\n  x = pose_add(x, d)\nend", 3, "assigned 2 times (lines 2, 5)"),
        (f"x = {POSE}\nx[2] = 0.5\nmovel(x)", 3, "'x' is assigned 2 times"),
        (f"def go(x):\n  movel(x)\nend\nx = {POSE}", 2, "'x' is a parameter of a function"),
        ("movel(pose_trans(get_actual_tcp_pose(), p[0,0,0.1,0,0,0]))", 1, "get_actual_tcp_pose(...) is known only"),
        ("movel(elsewhere)", 1, "'elsewhere' is not assigned in this program"),
        ("movej([1, 2, 3])", 1, "3 numbers instead of 6"),
        ("movej([1, 2, [3], 4, 5, q[1]])", 1, "known only while the program runs"),
        ("x = y\ny = x\nmovel(x)", 3, "'x' is defined by itself"),
        ("servoj([1, 2, 3, 4, 5, 6], t=0.002)", 1, "streamed"),
        ("movel(p[0.4 0.2, 0, 0, 0, 0])", 1, "this line cannot be read"),
        ("movej(get_inverse_kin([1, 2, 3, 4, 5, 6]))", 1, "joint positions instead of a pose"),
        (f"movec({POSE})", 1, "'pose_to' is missing"),
    ],
)  # fmt: skip
def test_what_is_no_constant_is_named_by_line(source: str, line: int, reason: str) -> None:
    found = reasons(source)
    assert list(found) == [line]
    assert reason in found[line]


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


@pytest.mark.slow
@given(poses=st.lists(NUMBERS, min_size=1, max_size=5), noise=NOISE, ends=st.sampled_from(["\n", "\r\n"]))
def test_programs_come_back_byte_for_byte(poses: list[list[float]], noise: list[str], ends: str) -> None:
    lines = [*noise]
    for pose in poses:
        lines += [f"movel(p{[float(value) for value in pose]}, v=0.1)", *noise]
    source = ends.join(lines)
    program = read(source)
    assert [one.numbers for one in program.targets] == [tuple(pose) for pose in poses]
    assert (
        program.encode(rewritten(program.text, program.targets, [])) == (TCP + source).encode() if not poses else True
    )
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


@given(NUMBERS)
def test_poses_and_matrices_are_the_same(pose: list[float]) -> None:
    again = pose_matrix(pose_numbers(pose_matrix(pose)))
    np.testing.assert_allclose(again, pose_matrix(pose), atol=1e-9)


@pytest.mark.parametrize("text", ["(" * 5000 + "1" + ")" * 5000, "[" * 5000, "1" + "+1" * 5000, "x" + "[0]" * 5000])
def test_very_deep_expressions_are_unreadable_and_no_crash(text: str) -> None:
    with pytest.raises(Unreadable):
        parse_expression(list(tokens_of(text)))


def test_very_long_chains_of_variables_are_named() -> None:
    chain = "".join(f"x{k} = x{k - 1}\n" for k in range(1, 3000))
    found = reasons(f"x0 = {POSE}\n{chain}movel(x2999)")
    assert "stands behind more than 40 other variables" in found[3001]


def test_a_byte_order_mark_is_no_word() -> None:
    assert len(read_script(f"\ufeffdef a():\nmovej({JOINTS})\nend".encode(), "a").targets) == 1
