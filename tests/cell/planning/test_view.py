"""The map of what the tracker sees: counts that add up, the worst constraint, changes that help; text and charts."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.planning.records import ViewResult
from cellapp.cell.planning.view import arm_view, view_workspace
from cellapp.cell.safety.cell_bodies import cell_bodies
from cellapp.commands.plan.charts import SHADES, view_chart, view_charts
from cellapp.commands.plan.check_view import AS_IT_IS, arm_sentences, view_sentences, view_tables, worst_constraint
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.progress import Cancelled, CancelToken, Progress
from tests.interfaces.cli.test_cli import exit_code
from tests.twin import PROFILES, small_twin, with_arms


@pytest.fixture(scope="module", autouse=True)
def few_draws():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cellapp.cell.planning.view._BATCHES", 10)
        patch.setattr("cellapp.cell.planning.view._CHANGE_BATCHES", 3)
        yield


@pytest.fixture(scope="module")
def view() -> ViewResult:
    return view_workspace(small_twin())


def with_tracker_at(profile: Profile, *position: float, elevation: tuple[float, float] = (-0.96, 0.96)) -> Profile:
    assert profile.tracker.pose is not None
    pose = profile.tracker.pose.model_copy(update={"position": position})
    tracker = profile.tracker.model_copy(update={"pose": pose, "elevation": elevation})
    return profile.model_copy(update={"tracker": tracker})


def test_the_counts_add_up(view: ViewResult) -> None:
    assert list(view.arms) == ["left", "right"]
    for arm in view.arms.values():
        assert sum(arm.lost.values()) + arm.share == pytest.approx(1.0)
        assert sum(cube.seen for cube in arm.cells) == arm.seen > arm.small_incidence > 0.4 * arm.seen
        assert all(0 <= cube.seen <= cube.reachable for cube in arm.cells)
        assert sum(cube.reachable for cube in arm.cells) < arm.drawn, "cubes below the floor are left out"
        assert 0.1 <= arm.edge_m <= 0.4
        assert min(cube.centre_C[2] for cube in arm.cells) > -0.2
        assert arm.facing_at_random == pytest.approx(0.5 * (1.0 - math.cos(math.radians(27.0))))
    assert ViewResult.from_json(view.to_json(), "view") == view


def test_the_workspace_is_where_the_arm_is(view: ViewResult) -> None:
    for name, arm in view.arms.items():
        base = small_twin().arms[name].base
        assert base is not None
        centres, weights = np.array([cube.centre_C for cube in arm.cells]), [cube.reachable for cube in arm.cells]
        middle = np.average(centres[:, :2], axis=0, weights=weights)
        np.testing.assert_allclose(middle, base.position[:2], atol=0.5 * arm.edge_m)
        assert np.linalg.norm(centres - base.position, axis=1).max() < 1.6 + arm.edge_m


def test_it_is_the_same_each_time_and_can_be_cancelled(view: ViewResult) -> None:
    heard: list[Progress] = []
    assert view_workspace(small_twin(), heard.append) == view
    assert (heard[-1].done, heard[-1].total) == (2, 2)
    token = CancelToken()
    token.cancel()
    with pytest.raises(Cancelled):
        view_workspace(small_twin(), cancel=token)


def test_one_arm_without_a_tracker_is_told() -> None:
    cell = cell_bodies(small_twin())
    object.__setattr__(cell, "field", None)
    with pytest.raises(InputError, match=r"no tracker .* give tracker\.pose"):
        arm_view(cell, small_twin(), "left", CancelToken())


def test_in_a_good_cell_the_mounting_is_not_to_blame(view: ViewResult) -> None:
    sentences = " ".join(view_sentences(view))
    assert "so its mounting is not to blame" in sentences
    assert "changes that were tried (tracker moved, SMR turned) gains a tenth" in sentences
    for arm in view.arms.values():
        worst = worst_constraint(arm)
        assert worst is not None
        assert worst.constraint in {"own bodies", "floor"}


def test_a_tracker_that_stands_too_high_is_told_to_come_down() -> None:
    high = with_tracker_at(small_twin(), 3.0, 0.0, 3.0, elevation=(-0.6, 0.96))
    view = view_workspace(high)
    for name, arm in view.arms.items():
        worst = worst_constraint(arm)
        assert worst is not None
        assert worst.constraint == "elevation"
        assert "allowed are -34.38 to 55 deg" in worst.extent
        assert arm.changes[0].change in {"the tracker 0.5 m lower", "the tracker 1 m farther away"}
        now = next(one.seen for one in arm.changes if one.change == AS_IT_IS)
        assert arm.changes[0].seen > 1.1 * now
        assert "raise or lower the tracker" in " ".join(arm_sentences(name, arm))


def test_an_smr_that_looks_at_its_own_arm_is_told_to_be_turned() -> None:
    smr = small_twin().arms["left"].smr.model_copy(update={"normal": (0.0, 0.0, -1.0)})
    view = view_workspace(with_arms(small_twin(), smr=smr))
    for arm in view.arms.values():
        assert "looking along" in arm.changes[0].change


def test_tables_name_every_constraint_and_every_height(view: ViewResult) -> None:
    tables = view_tables(view)
    assert len(tables) == 4
    names = [row[0] for row in tables[0].text_rows()]
    assert names == ["range", "elevation", "facing", "floor", "ceiling", "own arm in the beam", "own bodies", "seen"]
    lost = [float(row[1]) for row in tables[0].text_rows()]
    assert sum(lost) == pytest.approx(100.0, abs=0.05)
    left = view.arms["left"]
    assert sum(int(row[1]) for row in tables[1].text_rows()) == len(left.cells)
    assert sum(int(row[2]) for row in tables[1].text_rows()) == sum(cube.seen > 0 for cube in left.cells)


def test_charts_shade_columns_and_directions(view: ViewResult) -> None:
    charts = view_charts(small_twin(), view)
    assert [chart.equal for chart in charts] == [True, False, True, False]
    for chart, name in zip(charts, ("left", "left", "right", "right"), strict=True):
        assert name in chart.message
        shaded = [one for one in chart.series if one.mark in SHADES]
        assert {one.mark for one in shaded} >= {"░", "█"}
    above = charts[0]
    cells = view.arms["left"].cells
    columns = {cube.centre_C[:2] for cube in cells}
    assert sum(len(one.x) for one in above.series if one.mark in SHADES) == len(columns)
    assert {one.name for one in above.series} >= {"base", "tracker"}
    blind = {cube.centre_C[:2] for cube in cells if cube.seen}
    (dark,) = [one for one in above.series if one.mark == SHADES[0]]
    assert len(dark.x) == len(columns) - len(blind)


def test_a_chart_without_places_says_so(view: ViewResult) -> None:
    profile = small_twin()
    profile = profile.model_copy(update={"tracker": profile.tracker.model_copy(update={"pose": None})})
    chart = view_chart(profile, view, "left")
    assert chart.is_empty
    assert "does not say where base and tracker are" in chart.message


def test_the_command_prints_and_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "view.json"
    with pytest.MonkeyPatch.context() as patch:
        code = exit_code(patch, "plan", PROFILES / "twin.yaml", "--view", "--json", out)
    said = capsys.readouterr().out
    assert code == 0
    assert "Arm left: the tracker can measure" in said
    assert "Arm right: workspace in cubes of" in said
    assert json.loads(out.read_text("utf-8"))["schema"] == "cellapp-view"
    assert list(tmp_path.iterdir()) == [out], "nothing else is stored"
