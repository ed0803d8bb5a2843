"""The commands and examples on the page about certificates, as they stand there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import NoReturn

import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

import cellapp
from cellapp.cell.driving.iso9283.tests import IsoTask
from cellapp.cell.exports.formats import all_formats
from cellapp.cell.targets.targets import load_targets
from cellapp.commands.compensate.words import PART_WORDS, advice
from cellapp.commands.docs.handbook import chapter_text
from cellapp.commands.iso9283 import run as verb
from cellapp.commands.registry import records
from cellapp.commands.schema import json_schema, results_by_name, written_results
from cellapp.estimation.iso9283.norm import ISO_TESTS
from cellapp.ground.errors import HardwareError
from cellapp.interfaces.tui.screens import SCREENS
from tests.handbook.chapters import blocks
from tests.handbook.screen_pictures import write_screens
from tests.program import app
from tests.twin import PROFILES, small_twin

COMMANDS = "".join(blocks("certificate", "sh")).splitlines()
EXAMPLE = blocks("certificate", "yaml")[0]


def ran(*arguments: str) -> tuple[int, str, dict[str, object]]:
    """Exit code, what was printed, and the JSON, which fits its schema."""
    Path("result.json").unlink(missing_ok=True)
    ended = CliRunner().invoke(app, [*arguments, "--json", "result.json"])
    found: dict[str, object] = {}
    if Path("result.json").is_file():
        found = json.loads(Path("result.json").read_text("utf-8"))
        jsonschema.validate(found, json_schema(results_by_name(written_results(records()))[str(found["schema"])]))
    return (
        (1 if ended.exception and not isinstance(ended.exception, SystemExit) else ended.exit_code),
        ended.output,
        found,
    )


@pytest.mark.slow
def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    Path("acceptance.yaml").write_text(EXAMPLE, "utf-8")
    assert len(COMMANDS) >= 2
    for command in COMMANDS:
        program, *arguments = shlex.split(command)
        code, printed, found = ran(*arguments)
        assert (program, code) == ("cellapp", 0), f"{command}: {printed}"
        assert found
    issued = json.loads(Path("issued/certificate.json").read_text("utf-8"))
    assert issued["location"] == "Hall 3"
    assert issued["missing"] == []

    path = Path("logs/my-run/certificate.json")
    path.write_text(path.read_text("utf-8").replace("not verified", "verified"), "utf-8")
    assert ran("show", "logs/my-run", "certificate")[2]["number"] == issued["number"]
    code, printed, _ = ran("certificate", "logs/my-run", "--out", "strict", "--strict")
    assert code == 1, "the twin is simulated"
    assert "OUT OF DATE: certificate.json is not a certificate that the run stores" in ran("show", "logs/my-run")[1]
    assert ran("show", "logs/my-run", "--strict")[0] == 1


# -- The file on the page about paths, as it stands there --------------------------------------------------------------


def test_the_file_of_the_page_is_compensated(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    (file,) = blocks("paths", "yaml")
    Path("seam.yaml").write_text(file, encoding="utf-8")
    for command in "".join(blocks("paths", "sh")).splitlines():
        words = shlex.split(command.replace("profiles/paths/twin.yaml", "seam.yaml"))[1:]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
    assert len(Path("q.csv").read_text("utf-8").splitlines()) > 500
    assert Path("q.script").read_text("utf-8").count("  servoj(") > 500


# -- What the chapter about Python says that mistakes are answered with. ``test_commands`` runs its examples -----------


def test_mistakes_are_answered_as_the_chapter_says(finished_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example, printed) = re.findall(r"^```(?:python|text)\n(.*?)^```", chapter_text("python"), re.M | re.S)[-2:]
    run = cellapp.open_run(finished_run)
    names = {"cellapp": cellapp, "cell": cellapp.Cell(run.profile), "run": run, "left": run.readings("left"), "np": np}
    exec(compile(example, "python.md", "exec"), names)
    numbers = re.compile(r"-?\d+\.\d+")  # of another run
    assert numbers.sub("*", capsys.readouterr().out) == numbers.sub("*", printed)


# -- Pictures of the terminal application's screens: all are drawn from a finished run -----------------

TWIN = PROFILES / "twin.yaml"


@pytest.mark.slow
def test_every_screen_is_drawn(finished_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "new"
    write_screens(TWIN, finished_run, out)
    paths = [out / f"screen-{step}.svg" for step in ("first-run", *(entry.step for entry in SCREENS))]
    texts = {path.stem: path.read_text("utf-8").replace("&#160;", " ") for path in paths}
    assert not any("@font-face" in text or len(text) > 150_000 for text in texts.values())
    assert "Try the simulated twin" in texts["screen-first-run"]
    assert "COMPLETE, " in texts["screen-collect"]
    assert "held-out errors [mm]" in texts["screen-calibrate"]


# -- The lists and the words on the page about targets -----------------------------------------------------------------

PAGE = chapter_text("targets")


def test_the_lists_are_lists_of_targets(tmp_path: Path) -> None:
    profile = small_twin()
    for language in ("yaml", "csv"):
        path = tmp_path / f"list.{language}"
        path.write_text(blocks("targets", language)[0], encoding="utf-8")
        assert load_targets(path, profile)


def test_the_page_has_every_part_of_an_uncertainty_and_the_advice_that_is_printed() -> None:
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE, re.M))
    assert set(PART_WORDS.values()) <= set(rows)
    for reason in ("out of reach", "singular: joints work against each other there"):
        assert rows[reason] == advice(reason)
    (limits,) = [reason for reason in rows if reason.startswith("beyond limits")]
    assert rows[limits] == advice(limits)


# -- The page about exports describes every format ---------------------------------------------------------------------


def test_the_page_describes_every_format() -> None:
    described = re.findall(r"^\| `([a-z-]+)` \|", chapter_text("exports"), re.M)
    assert described == list(all_formats())


# -- The commands in the chapter on ISO 9283 are understood as they stand there ----------------------------------------

COMMANDS_OF_ISO9283_PAGE = "".join(blocks("iso9283", "sh")).splitlines()


@pytest.mark.slow
def test_the_commands_ask_for_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks: list[IsoTask] = []

    def drive(task: IsoTask, *_: object, **__: object) -> NoReturn:
        tasks.append(task)
        raise HardwareError("this cell stays where it is")

    monkeypatch.setattr(verb, "drive_tests", drive)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(PROFILES, "profiles")
    shutil.copytree(finished_run, "logs/my-run")
    for command in COMMANDS_OF_ISO9283_PAGE:
        ended = CliRunner().invoke(app, shlex.split(command)[1:])
        assert "stays where it is" in str(ended.exception), command
    asked = [(task.tests, task.cycles, task.arms, task.commands) for task in tasks]
    both = ("left", "right")
    assert asked == [
        (ISO_TESTS, 30, both, ("nominal", "calibrated")),
        (("pose",), 5, ("right",), ("calibrated",)),
        (("drift",), 30, both, ("nominal",)),
        (ISO_TESTS, 30, both, ("nominal", "calibrated")),
    ]
    assert tasks[2].drift_s == 480.0 * 60.0
    assert tasks[2].model is None
    assert tasks[3].also_speeds == (0.5, 0.1)
