"""Conditions of planned stops: damaged ones are named."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellapp.cell.planning.planned_stops import STOP_CONDITIONS_RESULT, read_stop_conditions
from cellapp.cell.run import RunFile
from cellapp.ground.errors import InputError
from tests.twin import small_twin


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[]", "damaged"),
        ('{"1": {"left": {"via": [0, 1]}}}', "6 finite joint positions"),
        ('{"1": {"left": {"dwell_s": 1e9}}}', "between 0 and 600 s"),
        ('{"1": {"middle": {}}}', "middle"),
        ('{"one": {}}', "damaged"),
    ],
)
def test_damaged_conditions_are_named(tmp_path: Path, text: str, says: str) -> None:
    with RunFile.create(tmp_path / "run", small_twin(2)) as run:
        run.write_result(STOP_CONDITIONS_RESULT, text)
        with pytest.raises(InputError, match=says):
            read_stop_conditions(run)
