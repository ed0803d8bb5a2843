"""The program, called in this process as a user types it, and how a refusal reads."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from cellapp.interfaces import cli


class Ended:
    """How a command ended."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> dict[str, Any]:
        """What stands on standard output, which must be one strict JSON object and nothing else."""
        found = json.loads(self.out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
        assert isinstance(found, dict)
        assert isinstance(found["schema"], str)
        assert found["version"] in (1, 2)
        return found


def exit_code(patch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the program in this process; return its exit code."""
    patch.setattr(sys, "argv", ["cellapp", *map(str, arguments)])
    try:
        cli.main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Any:
    """Run the program in this process, in a folder of its own."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments: object) -> Ended:
        capsys.readouterr()
        code = exit_code(monkeypatch, *arguments)
        captured = capsys.readouterr()
        assert "Traceback" not in captured.out + captured.err
        assert not Path("cellapp-error.log").exists(), Path("cellapp-error.log").read_text()
        return Ended(code, captured.out, captured.err)

    return called


def one_sentence(ended: Ended, *says: str, code: int = 2) -> None:
    assert ended.code == code, ended.err
    assert ended.out == ""
    lines = [line for line in ended.err.splitlines() if line]
    if code == 3:  # a fault of hardware can be reported
        assert re.match(r"cellapp: to report this: 'cellapp doctor \S+yaml --bundle FILE.zip' packs ", lines.pop())
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("cellapp: ")
    for text in says:
        assert text in lines[0]
