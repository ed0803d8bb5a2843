"""Targets as CSV: columns with their units, and what is refused by line, target and column."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.targets.targets import Partner, Target, WorkingConditions, load_targets
from cellapp.ground.errors import InputError
from cellapp.robot.kinematics.transforms import rotation_zyx
from tests.approved import assert_refused
from tests.sure import sure
from tests.twin import small_twin

PROFILE = small_twin()
HEADER = "name,arm,x_mm,y_mm,z_mm"
ROW = "one,left,-400,250.5,1000"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "targets.csv"


def loaded(path: Path, *lines: str) -> tuple[Target, ...]:
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    return load_targets(path, PROFILE)


def test_a_byte_order_mark_quotes_spaces_and_blank_rows(path: Path) -> None:
    path = path.with_name("targets.txt")  # the content tells a table, not its name
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
        np.testing.assert_allclose(rotation_zyx(*sure(target.rpy)[::-1]), rotation.as_matrix(), rtol=0.0, atol=1e-14)
    assert targets[2].rpy is None


def test_headers_and_rows_that_are_refused(path: Path) -> None:
    assert_refused(Path(__file__).parent / "approved" / "refused-csv.txt", partial(loaded, path), path.parent)


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
    assert sure(one.work_frame).name == "table"
    assert two.work_frame is None
    assert one.conditions == two.conditions == WorkingConditions(payload=2.0)
    yaml.write_text(head)
    with pytest.raises(InputError, match=r"targets.csv:2: target 'one'.frame: no frame 'table'"):
        load_targets(yaml, PROFILE)
    yaml.write_text(head.replace("targets.csv", "targets.txt"))
    with pytest.raises(InputError, match=r"job.yaml:3: targets: expected a list, got 'targets.txt'"):
        load_targets(yaml, PROFILE)
