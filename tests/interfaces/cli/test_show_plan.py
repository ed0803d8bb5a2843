"""``show DIR plan --check``, ``--forecast`` and ``doctor --cell``: what the screens Cell and Plan show, in batch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import new_planned_run
from tests.interfaces.cli.test_cli import exit_code
from tests.twin import PROFILES, small_twin, write_profile


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.MonkeyPatch.context() as patch:
        code = exit_code(patch, *arguments)
    said = capsys.readouterr()
    return code, said.out, said.err


def read_json(path: Path) -> Any:
    return json.loads(path.read_text("utf-8"))


def test_a_plan_is_checked_and_foreseen_in_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    new_planned_run(small_twin(12, plan={"method": "random"}), tmp_path / "run").close()
    before = (tmp_path / "run" / "run.sqlite").read_bytes()
    out = tmp_path / "out.json"
    code, said, _ = called(capsys, "show", tmp_path / "run", "plan", "--check", "--json", out)
    assert (code, read_json(out)["schema"]) == (0, "cellapp-plan-check")
    assert "Safe: 12 stops and 13 ways" in said
    code, said, _ = called(capsys, "show", tmp_path / "run", "plan", "--forecast", "--json", out, "--force")
    assert code == 0
    assert read_json(out)["schema"] == "cellapp-plan-forecast"
    assert set(read_json(out)["arms"]) == {"left", "right"}
    assert "effects that the plan can show" in said
    assert "Collecting takes about" in said
    assert (tmp_path / "run" / "run.sqlite").read_bytes() == before


def test_a_plan_that_is_refused_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    down = np.array([[0.0, 0.6, 0.0, -1.5, 0.0, 0.0]])  # bent down into the floor
    with RunFile.create(tmp_path / "run", small_twin(1), lambda run: run.write_plan({"left": down, "right": down})):
        pass
    out = tmp_path / "out.json"
    code, said, complaint = called(capsys, "show", tmp_path / "run", "plan", "--check", "--json", out)
    assert code == 1
    assert "stop 1: arm left: collides with the floor" in said
    assert "Not safe" in complaint
    assert read_json(out)["refused"]


def test_bad_use_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    RunFile.create(tmp_path / "imported", small_twin()).close()
    for arguments, words in (
        (("overview", "--check"), "belong to 'plan'"),
        (("plan", "--check", "--forecast"), "give one of them"),
        (("plan", "--check"), "the run has no plan"),
        (("plan", "--forecast"), "the run has no plan"),
    ):
        code, _, complaint = called(capsys, "show", tmp_path / "imported", *arguments)
        assert code == 2
        assert words in complaint


def test_the_doctor_says_what_the_profile_describes(capsys: pytest.CaptureFixture[str]) -> None:
    code, said, _ = called(capsys, "doctor", PROFILES / "twin.yaml", "--cell")
    assert code == 0
    for words in ("UR10, 6 joints", "clearance", "elevation -55 to 55 deg"):
        assert words in " ".join(said.split())


def test_a_plan_is_edited_in_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile, run, file, out = (
        write_profile(tmp_path / "p"),
        tmp_path / "run",
        tmp_path / "plan.csv",
        tmp_path / "o.json",
    )
    profile.write_text(profile.read_text("utf-8").replace("  stops: 30", "  stops: 6"), "utf-8")
    code, said, _ = called(capsys, "plan", profile, "--run", run, "--json", out)
    assert (code, read_json(out)["stops"]) == (0, {"left": 6, "right": 6})
    assert "Collecting takes about" in said
    assert called(capsys, "export", run, "--plan", file)[:2] == (0, f"plan written to {file}\n")
    assert called(capsys, "plan", profile, "--check", file, "--json", out, "--force")[0] == 0
    assert (read_json(out)["schema"], read_json(out)["file"]) == ("cellapp-plan-check", str(file))
    assert called(capsys, "plan", profile, "--from", file, "--run", tmp_path / "same")[0] == 0
    called(capsys, "export", tmp_path / "same", "--plan", tmp_path / "same.csv")
    assert (tmp_path / "same.csv").read_bytes() == file.read_bytes()
    rows = [line for line in file.read_text("utf-8").splitlines() if line.startswith(("configuration", "0,", "1,"))]
    file.write_text("\n".join(rows), "utf-8")
    code, said, _ = called(capsys, "plan", profile, "--keep", file, "--run", tmp_path / "kept")
    assert (code, "arm right: 6 stops planned" in said) == (0, True)


def test_a_plan_is_extended_and_planned_again_in_batch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stops are drawn here: what a new design keeps is tested with the verbs."""
    run = tmp_path / "run"
    new_planned_run(small_twin(6, plan={"method": "random"}), run).close()
    code, said, _ = called(capsys, "plan", "--run", run, "--add", 2)
    assert (code, "arm left: 8 stops planned" in said) == (0, True)
    code, said, _ = called(capsys, "plan", "--run", run, "--replan", "--json", "-")
    assert (code, json.loads(said)["stops"]) == (0, {"left": 8, "right": 8})


def test_an_edited_plan_with_offences_ends_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, profile = tmp_path / "plan.csv", PROFILES / "twin.yaml"
    columns = "configuration,arm,point,q1,q2,q3,q4,q5,q6"
    file.write_text(f"{columns}\n5,left,stop,0,0.6,0,-1.5,0,0\n5,right,stop,0,-1.5,0,0,0,0\n", "utf-8")
    out = tmp_path / "out.json"
    code, said, complaint = called(capsys, "plan", profile, "--check", file, "--json", out)
    assert (code, "Not safe" in complaint) == (1, True)
    assert f"{file}:2: configuration 5: arm left: collides with the floor" in said
    assert read_json(out)["refused"][0]["line"] == 2
    code, _, complaint = called(capsys, "plan", profile, "--from", file, "--run", tmp_path / "run")
    assert (code, "nothing was written" in complaint) == (1, True)
    assert not (tmp_path / "run").exists()
    file.write_text(f"{columns}\n5,left,stop,0,x,0,0,0,0\n", "utf-8")
    code, _, complaint = called(capsys, "plan", profile, "--check", file)
    assert (code, f"{file}:2: q2: expected a finite number" in complaint) == (2, True)


def test_arguments_of_plan_that_do_not_belong_together_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile, run, file = PROFILES / "twin.yaml", tmp_path / "run", tmp_path / "plan.csv"
    for arguments, words in (
        ((), "PROFILE is missing"),
        ((profile,), "--run DIR is missing"),
        (("--run", run), "PROFILE is missing"),
        ((profile, "--from", file), "--run DIR is missing"),
        ((profile, "--run", run, "--from", file, "--keep", file), "--from and --keep do not go together"),
        (("--run", run, "--add", 3, "--replan"), "--add and --replan do not go together"),
        ((profile, "--run", run, "--add", 3), "give --run DIR and no PROFILE"),
        (("--replan",), "give --run DIR and no PROFILE"),
        ((profile, "--run", run, "--check", file), "leave out --run"),
        ((profile, "--run", run, "--view"), "leave out --run"),
        ((profile, "--view", "--replan"), "do not go together"),
        ((profile, "--check", file), "file not found"),
        ((profile, "--run", run, "--from", file), "file not found"),
        (("--run", run, "--add", 3), "run folder not found"),
        (("--run", run, "--add", 0), "equal to 1"),
    ):
        code, _, complaint = called(capsys, "plan", *arguments)
        said = " ".join(complaint.replace("│", " ").split())  # a usage error stands in a box
        assert (code, words in said) == (2, True), (arguments, complaint)
    assert not run.exists()
