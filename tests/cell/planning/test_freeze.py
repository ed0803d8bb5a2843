"""Frozen stops: which are listed, what a new design leaves, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from cellapp.cell.planning.planned_stops import read_planned_stops
from cellapp.cell.run import RunFile
from cellapp.commands.plan.run import freeze_stops, new_planned_run, replan
from cellapp.ground.counting import listed_numbers
from cellapp.ground.errors import InputError
from tests.program import app
from tests.twin import small_twin

pytestmark = pytest.mark.fast


@given(st.sets(st.integers(0, 999), min_size=1))
def test_any_set_of_stops_can_be_listed(stops: set[int]) -> None:
    assert listed_numbers(",".join(map(str, stops)), "configurations") == tuple(sorted(stops))
    assert listed_numbers(f" {min(stops)}-{max(stops)} ", "configurations") == tuple(range(min(stops), max(stops) + 1))


@pytest.mark.parametrize("text", ["", "1,", "a", "-3", "1-2-3", "1.5", "99999999"])
def test_what_is_no_list_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="expected configurations such as 0-9,12, or none"):
        listed_numbers(text, "configurations")


def test_a_new_design_leaves_what_is_frozen(tmp_path: Path) -> None:
    with new_planned_run(small_twin(6, plan={"method": "random"}), tmp_path / "run") as run:
        before = read_planned_stops(run)
        assert freeze_stops(run, [1, 4]).notes == ("2 of 6 stops are frozen",)
        replan(run)
        after = read_planned_stops(run)
        assert np.array_equal(after.q["left"][after.frozen], before.q["left"][[1, 4]])
        with pytest.raises(InputError, match="there is no configuration 6; there are 0 to 5"):
            freeze_stops(run, [6])
        freeze_stops(run, [])
        assert not read_planned_stops(run).frozen.any()


def test_the_command_freezes(tmp_path: Path) -> None:
    new_planned_run(small_twin(4, plan={"method": "random"}), tmp_path / "run").close()
    ended = CliRunner().invoke(app, ["plan", "--run", str(tmp_path / "run"), "--freeze", "0-1,3"])
    assert ended.exit_code == 0, ended.output
    assert "3 of 4 stops are frozen" in ended.output
    with RunFile.open(tmp_path / "run") as run:
        assert read_planned_stops(run).frozen.tolist() == [True, True, False, True]
