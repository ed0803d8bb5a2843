"""Import in the order of measurement: each joint's last motion from the row before, and what contradicts it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cellapp.cell.run import RunFile, import_csv, read_readings_csv, write_readings_csv
from cellapp.cell.run.measurement_order import in_measured_order
from cellapp.cell.run.records import ArmOrder
from cellapp.commands.import_ import import_new_run
from cellapp.commands.show.overview import run_overview
from cellapp.commands.show.view import overview_sentences
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError
from tests.cell.run.two_arm_cell import assert_same, two_arms

pytestmark = pytest.mark.fast

JOINTS = {"left": 2, "right": 3}
HEADER = "configuration,arm,q1,q2,x_m,y_m,z_m"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "readings.csv"


def write(path: Path, header: str, *rows: str) -> None:
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")


def left(path: Path, *, in_order: bool = True) -> Readings:
    return read_readings_csv(path, JOINTS, in_order=in_order)[0]["left"]


def some(q: list[list[float]], **values: object) -> Readings:
    n = len(q)
    given: dict = {"time_s": np.full(n, np.nan), "approach": np.zeros((n, 2), np.int8), **values}
    return Readings(configuration=np.arange(n), q=np.array(q), p_M=np.zeros((n, 3)), **given)


def test_motions_follow_from_the_row_before_not_from_the_number_of_the_stop(path: Path) -> None:
    others = "2,right,9,9,9,1,2,3"
    rows = ("7,left,0.1,0.5,,1,2,3", others, "3,left,0.3,0.2,,1,2,3", "5,left,0.2,0.6,,1,2,3")
    write(path, HEADER.replace("q2", "q2,q3"), *rows)
    found = left(path)
    assert found.configuration.tolist() == [3, 5, 7]
    assert found.sequence is not None
    assert found.step is not None
    np.testing.assert_array_equal(found.sequence, [1, 2, 0])
    np.testing.assert_array_equal(found.approach, [[1, -1], [-1, 1], [0, 0]])
    np.testing.assert_allclose(found.step, [[0.2, -0.3], [-0.1, 0.4], [np.nan, np.nan]])
    plain = left(path, in_order=False)
    assert plain.sequence is plain.step is None
    assert not plain.approach.any()


def test_a_joint_at_rest_keeps_the_sign_of_its_motion_before() -> None:
    encoder_noise = 4e-5
    found, derived = in_measured_order(some([[0.0, 0.0], [0.5, encoder_noise], [0.5 - encoder_noise, 0.3], [0.1, 0.3]]))
    assert found.step is not None
    np.testing.assert_array_equal(found.approach, [[0, 0], [1, 0], [1, 1], [-1, 1]])
    np.testing.assert_allclose(found.step, [[np.nan, np.nan], [0.5, 0.0], [0.0, 0.3], [-0.4, 0.0]], atol=2e-4)
    assert derived == ArmOrder(by="rows", approach=5, step=6)


def test_values_that_are_given_stay_and_a_detour_leaves_the_step_unknown() -> None:
    approach = np.array([[1, 0], [-1, 0], [0, 0]], dtype=np.int8)
    step = np.array([[np.nan, np.nan], [np.nan, -0.2], [np.nan, np.nan]])
    found, derived = in_measured_order(some([[0.0, 0.0], [0.5, 0.5], [0.5, 0.4]], approach=approach, step=step))
    # joint 1 came to the second stop from above although the stop before lies below: by way of another place
    assert found.step is not None
    np.testing.assert_array_equal(found.approach, [[1, 0], [-1, -1], [-1, -1]])
    np.testing.assert_allclose(found.step, [[np.nan, np.nan], [np.nan, -0.2], [0.0, -0.1]])
    assert derived == ArmOrder(by="rows", approach=3, step=2, contradicted=1)


def test_with_times_the_order_is_by_time_and_without_the_flag_nothing_is_derived(path: Path) -> None:
    header = HEADER.replace("arm,", "arm,time_s,")
    write(path, header, "0,left,30,0.3,0,1,2,3", "1,left,10,0.1,0,1,2,3", "2,left,20,0.2,0,1,2,3")
    found = left(path)
    np.testing.assert_array_equal(found.sequence, [2, 0, 1])
    np.testing.assert_array_equal(found.approach[:, 0], [1, 0, 1])
    plain = left(path, in_order=False)
    assert not plain.approach.any()
    assert plain.step is None


def test_equal_times_stand_in_the_order_of_the_rows(path: Path) -> None:
    write(path, HEADER.replace("arm,", "arm,time_s,"), *(f"{k},left,60,{q},0,1,2,3" for k, q in ((4, 0.1), (1, 0.4))))
    np.testing.assert_array_equal(left(path).approach, [[1, 0], [0, 0]])


def test_contradictory_orders_are_refused(path: Path) -> None:
    header = HEADER.replace("arm,", "arm,time_s,sequence,")
    write(path, header, "0,left,1,,0,0,1,2,3", "1,left,,,0,0,1,2,3")
    with pytest.raises(InputError, match=r"readings\.csv:3: time_s: the value is missing; an import in order needs"):
        left(path)
    assert len(left(path, in_order=False)) == 2
    write(path, header, "0,left,1,0,0,0,1,2,3", "1,left,9,1,0,0,1,2,3", "2,left,5,2,0,0,1,2,3")
    with pytest.raises(InputError, match=r"readings\.csv:4: sequence: this row is earlier in time_s"):
        left(path)
    write(path, header, "0,left,,0,0,0,1,2,3", "1,left,,0,0,0,1,2,3")
    with pytest.raises(InputError, match=r"readings\.csv:3: sequence: 0 is the place of another row"):
        left(path)
    write(path, header, "0,left,,0,0,0,1,2,3", "1,left,,,0,0,1,2,3")
    with pytest.raises(InputError, match=r"readings\.csv:3: sequence: the value is missing"):
        left(path)


def test_a_single_row_has_no_motion() -> None:
    found, derived = in_measured_order(some([[0.1, 0.2]]))
    assert found.step is None
    assert derived == ArmOrder(by="rows", approach=0, step=0)


def test_the_run_keeps_what_was_derived_and_says_so(path: Path, tmp_path: Path) -> None:
    profile = two_arms()
    profile = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    write(path, HEADER, "0,left,0.1,0.5,1,2,3", "1,left,0.3,0.2,1,2,3")
    result = import_new_run(profile, path, tmp_path / "run", in_order=True)
    said = (
        "arm left: measured in the order of the rows; 2 approach signs and 2 steps of joints derived from the reading"
        " before"
    )
    assert result.in_order == {"left": ArmOrder(by="rows", approach=2, step=2)}
    assert result.notes == (said,)
    with RunFile.open(tmp_path / "run") as run:
        overview = run_overview(run)
    assert overview.in_order == result.in_order
    assert said in overview_sentences(overview)
    assert import_new_run(profile, path, tmp_path / "plain").in_order == {}


def test_conditions_have_the_order_in_stops_and_no_made_up_time() -> None:
    found, _ = in_measured_order(some([[0.0, 0.0], [0.5, 0.1], [0.2, 0.3]]))
    conditions = measurement_conditions(found.take([2, 0]))
    assert conditions.time_s is None
    assert conditions.order is not None
    np.testing.assert_array_equal(measurement_conditions(found).order, [0, 1, 2])
    np.testing.assert_array_equal(conditions.order, [1, 0])
    assert measurement_conditions(some([[0.0, 0.0]])).order is None
    timed = some([[0.0, 0.0], [0.5, 0.1]], time_s=np.array([50.0, 20.0]))
    np.testing.assert_array_equal(measurement_conditions(timed).order, [1, 0])


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    q=hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.just(2)), elements=st.floats(-3.0, 3.0)), data=st.data()
)
def test_export_then_import_gives_the_same_readings_with_and_without_the_flag(
    q: np.ndarray, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("order")
    stops = data.draw(st.permutations(range(len(q))))
    write(folder / "in.csv", HEADER, *(f"{stop},left,{a!r},{b!r},1,2,3" for stop, (a, b) in zip(stops, q.tolist())))
    profile = two_arms()
    profile = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    with import_csv(profile, folder / "in.csv", folder / "run", in_order=True) as run:
        first = run.readings("left")
        write_readings_csv(run, folder / "out.csv")
    assert_same(first, left(folder / "in.csv"))
    for in_order in (False, True):
        assert_same(left(folder / "out.csv", in_order=in_order), first)
