"""What commands say can be done as it stands: printed commands, near words, units, suffixes."""

from __future__ import annotations

import ast
import json
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cellapp
import drivers
from cellapp.cell.programs.solving import controller_chain, flange_of
from cellapp.cell.run import RunFile
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.ground.shell import filled
from cellapp.robot.kinematics.transforms import zyx_angles
from tests.approved import assert_refused
from tests.handbook.workspace import not_understood
from tests.interfaces.cli.conftest import one_sentence
from tests.twin import PROFILES


@pytest.fixture
def folder(call: Any, finished_run: Path) -> Path:
    return Path(shutil.copytree(finished_run, Path("my cell") / "a $run"))


def test_printed_commands_run_in_folders_with_blanks(call: Any, folder: Path) -> None:
    """From views, tables and messages, each on one line."""
    said = [call("show", folder, part) for part in ("overview", "certificate", "check", "paths", "iso9283", "location")]
    said.append(call("plan", PROFILES / "twin.yaml", "--run", folder))
    lines = [line for one in said for line in (one.out + one.err).splitlines() if "docs" not in line]
    printed = [command for line in lines for command in re.findall(r"cellapp (?!:)[a-z].*?(?=' |'$|'\)|$)", line)]
    for command in (one.replace("\\$", "$") for one in printed):
        assert str(folder) in shlex.split(command), command
        assert not_understood(command.replace(str(folder), "x"), whole=True) == "", command
    assert {command.split()[1] for command in printed} >= {"certificate", "check", "compensate", "iso9283", "show"}


def quoted(node: ast.AST) -> Iterator[str]:
    """The commands that a text of the program quotes; what it puts in is one word, in quotes as of a file."""
    text = getattr(node, "value", None)
    if isinstance(node, ast.JoinedStr):
        text = "".join(str(one.value) if isinstance(one, ast.Constant) else '"my cell/x"' for one in node.values)
    if isinstance(text, str):
        yield from re.findall(r"'cellapp ([a-z][^']*)'", text)


def test_every_command_that_is_printed_can_be_typed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In a folder with a blank; words for the files of a call, as DIR, give way to these."""
    monkeypatch.chdir(tmp_path)
    run = Path("my cell")
    files = {"DIR": run, "PROFILE": run / "profiles" / "a.yaml", "TARGETS": run / "targets.csv"}
    found = dict[str, str]()
    for path in [*Path(cellapp.__file__).parent.rglob("*.py"), *Path(drivers.__file__).parent.rglob("*.py")]:
        if "'cellapp " not in (text := path.read_text("utf-8")):
            continue
        tree = ast.parse(text)
        docstrings = {id(one.value) for one in ast.walk(tree) if isinstance(one, ast.Expr)}
        for node in ast.walk(tree):
            if id(node) not in docstrings:
                found |= {command: f"{path.name}:{getattr(node, 'lineno', 0)}" for command in quoted(node)}
    assert len(found) > 60
    for command, place in found.items():
        typed = filled(f"'cellapp {command}'", files).strip("'")
        assert not {"DIR", "PROFILE", "TARGETS"} & {*shlex.split(typed)}, place
        assert not_understood(typed, whole=True) == "", f"{place}: {typed}"


def test_a_message_names_the_files_of_its_call(call: Any) -> None:
    call("init", "my cell", "--twin")
    profile = Path("my cell/profiles/twin.yaml")
    text = profile.read_text("utf-8").replace("type: arms/ur10.yaml", "type: arms/ur10.yaml\n    factory: none.conf", 1)
    profile.write_text(text, "utf-8")
    one_sentence(call("doctor", profile), f"'cellapp doctor \"{profile}\" --controllers FOLDER'")


def test_what_cannot_be_is_refused_with_what_can_as_approved(call: Any, folder: Path) -> None:
    shutil.copy(PROFILES / "paths" / "twin.yaml", "paths.yaml")

    def refused(*words: str) -> str:
        ended = call(*[str(folder) if word == "FOLDER" else word for word in words])
        assert ended.code == 2
        return re.sub(r"Topics are .*", "Topics are ...", " ".join(ended.err.split()))

    assert "foo" in refused("show", "FOLDER", "log", "--level", "foo")
    assert_refused(Path(__file__).parent / "approved" / "refused.txt", refused)


def test_on_a_terminal_results_end_within_a_screen(call: Any, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    shown = call("certificate", folder).out.splitlines()
    assert 20 < len(shown) <= 40
    assert shown[-1].startswith("More is stored: 'cellapp show")


def test_parameters_are_those_in_force_with_their_shares_of_what_is_merged(call: Any, folder: Path) -> None:
    call("export", folder, "--as", "parameters", "--out", "p.csv", "--arm", "left")
    text = Path("p.csv").read_text("utf-8")
    assert "joint_compliance." in text
    exported = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    off = {row[0]: float(row[3]) - float(row[2]) for row in exported[1:]}
    arm = call("show", folder, "parameters", "--json", "-").json["arms"]["left"]
    assert len(arm["identified"]) > 20
    for name, one in arm["identified"].items():
        merged = sum(its.get(name, 0.0) * off[key] for key, its in arm["merged"].items())
        assert one["value"] - one["nominal"] == pytest.approx(off[name] + merged, abs=1e-9)
    assert arm["identified"]["theta0"]["standard_error"] < 1e-4  # of the sum with theta1, not of either


def test_commands_that_are_typed_as_targets_are_not_corrected_again(call: Any, folder: Path) -> None:
    """With the digits of a pendant, as poses and as joints of a program, whatever its name; not targets as taught."""
    given = call("show", folder, "targets", "--json", "-").json["targets"][0]
    with RunFile.open(folder) as run:
        chain = controller_chain(model_of(run, stage_in_force(run, read_stages(run))).arms[given["arm"]])
    tool = run.profile.arms[given["arm"]].smr.offset
    T = flange_of(chain, np.array([given["q_compensated"]]))[0]
    typed = np.round(T[:3, :3] @ tool + T[:3, 3], 5), np.round(zyx_angles(T[:3, :3])[::-1], 4)
    head = "schema: cellapp-targets\nversion: 1\ntargets:\n"
    for name, (position, rpy) in {"taught": (given["position"], given["rpy"]), "typed": typed}.items():
        row = {"name": "a", "arm": given["arm"], "position": list(map(float, position)), "rpy": list(map(float, rpy))}
        Path(f"{name}.yaml").write_text(f"{head}  - {json.dumps(row)}\n", "utf-8")
    shown = np.radians(np.degrees(given["q_compensated"]).round(2)).tolist()
    for name, q in {"a.script": given["q_compensated"], "shown": shown}.items():
        Path(name).write_text(f"def p():\n  movej({q}, a=1, v=1)\nend\n", "utf-8")
    twice = "stands where a command that this run computed for an earlier target does"
    one_sentence(call("compensate", folder, "typed.yaml"), "target 'a'", twice)
    for name in ("a.script", "shown"):
        again = call("compensate", folder, name, "--out", "b.script", "--arm", given["arm"])
        one_sentence(again, f"{name}:2", twice)
    assert call("compensate", folder, "taught.yaml").code == 0
