"""Commands for other programs: read back, the model puts the SMR at the targets; what must not be written is not."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import dropwhile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.exports.arm_export import ExportResult
from cellapp.cell.exports.command_table import urscript
from cellapp.cell.exports.export_format import ArmCommands, CommandFormat, ExportedCommand
from cellapp.cell.exports.formats import export_lines, formats_of
from cellapp.cell.profile import load_profile
from cellapp.cell.programs.script_targets import read_script
from cellapp.cell.run import RunFile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.cell.targets.goals import goals_of_arm
from cellapp.cell.targets.records import TargetCommand
from cellapp.cell.targets.targets import Target, load_targets
from cellapp.commands.compensate.run import compensate_run
from cellapp.commands.export.request import ExportRequest
from cellapp.commands.export.run import export_commands
from cellapp.commands.stages import CALIBRATION_FILE, read_stages
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY
from cellapp.robot.effects import MeasurementConditions
from cellapp.robot.model import CellModel
from tests.sure import sure
from tests.twin import PROFILES
from tests.verbs import correct_run, export_as_run, push_run

COMMAND_FORMATS = formats_of(CommandFormat)

Array = NDArray[np.float64]
BAR_M = 1e-6
UNREACHABLE = "far\naway"


@pytest.fixture
def compensated(finished_copy: Path) -> tuple[Path, tuple[Target, ...]]:
    """A run with commands for the twin's targets and one that no arm reaches."""
    with RunFile.open(finished_copy, write=True) as run:
        targets = load_targets(PROFILES / "targets" / "twin.yaml", run.profile)
        far = targets[0].model_copy(update={"name": UNREACHABLE, "position": (4.0, 0.0, 0.5)})
        compensate_run(run, [*targets, far])
    return finished_copy, (*targets, far)


def rows_of(path: Path) -> list[dict[str, str]]:
    lines = dropwhile(lambda line: line.startswith("#"), path.read_text("utf-8").splitlines(keepends=True))
    return list(csv.DictReader(lines))


def positions(row: dict[str, str], prefix: str) -> Array:
    return np.array([float(row[f"{prefix}{joint}"]) for joint in range(1, 7)])


def signs(row: dict[str, str]) -> list[float]:
    return [float(sign) for sign in row["approach"].split()] or [0.0] * 6


def off_m(model: CellModel, targets: Sequence[Target], name: str, q: Array, approach: Array) -> float:
    """Largest distance [m] of the SMR from the targets of an arm by the model, from the sides ``approach``."""
    wanted = goals_of_arm(model, targets, name).position_M
    reached = model.arms[name].predict(q, MeasurementConditions(approach=approach))
    return float(np.linalg.norm(reached - wanted, axis=1).max())


def test_the_table_brings_the_model_to_the_targets(
    compensated: tuple[Path, tuple[Target, ...]], tmp_path: Path
) -> None:
    folder, targets = compensated
    with RunFile.open(folder) as run:
        result = export_as_run(run, "commands", tmp_path / "commands.csv")
    assert ExportResult.from_json(result.to_json(), "test") == result
    model = CellModel.load(folder / CALIBRATION_FILE)
    for name, file in sure(result.commands).items():
        rows = rows_of(Path(file.file))
        assert [row["name"] for row in rows] == [target.name for target in targets if target.arm == name]
        assert {row["arm"] for row in rows} == {name}
        driven = [row for row in rows if row["q1"]]
        assert file.commands == len(driven)
        assert file.refused == len(rows) - len(driven)
        assert all(bool(row["refusal"]) != bool(row["q1"]) for row in rows)
        there = [target for target in targets if target.name in {row["name"] for row in driven}]
        sides = np.array([signs(row) for row in driven])
        assert sides.any() == (name == "right"), "its play alone makes a side matter"
        q = np.array([positions(row, "q") for row in driven])
        assert off_m(model, there, name, q, sides) < BAR_M, "a row's command is for the side that the row says"
        for row in driven:
            said = "any side of approach" if name == "left" else f"joints that arrive with the signs {row['approach']}"
            assert row["holds_for"] == f"{said}; payload 0.3 kg"
        nominal = np.array([positions(row, "nominal_q") for row in driven])
        assert off_m(model, there, name, nominal, sides) > 1e-4
    assert sure(result.commands)["left"].refused == 1
    assert any("1 left out" in line for line in export_lines(result))


def test_driven_from_the_side_of_its_row_the_real_arm_meets_the_target(
    compensated: tuple[Path, tuple[Target, ...]], tmp_path: Path
) -> None:
    """By the simulated cell itself, which shares no code with the model, at the side that the row says and at others.

    As computed for the middle of the play the commands of the right arm missed by as much as half of it.
    """
    folder, targets = compensated
    with RunFile.open(folder) as run:
        export_as_run(run, "commands", tmp_path / "c.csv", "right")
        plant = build_plant(run.profile)
    rows = [row for row in rows_of(tmp_path / "c.csv") if row["q1"]]
    model = CellModel.load(folder / CALIBRATION_FILE)
    wanted = goals_of_arm(model, [one for one in targets if one.name in {row["name"] for row in rows}], "right")
    q, sides = (np.array([read(row) for row in rows]) for read in (lambda row: positions(row, "q"), signs))
    missed = {
        way: np.linalg.norm(plant.smr_positions("right", q, approach=way * sides) - wanted.position_M, axis=1) * 1e3
        for way in (1.0, 0.0, -1.0)
    }
    within = np.array([float(row["within_mm"]) for row in rows])
    assert np.mean(missed[1.0] > within) <= 0.1
    assert np.mean(missed[1.0]) < 0.4 * np.mean(missed[0.0]), "the middle of the play is not what a row is for"
    assert np.mean(missed[0.0]) < 0.7 * np.mean(missed[-1.0])


def test_the_program_brings_the_model_to_the_targets(
    compensated: tuple[Path, tuple[Target, ...]], tmp_path: Path
) -> None:
    """The right arm has play: its program's positions are for joints that come from home."""
    folder, targets = compensated
    with RunFile.open(folder) as run:
        result = export_as_run(run, "urscript", tmp_path / "to.script")
        homes = home_positions(run.profile)
    model = CellModel.load(folder / CALIBRATION_FILE)
    for name, file in sure(result.commands).items():
        text = Path(file.file).read_bytes()
        motions = [np.array(one.numbers) for one in read_script(text, "to.script").targets]
        assert all(np.allclose(q, homes[name], atol=1e-8) for q in motions[::2]), "home between, and at both ends"
        q = np.array(motions[1::2])
        names = [line.removeprefix("  # target ") for line in text.decode().splitlines() if "# target " in line]
        left_out = [one.partition(": left out: ")[0] for one in names if ": left out: " in one]
        own = [target for target in targets if target.arm == name]
        there = [target for target in own if target.name.replace("\n", " ") not in left_out]
        assert names == [one for one in names if one in [target.name for target in there] or ": left out: " in one]
        assert len(q) == len(there) == file.commands >= 15
        assert file.refused == len(left_out) == len(own) - len(there)
        assert off_m(model, there, name, q, np.sign(q - homes[name])) < BAR_M
        assert "with all other arms at home" in text.decode()
    left = Path(sure(result.commands)["left"].file).read_text("utf-8")
    assert "# target far away: left out: out of reach" in left
    assert all("a=" in line and "v=0.209" in line for line in left.splitlines() if "movej" in line)


@pytest.mark.parametrize(("form", "suffix"), [("urscript", ".script"), ("commands", ".csv")])
def test_what_was_compensated_is_not_corrected_again(
    finished_copy: Path, tmp_path: Path, form: str, suffix: str
) -> None:
    """Corrected twice, it would be off by the correction."""
    with RunFile.open(finished_copy, write=True) as run:
        compensate_run(run, load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[:3])
        exported = sure(export_as_run(run, form, tmp_path / f"to{suffix}").commands)
        written = [Path(one.file) for one in exported.values()]
        again = partial(correct_run, run, written[0], tmp_path / "again.script", "left")
        with pytest.raises(InputError, match=r"corrected copy|they are corrected"):
            again() if form == "urscript" else load_targets(written[0], run.profile)


def test_what_verification_drove_last_is_written(finished_copy: Path, tmp_path: Path) -> None:
    with RunFile.open(finished_copy, write=True) as run:
        verified = push_run(run, load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[20:23], verify=True)
        result = export_as_run(run, "commands", tmp_path / "last.csv", None, "verify")
        before = export_as_run(run, "commands", tmp_path / "computed.csv")
        for name, file in sure(result.commands).items():
            last, computed = (rows_of(Path(one.file)) for one in (file, sure(before.commands)[name]))
            assert [row["name"] for row in last] == [row["name"] for row in computed]
            driven = {one.name: one for one in verified.targets if one.arm == name}
            for row, first in zip(last, computed, strict=True):
                one = driven[row["name"]]
                assert one.q is not None
                np.testing.assert_array_equal(positions(row, "q"), sure(one.q_driven))
                np.testing.assert_allclose(sure(one.q_driven), one.q, atol=1e-4, err_msg="what the joints then read")
                assert signs(row) == [float(sign) for sign in one.approach or ()]
                assert "as driven by push" in row["holds_for"]
                assert np.abs(positions(row, "q") - positions(first, "q")).max() < 1e-3
        targets = load_targets(PROFILES / "targets" / "twin.yaml", run.profile)[4:5]
        compensate_run(run, targets)
        with pytest.raises(InputError, match="other targets were compensated since; nothing was written"):
            export_as_run(run, "commands", tmp_path / "never.csv", None, "verify")
    assert not list(tmp_path.glob("never*"))


@pytest.mark.parametrize("form", COMMAND_FORMATS)
def test_bad_input_is_refused_and_nothing_is_written(finished_copy: Path, tmp_path: Path, form: str) -> None:
    out = tmp_path / "new.txt"
    with RunFile.open(finished_copy, write=True) as run:
        with pytest.raises(InputError, match="arm 'third' has no commands of 'compensate'; arms with commands are"):
            export_as_run(run, form, out, "third")
        with pytest.raises(InputError, match="commands are those of the stage compensate or verify, not 'discover'"):
            export_as_run(run, form, out, None, "discover")
        with pytest.raises(InputError, match="is a folder; give the path of a file"):
            export_as_run(run, form, tmp_path, "left")
        (tmp_path / "file").write_text("", encoding="utf-8")
        with pytest.raises(InputError, match="cannot be"):
            export_as_run(run, form, tmp_path / "file" / "new.txt", "left")
        words = list(run.readings("left").split or ())
        run.assign_splits("left", [*words[1:], words[0]])
        with pytest.raises(InputError, match=r"'compensate' is out of date .*nothing was written\. Run 'cellapp comp"):
            export_as_run(run, form, out)
    assert not out.exists()


@pytest.mark.parametrize("form", COMMAND_FORMATS)
def test_a_run_without_commands(finished_copy: Path, tmp_path: Path, form: str) -> None:
    with RunFile.open(finished_copy) as run:
        found = read_stages(run)
        out = tmp_path / "new.txt"
        asked = ExportRequest(folder=run.folder, form=form, out=out)
        bare = replace(found, current={name: one for name, one in found.current.items() if name != "compensate"})
        with pytest.raises(
            InputError, match=r"has no commands of 'compensate'; nothing was written\. Run 'cellapp comp"
        ):
            export_commands(run, bare, COMMAND_FORMATS[form], out, asked, NEW_ONLY)


def commands_of(joints: int, *commands: ExportedCommand) -> ArmCommands:
    profile = load_profile(PROFILES / "twin.yaml")
    return ArmCommands("left", profile.arms["left"], "a test", np.zeros(joints), 0.1, 0.5, commands)


def refused(name: str, reason: str) -> ExportedCommand:
    record = TargetCommand(name=name, arm="left", refusal=reason, q_nominal=None, q_compensated=None)
    return ExportedCommand(record, (), reason)


def test_a_program_is_for_six_joints_and_needs_a_target() -> None:
    with pytest.raises(InputError, match=r"has 7 joints, a program for UR controllers six.*Take --as commands"):
        urscript(commands_of(7, refused("a", "out of reach")), [])
    with pytest.raises(InputError, match=r"none of its targets can be driven from home.*Target 'a': out of reach"):
        urscript(commands_of(6, refused("a", "out of reach")), [])


def test_a_side_of_approach_is_driven_and_names_stay_comments() -> None:
    record = refused("x\nend\nstopj(1)", "").record
    way = (np.full(6, 0.1), np.full(6, 0.2))
    text = urscript(commands_of(6, ExportedCommand(record, way, "")), ["from\nhere"])
    read = read_script(text.encode(), "x.script")
    assert [one.numbers[0] for one in read.targets] == [0.0, 0.1, 0.2, 0.0]
    assert [line for line in text.splitlines() if "stopj" in line] == [
        "  # side from which target x end stopj(1) is approached",
        "  # target x end stopj(1)",
    ]
