"""Exchangeability of two arms of one type, each tested in a run of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.driving.iso9283 import reach
from cellapp.cell.run import RunFile
from cellapp.commands.iso9283 import run as verb
from cellapp.commands.iso9283.run import iso9283_run
from cellapp.commands.iso9283.view import iso9283_tables
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from tests.commands.test_iso9283 import asked, left_alone
from tests.twin import small_twin


def another_arm() -> Profile:
    """The cell of ``left_alone`` with an arm that differs from its published geometry otherwise."""
    profile = left_alone()
    assert profile.plant is not None
    return profile.model_copy(update={"plant": profile.plant.model_copy(update={"seed": profile.plant.seed + 1})})


def test_another_arm_is_compared_in_the_same_cube(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reach, "_SEEDS", 4)
    with RunFile.create(tmp_path / "first", left_alone()) as run:
        first = iso9283_run(run, asked(run, tests=["pose"], cycles=2)).arms["left"]
    with RunFile.create(tmp_path / "second", another_arm()) as run:
        result = iso9283_run(run, asked(run, tests=["pose"], cycles=2, with_run=tmp_path / "first"))
    second = result.arms["left"]
    assert first.cube is not None
    assert second.cube is not None
    for one, other in zip(first.cube.poses, second.cube.poses, strict=True):
        np.testing.assert_allclose(other.position_B, one.position_B, atol=1e-9)
        np.testing.assert_allclose(other.q, one.q, atol=0.01)  # the SMR sits elsewhere
    assert second.exchange is not None
    apart = [
        np.linalg.norm(np.subtract(one.error_mm, other.error_mm))
        for one, other in zip(first.tests["nominal"].pose, second.tests["nominal"].pose, strict=True)
    ]
    assert second.exchange.value.value_mm == pytest.approx(max(apart))
    assert second.exchange.value.value_mm > 0.2
    assert second.exchange.value.expanded_mm is not None
    (line,) = [one for one in result.coverage if one.clause == "7.7"]
    assert line.status == "in part"
    assert "two of the norm's five arms" in line.words
    assert any(table.title.startswith("Exchangeability E") for table in iso9283_tables(result))


def test_a_run_that_cannot_be_compared_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verb, "drive_tests", lambda *_, **__: pytest.fail("it moved"))
    RunFile.create(tmp_path / "empty", small_twin()).close()
    with RunFile.create(tmp_path / "run", left_alone()) as run:
        with pytest.raises(InputError, match="holds no test by ISO 9283"):
            iso9283_run(run, asked(run, with_run=tmp_path / "empty"))
        with pytest.raises(InputError, match="missing"):
            iso9283_run(run, asked(run, with_run=tmp_path / "missing"))
