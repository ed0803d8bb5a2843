"""``collect --again``: what rests on old readings is out of date, the run stands as it did, bad lists are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.run import RunFile
from cellapp.cell.run.measured_again import replace_stop
from cellapp.commands.collect.state import collection_state
from cellapp.commands.collect.view import collection_tables
from cellapp.commands.next_step import arm_states, next_step
from cellapp.commands.stages import basis_of, counted_basis, read_stages
from cellapp.estimation.readings import Reading
from cellapp.interfaces.cli import main
from tests.cell.run.small_runs import collected_run

pytestmark = pytest.mark.fast


def measure_again(run: RunFile, stop: int) -> None:
    """As the session does it."""
    session = run.begin_session(str(stop + 1))
    rows = {
        name: Reading(q=np.full(len(arm.type.joints), float(stop)), p_M=np.ones(3), time_s=9.0)
        for name, arm in run.profile.arms.items()
    }
    replace_stop(run, stop, rows)
    run.end_session(session, "complete", "")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    return RunFile.open(collected_run(tmp_path / "run", "accurate enough"), write=True)


@pytest.mark.parametrize("basis_now", [basis_of, counted_basis])
def test_what_rests_on_readings_that_were_replaced_is_out_of_date(run: RunFile, basis_now: object) -> None:
    run.append_stage("calibrate", basis_of(run).model_dump_json(), "{}", None)
    assert read_stages(run, basis_now).out_of_date == {}  # type: ignore[arg-type]
    measure_again(run, 1)
    found = read_stages(run, basis_now).out_of_date  # type: ignore[arg-type]
    assert found == {"calibrate": "2 readings were measured again since"}


def test_a_run_that_was_accurate_enough_stays_so(run: RunFile) -> None:
    before = next_step(run, read_stages(run), arm_states(run))
    measure_again(run, 1)
    assert next_step(run, read_stages(run), arm_states(run)) == before
    state = collection_state(run)
    assert state is not None
    assert state.last is not None
    assert (state.last.outcome, state.sessions[-1].again) == ("accurate enough", "2")


def test_the_readings_before_are_listed_beside_the_sessions(run: RunFile) -> None:
    measure_again(run, 1)
    measure_again(run, 1)
    state = collection_state(run)
    assert state is not None
    titles = {table.title: table for table in collection_tables(state)}
    replaced = titles["Stops measured again: the readings before, which are kept and not used"]
    assert [row[:2] for row in replaced.rows] == [(2, "left"), (2, "left"), (2, "right"), (2, "right")]
    sessions = titles["Sessions of collecting"]
    assert [row[3] for row in sessions.rows] == ["accurate enough", *["complete, stops 2 again"] * 2]
    assert {(one.stop, one.again) for one in state.stops} == {(0, 0), (1, 2)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--again", "a"], "'a': expected stops such as 0-9,12, or none"),
        (["--again", "none"], "no stop is named to be measured again"),
        (["--again", "0"], "there is no stop 0; there are 1 to 4"),
        (["--again", "3"], "stop 3 was not measured yet"),
        (["--again", "1", "--resume"], "--again and --resume do not go together"),
    ],
)
def test_a_list_that_cannot_be_measured_is_refused(
    run: RunFile, options: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run.close()
    monkeypatch.setattr("sys.argv", ["cellapp", "collect", str(run.folder), *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
