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
from tests.approved import assert_refused
from tests.cell.planning.planned_cells import same_stops, some_stops
from tests.twin import altered, small_twin, with_arm, with_arms

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


def with_cell(lines: list[str], line: int, column: str, text: str) -> list[str]:
    """The lines with one cell replaced; they count from 1."""
    cells = lines[line - 1].split(",")
    cells[lines[0].split(",").index(column)] = text
    return [*lines[: line - 1], ",".join(cells), *lines[line:]]


def without(column: str) -> Edit:
    def edit(lines: list[str]) -> list[str]:
        place = lines[0].split(",").index(column)
        return [",".join(cells[:place] + cells[place + 1 :]) for cells in (line.split(",") for line in lines)]

    return edit


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (without("q3"), ":1: q3: the column is missing"),
        (without("point"), ":1: point: the column is missing"),
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


def test_wrong_cells_are_named_as_approved(tmp_path: Path) -> None:
    """Lines of the text name a line of the file, a column, and what stands there instead."""
    path = tmp_path / "plan.csv"
    lines = written(path)

    def refused(line: str, column: str, text: str) -> object:
        path.write_text("\n".join(with_cell(lines, int(line), column, text)), "utf-8")
        return read_plan_csv(path, PROFILE)

    assert_refused(Path(__file__).parent / "approved" / "wrong-cells.txt", refused, tmp_path)


def test_arms_of_different_joints_share_a_file(tmp_path: Path) -> None:
    stops = some_stops(2)
    short = replace(
        stops,
        q={"left": stops.q["left"], "right": stops.q["right"][:, :4]},
        approach_from={"left": stops.approach_from["left"], "right": stops.approach_from["right"][:, :4]},
        legs=((), ()),
    )
    right = PROFILE.arms["right"]
    four = altered(right, limits=((-6.0, 6.0),) * 4, type={"joints": right.type.joints[:4]})
    profile = PROFILE.model_copy(update={"arms": {**PROFILE.arms, "right": four}})
    path = tmp_path / "plan.csv"
    write_plan_csv(short, path)
    same_stops(read_plan_csv(path, profile).stops, short)
    path.write_text("\n".join(with_cell(path.read_text().splitlines(), 4, "q5", "1")))
    with pytest.raises(InputError, match=":4: q5: there is a value, but arm right has 4 joints"):
        read_plan_csv(path, profile)


def test_a_load_that_the_profile_has_not_is_named_by_line(tmp_path: Path) -> None:
    write_plan_csv(some_stops(5, loads=True), tmp_path / "plan.csv", RENEWED)
    with pytest.raises(InputError, match=r":\d+: load: there is no load 1; with arms\.NAME\.payloads there"):
        read_plan_csv(tmp_path / "plan.csv", PROFILE)
