"""Targets as CSV: columns with their units, and what is refused by line, target and column."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.targets import Partner, Target, WorkingConditions, load_targets
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import rotation_zyx
from tests.twin import small_twin

PROFILE = small_twin()
HEADER = "name,arm,x_mm,y_mm,z_mm"
PARTNER = ",partner_arm,partner_x_mm,partner_y_mm,partner_z_mm"
ROW = "one,left,-400,250.5,1000"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "targets.csv"


def loaded(path: Path, *lines: str) -> tuple[Target, ...]:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return load_targets(path, PROFILE)


def refusal(path: Path, *lines: str) -> str:
    """The message, without the folder of the file."""
    with pytest.raises(InputError) as told:
        loaded(path, *lines)
    return str(told.value).replace(f"{path.parent}/", "")


def test_positions_in_millimetres_and_in_metres(path: Path) -> None:
    (mm,) = loaded(path, HEADER, ROW)
    (metres,) = loaded(path, "name,arm,x_m,y_m,z_m", "one,left,-0.4,0.2505,1")
    assert mm == Target(name="one", arm="left", position=(-0.4, 250.5 * 1e-3, 1.0))
    np.testing.assert_allclose(mm.position, metres.position, rtol=0.0, atol=1e-15)
    assert mm.rpy is None


def test_a_byte_order_mark_quotes_spaces_and_blank_rows(path: Path) -> None:
    path.write_bytes(b'\xef\xbb\xbfname, arm,x_mm,y_mm,z_mm\r\n\r\n"a, b", left,1,2,3\r\n')
    (target,) = load_targets(path, PROFILE)
    assert (target.name, target.arm) == ("a, b", "left")


def test_every_column(path: Path) -> None:
    header = (
        f"{HEADER},frame,roll_deg,pitch_deg,yaw_deg,tolerance_um,approach1,approach2,approach6,approach3,approach4,"
        "approach5,payload_kg,temperature_c,time_s,dwell_s,partner_arm,partner_x_mm,partner_y_mm,partner_z_mm,"
        "partner_roll_deg,partner_pitch_deg,partner_yaw_deg,partner_payload_kg"
    )
    row = f"{ROW},tracker,90,0,-45,150,1,,-1,,,,2.5,23,60,1,right,0,0,100,180,0,0,0.5"
    (target,) = loaded(path, header, row)
    assert target == Target(
        name="one",
        arm="left",
        position=(-0.4, 250.5 * 1e-3, 1.0),
        frame="tracker",
        rpy=(math.pi / 2.0, 0.0, -math.pi / 4.0),
        tolerance=150 * 1e-6,
        approach=(1, 0, 0, 0, 0, -1),
        conditions=WorkingConditions(payload=2.5, temperature=23.0, time=60.0, dwell=1.0),
        partner=Partner(
            arm="right", position=(0.0, 0.0, 0.1), rpy=(math.pi, 0.0, 0.0), conditions=WorkingConditions(payload=0.5)
        ),
    )


def test_quaternions_and_rotation_vectors(path: Path) -> None:
    rotation = Rotation.from_euler("ZYX", [0.3, -0.4, 2.0])
    x, y, z, w = rotation.as_quat()
    quaternion, vector = f"{w},{x},{y},{z},,,", ",,,," + ",".join(map(str, np.degrees(rotation.as_rotvec())))
    header = f"{HEADER},qw,qx,qy,qz,rx_deg,ry_deg,rz_deg"
    targets = loaded(path, header, f"{ROW},{quaternion}", f"two{ROW[3:]},{vector}", f"three{ROW[3:]},,,,,,,")
    for target in targets[:2]:
        assert target.rpy is not None
        np.testing.assert_allclose(rotation_zyx(*target.rpy[::-1]), rotation.as_matrix(), rtol=0.0, atol=1e-14)
    assert targets[2].rpy is None


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("name,arm,x_mm,y_m,z_mm", "targets.csv:1: y_m: column x_mm is in mm; give all coordinates of a file in"),
        ("name,arm,x,y_mm,z_mm", "targets.csv:1: x: has no unit; name it x_mm or x_m"),
        ("name,arm,x_inch,y_mm,z_mm", "'inch' is no unit of this column; name it x_mm or x_m"),
        ("name,arm,x_mm,y_mm", "targets.csv:1: z_mm: the column is missing"),
        (f"{HEADER},x_mm", "targets.csv:1: x_mm: the column is there twice; keep one"),
        (f"{HEADER},x_m", "targets.csv:1: x_m: the same value as column x_mm; keep one"),
        (f"{HEADER},colour", "targets.csv:1: colour: unknown column; remove it, or correct its name"),
        (f"{HEADER},roll_deg,pitch_deg", "targets.csv:1: yaw_deg: the column is missing"),
        (f"{HEADER},roll_deg,pitch_deg,yaw_rad", "yaw_rad: column roll_deg is in deg; give all angles of a"),
        (f"{HEADER},partner_x_mm,partner_y_mm,partner_z_mm", "partner_arm: the column is missing"),
        (f"{HEADER},partner_arm,partner_x_m,partner_y_m,partner_z_m", "partner_x_m: column x_mm is in mm"),
        (f"{HEADER},approach2", "targets.csv:1: approach1: the column is missing"),
        ("name;arm;x_mm;y_mm;z_mm", "targets.csv:1: the header is one column; separate columns by commas, and write"),
        ("", "targets.csv is empty; expected a header row and a row per target"),
    ],
)
def test_a_header_that_is_refused(path: Path, header: str, says: str) -> None:
    assert says in refusal(path, header)


@pytest.mark.parametrize(
    ("more", "row", "says"),
    [
        ("", "", "targets.csv:1: targets: there is a header row but no target; expected a row for each"),
        ("", "one,left,1,2", "targets.csv:2: z_mm: the row has 4 cells, the header has 5"),
        ("", "one,left,-400,250,5,1000", "the row has 6 cells, the header has 5; write 0.5, not 0,5"),
        ("", 'one,left,-400,"250,5",1000', "'one': y_mm: expected a number with a decimal point, got '250,5'"),
        ("", "one,left,-400,nan,1000", "targets.csv:2: target 'one': y_mm: expected a finite number such as 0.25, got"),
        ("", "one,left,-400,250 mm,1000", "y_mm: expected a finite number such as 0.25, got '250 mm'; it is in mm"),
        ("", "one,left,-400,,1000", "targets.csv:2: target 'one': y_mm: the value is missing; the row has others"),
        ("", "one,left,-400,250000,1000", "target 'one': y_mm: 250 m is beyond 100 m; is the unit in the column's"),
        ("", ",left,1,2,3", "targets.csv:2: target 1: name: expected a text, got an empty one"),
        ("", f"{ROW}\n{ROW}", "targets.csv:3: target 'one' is listed twice"),
        (",frame", f"{ROW},table", "no frame 'table'; frames are base, tracker, left, right; a YAML list, whose"),
        (",qw,qx,qy,qz", f"{ROW},0.9,0,0,0", "target 'one': qw: its norm is 0.9, 0.1 from one (at most 0.001)"),
        (",roll_rad,pitch_rad,yaw_rad", f"{ROW},0,90,0", "target 'one': pitch_rad: 90 rad is more than two turns; is"),
        (",roll_deg,pitch_deg,yaw_deg,qw,qx,qy,qz", f"{ROW},0,0,0,1,0,0,0", "target 'one': qw: 'rpy' is there too; gi"),
        (",tolerance_mm", f"{ROW},0", "target 'one': tolerance_mm: expected a tolerance above 0"),
        (",tolerance_m", f"{ROW},0.1", "expected a tolerance above 0 and at most 10 mm, got 0.1 m; is the unit"),
        (",approach1", f"{ROW},1", "target 'one': approach: expected 6 signs, one for each joint of arm left, got 1"),
        (",approach1", f"{ROW},2", "target 'one': approach1: expected -1, 0 or 1, got 2"),
        (PARTNER, f"{ROW},left,0,0,0", "left cannot be its own partner"),
        (PARTNER, f"{ROW},,0,0,0", "target 'one': partner_arm: missing"),
        (",partner_arm,partner_x_mm,partner_y_mm,partner_z_mm", f"{ROW},right,,,", "target 'one': partner_x_mm: missi"),
        (PARTNER, f"{ROW},right,0,0,0", "give the target a rotation"),
    ],
)
def test_a_row_that_is_refused(path: Path, more: str, row: str, says: str) -> None:
    assert says in refusal(path, HEADER + more, row)


def test_a_file_that_is_missing_or_no_text(path: Path) -> None:
    with pytest.raises(InputError, match="file not found; give a CSV file of targets"):
        load_targets(path, PROFILE)
    path.write_bytes(b"name,\xff\n")
    with pytest.raises(InputError, match="not UTF-8 text"):
        load_targets(path, PROFILE)


def test_a_yaml_file_gives_a_csv_file_work_frames_and_conditions(path: Path) -> None:
    path.write_text(f"{HEADER},frame\n{ROW},table\ntwo{ROW[3:]},\n")
    yaml = path.with_name("job.yaml")
    head = "schema: cellapp-targets\nversion: 1\ntargets: targets.csv\nconditions: {left: {payload: 2 kg}}\n"
    yaml.write_text(head + "frames:\n  table: {in: tracker, origin: [1, 2, 3], x: [2, 2, 3], xy: [1, 3, 3]}\n")
    one, two = load_targets(yaml, PROFILE)
    assert one.work_frame is not None
    assert one.work_frame.name == "table"
    assert two.work_frame is None
    assert one.conditions == two.conditions == WorkingConditions(payload=2.0)
    yaml.write_text(head)
    with pytest.raises(InputError, match=r"targets.csv:2: target 'one': no frame 'table'"):
        load_targets(yaml, PROFILE)
    yaml.write_text(head.replace("targets.csv", "targets.txt"))
    with pytest.raises(InputError, match=r"job.yaml:3: targets: expected a list, got 'targets.txt'"):
        load_targets(yaml, PROFILE)
