"""Work frames, rotations, conditions and partners in YAML: what is read, refused, written again and typed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.targets.goals import work_frame_pose
from cellapp.cell.targets.targets import (
    FramePoint,
    Partner,
    Target,
    WorkFrame,
    WorkingConditions,
    definition,
    load_targets,
    target_record,
)
from cellapp.ground.errors import InputError
from tests.approved import assert_refused
from tests.sure import sure
from tests.twin import small_twin

PROFILE = small_twin()
HEAD = "schema: cellapp-targets\nversion: 1\n"
FRAME = "frames:\n  table: {in: tracker, origin: [1, 0, 0], x: [1, 500 mm, 0], xy: [0.5, 0, 0]}\n"
ONE = "targets:\n  - {name: one, arm: left, position: [-0.4, 0.25, 1.0], rpy: [0, 0, 0]}\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "targets.yaml"


def loaded(path: Path, text: str) -> tuple[Target, ...]:
    path.write_text(HEAD + text, encoding="utf-8")
    return load_targets(path, PROFILE)


def one(**keys: str) -> str:
    """The list with one target, with keys added or replaced."""
    more = {"name": "one", "arm": "left", "position": "[-0.4, 0.25, 1.0]", **keys}
    return "targets:\n  - {" + ", ".join(f"{key}: {value}" for key, value in more.items()) + "}\n"


# -- work frames ------------------------------------------------------------------------------------------------------


def test_a_work_frame_by_origin_x_axis_and_plane(path: Path) -> None:
    (target,) = loaded(path, FRAME + one(frame="table"))
    T_M_W, rms = work_frame_pose(sure(target.work_frame))
    np.testing.assert_allclose(T_M_W, [[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-15)
    assert rms < 1e-15


def test_a_work_frame_by_points(path: Path) -> None:
    points = [
        f"{{nominal: [{x}, {y}, 0], measured: [{2 + x}, {y}, 1]}}" for x, y in ((0, 0), (0.3, 0), (0, 0.2), (0.1, 0.1))
    ]
    frame = f"frames:\n  plate: {{in: right, points: [{', '.join(points)}]}}\n"
    first, second = loaded(path, frame + one(frame="plate") + one(frame="plate", name="two").removeprefix("targets:\n"))
    assert first.work_frame is second.work_frame
    assert sure(first.work_frame).parent == "right"
    np.testing.assert_allclose(work_frame_pose(sure(first.work_frame))[0][:3, 3], [2, 0, 1], atol=1e-15)


def test_work_frames_are_refused_as_approved(path: Path) -> None:
    approved = Path(__file__).parent / "approved" / "refused-frames.txt"
    assert_refused(approved, lambda frame: loaded(path, frame + ONE), path.parent)


# -- rotations --------------------------------------------------------------------------------------------------------


def test_units_in_a_rotation_vector_and_no_rotation(path: Path) -> None:
    (target,) = loaded(path, one(rotation_vector="[90 deg, 0, 0]"))
    assert target.rpy == pytest.approx((math.pi / 2.0, 0.0, 0.0))
    (target,) = loaded(path, one(matrix="null", rpy="null"))
    assert target.rpy is None


# -- the rest of a target ---------------------------------------------------------------------------------------------


def test_targets_and_lists_that_are_refused(path: Path) -> None:
    """Lines name keys of a target with their values, or the ``text`` of a list."""

    def refused(*words: str) -> tuple[Target, ...]:
        keys = dict(zip(words[::2], words[1::2], strict=True))
        return loaded(path, keys.get("text", one(**keys)).replace("ONE", ONE))

    assert_refused(Path(__file__).parent / "approved" / "refused-lists.txt", refused, path.parent)


@pytest.mark.parametrize(("open_", "says"), [("[", " nested too deeply"), ("- ", "3: not YAML")])
def test_a_list_that_is_nested_without_end_is_refused(path: Path, open_: str, says: str) -> None:
    with pytest.raises(InputError, match=f"targets.yaml:{says}"):
        loaded(path, "targets: " + open_ * 100_000)


def test_conditions_of_the_file_hold_where_a_target_states_none(path: Path) -> None:
    usual = "conditions: {left: {payload: 2 kg, temperature: 23}, right: {dwell: 1}}\n"
    partner = "{arm: right, position: [0, 0, 0.1]}"
    (target,) = loaded(path, usual + one(conditions="{payload: 1}", rpy="[0, 0, 0]", partner=partner))
    assert target.conditions == WorkingConditions(payload=1.0, temperature=23.0)
    assert sure(target.partner).conditions == WorkingConditions(dwell=1.0)


TABLE = WorkFrame(
    name="Tisch: 'ä'",
    parent="right",
    points=tuple(
        FramePoint(nominal=(x, y, 1.0 / 3.0), measured=(x + 1e-17, y, 1.0 / 3.0))
        for x, y in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.3))
    ),
)


FULL = Target(
    name="one",
    arm="left",
    position=(0.1, 0.2, 1.0 / 3.0),
    rpy=(0.1, 0.2, math.pi),
    frame=TABLE.name,
    work_frame=TABLE,
    tolerance=1e-4,
    approach=(1, 0, -1, 0, 0, 1),
    conditions=WorkingConditions(payload=2.0),
    partner=Partner(
        arm="right", position=(0.0, 0.0, 0.1), rpy=(math.pi, 0.0, 1.0 / 3.0), conditions=WorkingConditions(dwell=1.0)
    ),
)


# -- results ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_result_is_about_a_target_while_nothing_of_it_changed(arm: str) -> None:
    stored = target_record(FULL, arm)
    assert stored.partner == ({"left", "right"} - {arm}).pop()
    assert definition(FULL) == stored.definition
    moved = TABLE.model_copy(update={"parent": "left"})
    changes = (
        {"work_frame": moved},
        {"partner": sure(FULL.partner).model_copy(update={"position": (0.0, 0.0, 0.2)})},
        {"partner": None},
        {"conditions": WorkingConditions()},
        {"approach": None},
        {"rpy": None},
        {"frame": "tracker", "work_frame": None},
    )
    assert not any(definition(FULL.model_copy(update=change)) == stored.definition for change in changes)
