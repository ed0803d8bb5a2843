"""Touches of a socket on the other arm's flange: by the command and by a file, with bad inputs named by row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from cellapp.cell.driving.touching import both_reader
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, import_csv
from cellapp.cell.run.flange_touches import FLANGE_TOUCHES_RESULT, FlangeTouch, flange_touches_of, read_flange_touches
from cellapp.cell.run.touches import store_touch
from cellapp.commands.basis import basis_of, counted_basis
from cellapp.estimation.calibration.pair_calibration import calibrate_pair
from cellapp.estimation.readings import FlangeTouches, Reading, Readings
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.interfaces.cli.app import app
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.cell.run.csv_rows import Rows, written
from tests.twin import PROFILES

pytestmark = pytest.mark.fast
TWIN = PROFILES / "twin.yaml"


@pytest.fixture(scope="module")
def profile() -> Profile:
    return load_profile(TWIN)


@pytest.fixture(scope="module")
def touches(profile: Profile) -> list[FlangeTouch]:
    read = both_reader(profile, "left")
    return [FlangeTouch("left", name, *read(name, k)) for k in range(10) for name in ("cup", "edge")]


@pytest.fixture(scope="module")
def readings(profile: Profile) -> dict[str, Readings]:
    """Two touches of a socket that stands still, of each arm."""
    led = Reading(q=np.full(6, 0.1), p_M=np.full(3, np.nan), approach=np.zeros(6, np.int8), point="floor")
    return {name: led.as_readings(0) for name in profile.arms}


@pytest.fixture
def rows(touches: list[FlangeTouch]) -> Rows:
    return [
        {
            "arm": one.arm,
            "socket": one.socket,
            **{f"q{j}": repr(value) for j, value in enumerate(one.q.tolist(), start=1)},
            **{f"other_q{j}": repr(value) for j, value in enumerate(one.other_q.tolist(), start=1)},
        }
        for one in touches
    ]


def test_a_file_is_read_as_it_was_written(
    profile: Profile, readings: dict[str, Readings], rows: Rows, touches: list[FlangeTouch], tmp_path: Path
) -> None:
    found = read_flange_touches(written(tmp_path / "flange.csv", rows), profile, readings)
    assert [one.socket for one in found] == [one.socket for one in touches]
    np.testing.assert_array_equal([one.other_q for one in found], [one.other_q for one in touches])


def _swap(rows: Rows) -> None:
    rows[6]["socket"], rows[9]["socket"] = rows[9]["socket"], rows[6]["socket"]


def _degrees(rows: Rows) -> None:
    rows[2]["other_q2"] = "-85.0"


def _other_arm(rows: Rows) -> None:
    rows[3]["arm"] = "middle"


def _no_number(rows: Rows) -> None:
    rows[4]["q1"] = "nan"


def _no_socket(rows: Rows) -> None:
    rows[5]["socket"] = " "


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_swap, r"(?s)row 8: .*'edge' is [0-9]+ mm from where the other touches have it.*row 11.*'cup' is"),
        (_degrees, "row 4.*other_q2: expected radians .*are these degrees"),
        (_other_arm, "row 5.*no arm 'middle'; arms are left, right"),
        (_no_number, "row 6.*q1: expected radians"),
        (_no_socket, "row 7.*socket: is empty"),
    ],
)
def test_a_wrong_row_is_named(
    profile: Profile,
    readings: dict[str, Readings],
    rows: Rows,
    tmp_path: Path,
    spoil: Callable[[Rows], None],
    words: str,
) -> None:
    spoil(rows)
    with pytest.raises(InputError, match=words.replace("row ", "csv:")):
        read_flange_touches(written(tmp_path / "flange.csv", rows), profile, readings)


def test_only_two_arms_in_sockets_are_tied(
    rows: Rows, profile: Profile, readings: dict[str, Readings], tmp_path: Path
) -> None:
    alone = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    path = written(tmp_path / "flange.csv", rows)
    with pytest.raises(InputError, match="are of two arms with as many joints; the profile has left with 6"):
        read_flange_touches(path, alone, {})
    floor = tmp_path / "floor.csv"
    floor.write_text(
        "configuration,arm,q1,q2,q3,q4,q5,q6,x_m,y_m,z_m\n0,left,0,0,0,0,0,0,1,1,1\n0,right,0,0,0,0,0,0,1,1,1\n"
    )
    with import_csv(profile, floor, tmp_path / "tracker") as run:
        both = {name: run.readings(name) for name in profile.arms}
    for its in (both, {"left": readings["left"]}):  # the other one may be recorded in motion
        with pytest.raises(InputError, match="no reading names a point"):
            read_flange_touches(path, profile, its)


def test_both_reasons_are_said_where_neither_tie_can_be_made(
    touches: list[FlangeTouch], readings: dict[str, Readings], profile: Profile
) -> None:
    cup = [one for one in touches if one.socket == "cup"][:2]
    few = FlangeTouches(("cup",) * 2, np.array([one.q for one in cup]), np.array([one.other_q for one in cup]))
    apart = {"left": replace(readings["left"], on_flange=few), "right": replace(readings["right"], point=("ceiling",))}
    chains = {name: nominal_arm(arm) for name, arm in profile.arms.items()}
    arms = {
        name: SimpleNamespace(
            model=ArmModel(chain, chain, bodies_of(profile.arms[name]), np.array([0.0, 0.0, 1.0])),
            tracker_frame_network=None,
        )
        for name, chain in chains.items()
    }
    tied, notes = calibrate_pair(profile, apart, arms)
    assert tied is None
    assert notes[0].startswith("pair: skipped, 0 sockets were touched by both arms")
    assert notes[1].startswith("pair: 2 touches of sockets on a flange leave a direction open")


@pytest.mark.slow
def test_touches_are_recorded_by_the_command_and_change_what_a_calibration_rests_on(
    profile: Profile, readings: dict[str, Readings], tmp_path: Path
) -> None:
    folder = tmp_path / "run"

    def touch(*options: str, typed: str = "") -> Result:
        words = ["touch", str(TWIN), "--run", str(folder), "--arm", "left", "--on-flange", *options]
        return CliRunner().invoke(app, words, input=typed)

    def stored() -> list[str]:
        with RunFile.open(folder) as run:
            return [one.socket for one in flange_touches_of(run.read_result(FLANGE_TOUCHES_RESULT))]

    floor = Reading(q=np.full(6, 0.1), p_M=np.full(3, np.nan), approach=np.zeros(6, np.int8), point="floor")
    store_touch(folder, profile, "left", floor)
    assert "arm right has not touched sockets that stand still" in str(touch("--point", "cup").exception)
    store_touch(folder, profile, "right", floor)
    with RunFile.open(folder) as run:
        before = basis_of(run)
    found = touch(typed="cup\n\nundo\n\nend\n")
    assert found.exit_code == 0
    assert "recorded: 2 touches of 'cup' on arm right" in found.output
    assert stored() == ["cup", "cup"]
    with RunFile.open(folder) as run:
        assert not counted_basis(run).readings["left"].is_same(before.readings["left"])
        assert basis_of(run).readings["left"].is_same(counted_basis(run).readings["left"])
        assert basis_of(run).readings["right"] == before.readings["right"]
    assert "taken back" in touch("--undo").output
    assert stored() == ["cup"]
    touch("--undo")
    assert "there is no touch on arm right to take back" in str(touch("--undo").exception)
