"""A plan as CSV: the same plan comes back bit for bit; what is wrong in a file is named by line and column."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from cellapp.cell.planning.plan_csv import read_plan_csv, write_plan_csv
from cellapp.cell.planning.planned_stops import straight_stops
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.profile.schema import Payload
from tests.cell.planning.planned_cells import same_stops, some_stops
from tests.twin import small_twin, with_arm, with_arms

PROFILE = with_arms(small_twin(4), limits=((-6.0, 6.0),) * 6)


def written(path: Path) -> list[str]:
    """The lines of a file with four stops."""
    write_plan_csv(some_stops(4), path, RENEWED)
    return path.read_text("utf-8").splitlines()


def test_a_plan_comes_back_bit_for_bit(tmp_path: Path) -> None:
    profile = with_arm(PROFILE, "left", payloads=(Payload(mass=5.0), Payload(mass=2.0)))
    for stops in (some_stops(9), some_stops(9, loads=True), straight_stops(some_stops(3).q)):
        write_plan_csv(stops, tmp_path / "plan.csv", RENEWED)
        back = read_plan_csv(tmp_path / "plan.csv", profile)
        same_stops(back.stops, stops)
        assert back.configurations == tuple(range(len(stops)))
        write_plan_csv(back.stops, tmp_path / "again.csv", RENEWED)
        assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "plan.csv").read_bytes()


Edit = Callable[[list[str]], list[str]]


def cell(line: int, column: str, text: str) -> Edit:
    """Replace one cell; lines count from 1."""

    def edit(lines: list[str]) -> list[str]:
        cells = lines[line - 1].split(",")
        cells[lines[0].split(",").index(column)] = text
        return [*lines[: line - 1], ",".join(cells), *lines[line:]]

    return edit


def without(column: str) -> Edit:
    def edit(lines: list[str]) -> list[str]:
        place = lines[0].split(",").index(column)
        return [",".join(cells[:place] + cells[place + 1 :]) for cells in (line.split(",") for line in lines)]

    return edit


def at(point: str, arm: str = "left", configuration: int = 0) -> int:
    """The line of a row in the file of ``written``."""
    rows = {
        0: ["leg1 left", "leg1 right", "leg2 right", "approach right", "stop left", "stop right"],
        1: ["approach left", "approach right", "stop left", "stop right"],
    }
    return 2 + (6 if configuration else 0) + rows[configuration].index(f"{point} {arm}")


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (without("q3"), ":1: q3: the column is missing"),
        (without("point"), ":1: point: the column is missing"),
        (cell(1, "dwell_s", "dwel_s"), ":1: dwel_s: the column is unknown; is 'dwell_s' meant?"),
        (cell(1, "q2", "q1"), ":1: q1: the column is there twice"),
        (cell(5, "q4", "half"), ":5: q4: expected a finite number such as 0.25, got 'half'"),
        (cell(5, "q4", "nan"), ":5: q4: expected a finite number such as 0.25, got 'nan'"),
        (cell(5, "q4", "inf"), ":5: q4: expected a finite number"),
        (cell(5, "q4", ""), ":5: q4: the value is missing"),
        (cell(5, "q4", "6.1"), ":5: q4: 6.1 rad is outside the limits -6 to 6 rad of arm right"),
        (cell(3, "q1", "-1e9"), ":3: q1: -1e\\+09 rad is outside the limits"),
        (cell(6, "arm", "middle"), ":6: arm: arm 'middle' is not in the profile; arms are left, right"),
        (cell(6, "arm", ""), ":6: arm: the value is missing"),
        (cell(6, "configuration", "0.5"), ":6: configuration: expected a whole number from 0, got '0.5'"),
        (cell(6, "configuration", "-1"), ":6: configuration: expected a whole number from 0, got '-1'"),
        (cell(6, "configuration", ""), ":6: configuration: the value is missing"),
        (cell(6, "point", "via"), ":6: point: expected leg1, leg2, ..., approach or stop, got 'via'"),
        (cell(at("leg2", "right"), "point", "leg3"), ":2: point: configuration 0 has no leg2"),
        (cell(at("stop"), "dwell_s", "601"), ":6: dwell_s: expected 0 to 600 s, got 601"),
        (cell(at("stop"), "dwell_s", "-1"), ":6: dwell_s: expected 0 to 600 s"),
        (cell(at("leg1"), "dwell_s", "1"), ":2: dwell_s: there is a value, but it belongs to the row 'stop'"),
        (cell(at("stop"), "frozen", "maybe"), ":6: frozen: expected yes or no, got 'maybe'"),
        (cell(at("stop"), "frozen", "yes"), ":2: frozen: the arms of configuration 0 have different values"),
        (cell(at("stop"), "block", "one"), ":6: block: expected a whole number from 0, got 'one'"),
        (cell(at("stop"), "block", "5"), ":2: block: the arms of configuration 0 have different values"),
        (cell(at("stop"), "repeat_of", "9"), ":2: repeat_of: configuration 0 repeats 9, which is no other"),
        (cell(at("stop"), "repeat_of", "0"), ":2: repeat_of: configuration 0 repeats 0, which is no other"),
        (lambda lines: lines[:6] + lines[7:], ":2: arm: configuration 0 has no row 'stop' of arm right"),
        (lambda lines: [*lines, lines[5]], "configuration: 0 of arm left has a row 'stop' in line 6 already"),
        (lambda lines: [*lines[:3], lines[3] + ",1", *lines[4:]], ":4: column 14: the row has 14 cells, the header"),
        (lambda lines: lines[:1], "there is a header row but no stop"),
        (lambda lines: [], "is empty"),
        (lambda lines: [line.replace(",", ";") for line in lines], "separate columns by commas"),
    ],
)
def test_what_is_wrong_is_named_by_line_and_column(edit: Edit, says: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text("\n".join(edit(written(path))), "utf-8")
    with pytest.raises(InputError, match=f"plan.csv.*{says}"):
        read_plan_csv(path, PROFILE)


def test_arms_of_different_joints_share_a_file(tmp_path: Path) -> None:
    stops = some_stops(2)
    short = replace(
        stops,
        q={"left": stops.q["left"], "right": stops.q["right"][:, :4]},
        approach_from={"left": stops.approach_from["left"], "right": stops.approach_from["right"][:, :4]},
        legs=((), ()),
    )
    right = PROFILE.arms["right"]
    kind = right.type.model_copy(update={"joints": right.type.joints[:4]})
    four = right.model_copy(update={"limits": ((-6.0, 6.0),) * 4, "type": kind})
    profile = PROFILE.model_copy(update={"arms": {**PROFILE.arms, "right": four}})
    path = tmp_path / "plan.csv"
    write_plan_csv(short, path)
    same_stops(read_plan_csv(path, profile).stops, short)
    path.write_text("\n".join(cell(4, "q5", "1")(path.read_text().splitlines())))
    with pytest.raises(InputError, match=":4: q5: there is a value, but arm right has 4 joints"):
        read_plan_csv(path, profile)


def test_a_load_that_the_profile_has_not_is_named_by_line(tmp_path: Path) -> None:
    write_plan_csv(some_stops(5, loads=True), tmp_path / "plan.csv", RENEWED)
    with pytest.raises(InputError, match=r":\d+: load: there is no load 1; with arms\.NAME\.payloads there"):
        read_plan_csv(tmp_path / "plan.csv", PROFILE)
