"""The trial of starts: it counts failures, says why, and ends with exit code 1."""

from __future__ import annotations

from contextlib import nullcontext

import pytest
from typer.testing import CliRunner

from tests.trials import starts

pytestmark = pytest.mark.fast


@pytest.mark.parametrize(("failures", "code"), [([{}, {}], 0), ([{}, {"left": "LinkLost: exit code 1: a trace"}], 1)])
def test_a_start_that_fails_is_said_and_fails_the_command(
    failures: list[dict[str, str]], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(starts, "emulated_cell", nullcontext)
    monkeypatch.setattr(starts, "failures_of_one_start", lambda: failures.pop(0))
    ended = CliRunner().invoke(starts.app, ["--n", "2"])
    assert ended.exit_code == code
    said = ended.output
    assert ("start 2, arm left: LinkLost: exit code 1: a trace" in said) == bool(code)
    assert f"2 starts of 2 arms, {code} failed" in said
