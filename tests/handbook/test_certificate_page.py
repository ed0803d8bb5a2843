"""The commands and examples on the page about certificates, as they stand there."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import jsonschema
import pytest
from typer.testing import CliRunner

from cellapp.commands.registry import records
from cellapp.commands.schema import json_schema, results_by_name, written_results
from tests.handbook.chapters import blocks
from tests.program import app

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
