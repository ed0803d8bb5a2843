"""What the chapter about Python says that mistakes are answered with. ``test_commands`` runs its examples."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import cellapp
from cellapp.commands.docs.handbook import chapter_text


def test_mistakes_are_answered_as_the_chapter_says(finished_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example, printed) = re.findall(r"^```(?:python|text)\n(.*?)^```", chapter_text("python"), re.M | re.S)[-2:]
    run = cellapp.open_run(finished_run)
    names = {"cellapp": cellapp, "cell": cellapp.Cell(run.profile), "run": run, "left": run.readings("left"), "np": np}
    exec(compile(example, "python.md", "exec"), names)
    numbers = re.compile(r"-?\d+\.\d+")  # of another run
    assert numbers.sub("*", capsys.readouterr().out) == numbers.sub("*", printed)
