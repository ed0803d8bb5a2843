"""The commands and the examples on the page about targets, as they stand there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cellapp.cli.app import app
from cellapp.compensation.targets import load_targets
from cellapp.docs.handbook import chapter_text
from cellapp.reporting.target_words import PART_WORDS, advice
from tests.twin import small_twin

PAGE = chapter_text("targets")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)


def test_the_commands_do_what_the_page_says(
    finished_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(finished_run, "logs/my-run")
    Path("holes.yaml").write_text(blocks("yaml")[0], encoding="utf-8")
    commands = [line for block in blocks("sh") for line in block.splitlines()]
    assert len(commands) == 8
    schemas = []
    for command in commands:
        program, *arguments = shlex.split(command)
        ended = CliRunner().invoke(app, [*arguments, "--json", "result.json"])
        found = json.loads(Path("result.json").read_text("utf-8"))
        out = any(target.get("verdict") == "out" for target in found.get("targets", ()))
        assert (program, ended.exit_code) == ("cellapp", 1 if "push" in command and out else 0), ended.exception
        schemas.append(found["schema"])
    assert schemas == [*["cellapp-compensate"] * 3, *["cellapp-verify"] * 2, *["cellapp-locate"] * 3]


@pytest.mark.fast
def test_the_lists_are_lists_of_targets(tmp_path: Path) -> None:
    profile = small_twin()
    for language in ("yaml", "csv"):
        path = tmp_path / f"list.{language}"
        path.write_text(blocks(language)[0], encoding="utf-8")
        assert load_targets(path, profile)


@pytest.mark.fast
def test_the_page_has_every_part_of_an_uncertainty_and_the_advice_that_is_printed() -> None:
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", PAGE, re.M))
    assert set(PART_WORDS.values()) <= set(rows)
    for reason in ("out of reach", "singular: joints work against each other there"):
        assert rows[reason] == advice(reason)
    (limits,) = [reason for reason in rows if reason.startswith("beyond limits")]
    assert rows[limits] == advice(limits)
