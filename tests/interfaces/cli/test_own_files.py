"""Files as people have them: tables with repeats and neighbours, another arm's factory file, read as the user does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.profile import load_profile
from cellapp.cell.profile.controller_file import controller_file_text
from cellapp.cell.run import RunFile
from cellapp.robot.kinematics.chain import flange_poses, plain_geometry, smr_positions
from cellapp.robot.kinematics.inverse import solve_pose
from cellapp.robot.model.nominal import nominal_arm
from tests.arms import OFF_AXIS, UR5, UR10, Array, at_station, true_geometry
from tests.cell.programs.plain_controller import forward
from tests.interfaces.cli.conftest import exit_code, one_sentence


def write_table(path: Path, q: Array, p_M: Array) -> None:
    head = ",".join([*(f"q{j}_rad" for j in range(1, 7)), "x_m", "y_m", "z_m"])
    np.savetxt(path, np.column_stack([q, p_M]), delimiter=",", header=head, comments="", fmt="%.9f")


def points(q: Array) -> Array:
    """What a tracker without noise measures of an arm that left its table."""
    return smr_positions(true_geometry(at_station(UR5, OFF_AXIS), np.random.default_rng(1)), q)


def calibrated(call: Any, q: Array, p_M: Array) -> tuple[Any, Any, Any]:
    """What ``init`` ends with, and the results of ``import`` and ``calibrate``, of an own table."""
    write_table(Path("own.csv"), q, p_M)
    made = call("init", "cell", "--readings", "own.csv", "--arm", "UR5")
    imported = call("import", "cell/profiles/own.yaml", "cell/readings/own.csv", "--run", "run", "--json", "-")
    found = call("calibrate", "run", "--json", "-")
    return made, imported.json, found.json


def test_repeats_stay_on_one_side(call: Any) -> None:
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-2.0, 2.0, (60, 6)), 3, axis=0)
    its_own = np.repeat(rng.normal(0.0, 0.1e-3, (60, 3)), 3, axis=0)  # what no model of the joints predicts
    p_M = points(q) + its_own + rng.normal(0.0, 2e-6, q[:, :3].shape)
    q += rng.normal(0.0, 2e-5, q.shape)
    made, imported, found = calibrated(call, q, p_M)
    for said in (made.out, " ".join(imported["notes"])):
        assert "60 configurations and 120 repeats" in " ".join(said.split())
    arm = found["arms"]["robot"]
    assert arm["repeatability_mm"]["n"] == 180
    assert not arm["network"]["used"], "what is left is known at learnt configurations only"
    with RunFile.open(Path("run")) as run:
        sides = np.array(run.readings("robot").split).reshape(60, 3)
    assert (sides == sides[:, :1]).all()
    assert set(sides[:, 0]) == {"identify", "validate"}
    searched = call("discover", "run", "--json", "-").json["arms"]["robot"]
    assert searched["accepted"] == []
    assert searched["verdict"] == "nothing missing"
    assert "next: cellapp docs targets, then 'cellapp compensate run TARGETS'" in call("show", "run").out


def test_neighbours_are_held_out_together(call: Any) -> None:
    rng = np.random.default_rng(0)
    ends = rng.uniform(-1.5, 1.5, (6, 2, 6))
    along = np.linspace(0.0, 1.0, 60)[None, :, None]
    q = (ends[:, :1] + along * (ends[:, 1:] - ends[:, :1])).reshape(-1, 6)
    _, _, found = calibrated(call, q, points(q) + rng.normal(0.0, 2e-5, (len(q), 3)))
    notes = " ".join(found["notes"])
    assert "held out by whole neighbourhoods" in notes
    with RunFile.open(Path("run")) as run:
        held_out = np.array(run.readings("robot").split) == "validate"
    changes = np.count_nonzero(held_out[1:] != held_out[:-1])
    assert changes < 0.5 * np.count_nonzero(held_out), "rows of a line are held out in a row"


@pytest.mark.parametrize("first", [[0.3, -1.2, 1.6, -1.9, -1.5, 0.2], [-0.5, -1.4, 1.9, -1.3, 0.7, 1.2]])
def test_a_grid_at_one_orientation(first: list[float], call: Any) -> None:
    """Where the SMR is on the flange acts like a shift of the base then: what the readings carry is found and said."""
    rng, nominal, q = np.random.default_rng(0), at_station(UR5, OFF_AXIS), np.tile(first, (125, 1))
    steps = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 5)] * 3), axis=-1).reshape(-1, 3)
    wanted = smr_positions(nominal, q) + steps
    q = solve_pose(nominal, wanted, flange_poses(nominal, q)[0], q).q
    _, _, found = calibrated(call, q, points(q) + rng.normal(0.0, 2e-5, (125, 3)))
    notes = " ".join(found["notes"])
    assert "measure with the wrist turned to more sides" in notes
    assert "rest more on the prior than on the readings" in notes
    validate = found["arms"]["robot"]["validate"]
    assert validate["geometry"]["position_mm"]["rms"] < 0.045 < 0.06 < validate["nominal"]["position_mm"]["rms"]


def with_factory(path: Path, table: Array, share: float = 1.0) -> None:
    """Give the profile the calibration.conf of an arm with this published table, and a share of the arm's errors."""
    nominal = at_station(table, OFF_AXIS)
    off = true_geometry(nominal, np.random.default_rng(1)).vector() - nominal.vector()
    rows = plain_geometry(nominal.with_vector(nominal.vector() + share * off)).rows[:, :4]
    path.with_name("its.conf").write_text(controller_file_text((rows - table).tolist(), ""), "utf-8")
    text = path.read_text("utf-8").replace("type: arms/ur5.yaml", "type: arms/ur5.yaml\n    factory: its.conf")
    path.write_text(text, "utf-8")


def test_the_factory_file_of_another_arm(call: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (60, 6))
    write_table(Path("own.csv"), q, points(q))
    call("init", "--readings", "own.csv", "--arm", "ur5")
    profile, readings = Path("profiles/own.yaml"), "readings/own.csv"
    plain = profile.read_text("utf-8")
    with_factory(profile, UR10)  # of another type
    for words in (("doctor", profile), ("import", profile, readings, "--run", "run")):
        one_sentence(call(*words), "arms.robot.factory: not a calibration of a UR5", "it fits ur10")
    profile.write_text(plain, "utf-8")
    with_factory(profile, UR5, -1.0)  # of another arm of the type
    said = call("import", profile, readings, "--run", "run", "--json", "-").json["notes"]
    said += call("calibrate", "run", "--json", "-").json["notes"]
    assert sum("explains the points worse" in note for note in said) == 2
    Path("a.script").write_text("def a():\n  movej([0.1, -1.2, 1.0, 0.2, 0.3, 0.4])\nend\n", "utf-8")
    for line in ("compensate run a.script --out b.script", "export run --as dh --out c"):
        one_sentence(call(*line.split()), "explains the points worse", "nothing was written")
    profile.write_text(plain, "utf-8")
    with_factory(profile, UR5)  # its own
    said = call("import", profile, readings, "--run", "mine", "--json", "-").json["notes"]
    said += call("calibrate", "mine", "--json", "-").json["notes"]
    assert "explains the points worse" not in " ".join(said)
    assert exit_code(monkeypatch, "compensate", "mine", "a.script", "--out", "b.script") == 0
    rows = []
    for form, file in (("ur-calibration", "its.conf"), ("ur-description", "default_kinematics.yaml")):
        call("export", "mine", "--as", form, "--out", f"profiles/exported-{file}")
        profile.write_text(plain.replace("ur5.yaml", f"ur5.yaml\n    factory: exported-{file}"), "utf-8")
        rows.append(nominal_arm(load_profile(profile).arms["robot"]).rows)
    for own in rows:
        own[-1, 2:4] = 0.0  # behind the last joint: a description has its origin alone
    np.testing.assert_allclose(rows[1], rows[0], atol=2e-9)


def test_the_posture_is_the_one_that_was_measured(call: Any) -> None:
    taught = np.array([0.3, -1.2, 1.6, -1.0, 1.2, 0.2])
    T = forward(UR5, taught)
    pose = [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_rotvec().tolist()]
    Path("a.script").write_text(f"def a():\n  set_tcp(p[0,0,0,0,0,0])\n  movel(p{pose})\nend\n", "utf-8")
    rng = np.random.default_rng(0)
    for run, spread in (("narrow", 0.6), ("wide", 3.0)):
        q = taught + rng.uniform(-spread, spread, (60, 6))
        write_table(Path(f"{run}.csv"), q, points(q))
        call("init", "--readings", f"{run}.csv", "--arm", "ur5")
        call("import", f"profiles/{run}.yaml", f"readings/{run}.csv", "--run", run)
        call("calibrate", run)
    found = call("compensate", "narrow", "a.script", "--out", "b.script", "--json", "b.json")
    (target,) = json.loads(Path("b.json").read_text("utf-8"))["targets"]
    np.testing.assert_allclose(target["q_new"], taught, atol=0.02)
    assert target["nearest_to"] == "readings"
    assert "posture (17, -69, 92, -57, 69, 11) deg, the only one within the ranges" in " ".join(found.out.split())
    refused = call("compensate", "wide", "a.script", "--out", "c.script")
    assert (refused.code, Path("c.script").exists()) == (2, False)
    assert "2 postures reach it, (-141, -210, 80, -18, 93, 179), (17, -69, 92, -57, 69, 11) deg" in " ".join(
        refused.out.split()
    )


def test_sigma_is_the_targets_own_and_what_is_common_stands_once(call: Any) -> None:
    """An arm that is as published, measured with noise: its corrections are not significant."""
    rng = np.random.default_rng(0)
    q = np.array([0.3, -1.2, 1.6, -1.0, 1.2, 0.2]) + rng.uniform(-1.0, 1.0, (60, 6))
    p_M = smr_positions(at_station(UR5, OFF_AXIS), q) + rng.normal(0.0, 50e-6, (60, 3))
    calibrated(call, q, p_M)
    moves = "".join(f"  movej({one.tolist()})\n" for one in q[:2])
    Path("a.script").write_text(f"def a():\n{moves}end\n", "utf-8")
    said = call("compensate", "run", "a.script", "--out", "b.script").out
    assert "sigma is not stated: only a discovery estimates" in " ".join(said.split())
    assert "discover: takes some" in call("discover", "run").err
    one_sentence(call("show", "run", "verification"), "no verification is stored; these arms have no device")
    said = call("compensate", "run", "a.script", "--out", "c.script", "--json", "c.json").out
    assert "2 targets are left as taught" in " ".join(said.split())
    taught = Path("a.script").read_text("utf-8")
    assert taught in Path("c.script").read_text("utf-8")
    found = json.loads(Path("c.json").read_text("utf-8"))
    (common,) = found["common"]
    assert common["flange_mm"][2] > 1.0, "a single SMR does not tell how far the flange is from it"
    for target in found["targets"]:
        assert target["own_mm"] < 0.1 < 0.5 < target["uncertainty_mm"]
    call("compensate", "run", "a.script", "--out", "d.script", "--insignificant")
    assert taught not in Path("d.script").read_text("utf-8")
