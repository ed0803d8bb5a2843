"""Stops that are measured again: what replaces what, what is kept, and what a file of an older schema lacks."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.run import Outcome, RunFile, write_readings_csv
from cellapp.cell.run.csv_import import WhichSmr
from cellapp.cell.run.measured_again import earlier_readings, replace_stop, replaced_counts
from cellapp.cell.run.measurement_order import in_measured_order
from cellapp.cell.run.records import ArmOrder
from cellapp.commands.calibrate.run import sample_missing_splits
from cellapp.commands.import_ import ImportRequest
from cellapp.commands.import_ import run as import_run
from cellapp.estimation.readings import Readings
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from cellapp.robot.kinematics.transforms import rotation_vectors
from tests.cell.run.small_runs import (
    Rows,
    add_stop,
    assert_same,
    import_csv,
    planned_run,
    read_readings_csv,
    two_arms,
    written,
)
from tests.commands.emulated_cell import quiet_work
from tests.sure import sure
from tests.twin import PROFILES, small_twin
from tests.verbs import import_new_run


def seen(joints: int, x_m: float) -> Readings:
    return Readings.one(q=np.zeros(joints), p_M=np.array([x_m, 0.0, 0.0]), time_s=9.0, split="train")


@pytest.fixture
def run(tmp_path: Path) -> RunFile:
    run = planned_run(tmp_path / "run")
    for stop in (0, 1):
        add_stop(run, stop)
    return run


def test_the_newest_reading_counts_and_those_before_are_kept_as_they_were(run: RunFile) -> None:
    before = run.readings("left")
    for x_m in (2.0, 3.0):
        replace_stop(run, 1, {"left": seen(2, x_m), "right": seen(3, x_m)})
    left, (earlier, replaced) = run.readings("left"), earlier_readings(run, "left")
    np.testing.assert_array_equal(left.p_M[:, 0], [1.0, 3.0])
    assert earlier.configuration.tolist() == [1, 1]
    np.testing.assert_array_equal(earlier.p_M[:, 0], [1.0, 2.0])
    np.testing.assert_array_equal(earlier.q[0], before.q[1])
    assert list(replaced) == sorted(replaced)
    assert replaced_counts(run) == {"left": 2, "right": 2}
    assert run.stops_done() == {0, 1}


def test_a_stop_stays_in_its_split(run: RunFile) -> None:
    with pytest.raises(InputError, match="at least 4 and 1"):  # two are too few: later ones would have no split
        sample_missing_splits(run)
    run.assign_splits("left", ["identify", "validate"])
    replace_stop(run, 1, {"left": seen(2, 2.0), "right": seen(3, 2.0)})
    assert run.readings("left").split == ("identify", "validate")
    assert run.readings("right").split is None, "its splits are not drawn yet"


def test_what_stops_to_come_are_for_is_said_when_splits_are_chosen(tmp_path: Path) -> None:
    with planned_run(tmp_path / "early", 22) as run:
        for stop in range(20):
            add_stop(run, stop)
        *_, note = sample_missing_splits(run)
    assert note.startswith("2 planned stops are not measured: splits are chosen once")


def test_an_arm_without_a_new_reading_keeps_what_it_has_and_one_that_had_none_gets_it(run: RunFile) -> None:
    run.add_stop(2, {"left": seen(2, 1.0)}, [Outcome(2, "right", "not measured", "hidden")])
    replace_stop(run, 2, {"right": seen(3, 2.0)}, [Outcome(2, "left", "not measured", "hidden")])
    assert [run.readings(arm).p_M[2, 0] for arm in ("left", "right")] == [1.0, 2.0]
    assert (run.outcomes(), replaced_counts(run)) == ([], {})
    replace_stop(run, 3, {}, [Outcome(3, "left", "not measured", "still hidden")])
    assert [(one.stop, one.reason) for one in run.outcomes()] == [(3, "still hidden")]


def test_a_file_of_the_eighth_schema_has_none_and_takes_some(run: RunFile) -> None:
    session = run.begin_session()
    run.end_session(session, "complete", "")
    run.close()
    with contextlib.closing(sqlite3.connect(run.path)) as connection:
        connection.execute("DROP TABLE earlier_reading")
        connection.execute("ALTER TABLE session DROP COLUMN again")
        for column in ("turning_covariance_rad2", "q_spread"):
            connection.execute(f"ALTER TABLE reading DROP COLUMN {column}")
        connection.execute("PRAGMA user_version=8")
        connection.commit()
    with RunFile.open(run.folder) as older:
        assert len(earlier_readings(older, "left")[0]) == 0
        assert replaced_counts(older) == {}
        assert [one.again for one in older.sessions()] == [""]
    with RunFile.open(run.folder, write=True) as older:
        older.begin_session("2")
        replace_stop(older, 1, {"left": seen(2, 2.0)})
        assert replaced_counts(older) == {"left": 1}
        assert [one.again for one in older.sessions()] == ["", "2"]


# -- Import in the order of measurement: each joint's last motion from the row before, and what contradicts it ---------

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
    np.testing.assert_array_equal(sure(found.sequence), [1, 2, 0])
    np.testing.assert_array_equal(found.approach, [[1, -1], [-1, 1], [0, 0]])
    np.testing.assert_allclose(sure(found.step), [[0.2, -0.3], [-0.1, 0.4], [np.nan, np.nan]])
    plain = left(path, in_order=False)
    assert plain.sequence is plain.step is None
    assert not plain.approach.any()


def test_values_that_are_given_stay_and_a_detour_leaves_the_step_unknown() -> None:
    approach = np.array([[1, 0], [-1, 0], [0, 0]], dtype=np.int8)
    step = np.array([[np.nan, np.nan], [np.nan, -0.2], [np.nan, np.nan]])
    found, derived = in_measured_order(some([[0.0, 0.0], [0.5, 0.5], [0.5, 0.4]], approach=approach, step=step))
    # joint 1 came to the second stop from above although the stop before lies below: by way of another place
    np.testing.assert_array_equal(found.approach, [[1, 0], [-1, -1], [-1, -1]])
    np.testing.assert_allclose(sure(found.step), [[np.nan, np.nan], [np.nan, -0.2], [0.0, -0.1]])
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


@settings(max_examples=40)
@given(
    q=hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.just(2)), elements=st.floats(-3.0, 3.0)), data=st.data()
)
def test_export_then_import_gives_the_same_readings_with_and_without_the_flag(
    q: np.ndarray, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("order")
    stops = data.draw(st.permutations(range(len(q))))
    write(
        folder / "in.csv",
        HEADER,
        *(f"{stop},left,{a!r},{b!r},1,2,{stop + 3}" for stop, (a, b) in zip(stops, q.tolist())),
    )
    profile = two_arms()
    profile = profile.model_copy(update={"arms": {"left": profile.arms["left"]}})
    with import_csv(profile, folder / "in.csv", folder / "run", in_order=True) as run:
        first = run.readings("left")
        write_readings_csv(run, folder / "out.csv")
    assert_same(first, left(folder / "in.csv"))
    for in_order in (False, True):
        assert_same(left(folder / "out.csv", in_order=in_order), first)


# -- Rows of several SMRs on a flange through the one door: one position and one rotation a stop, or one SMR of them ---

STOPS = 24
PLACES_S = {"A": (0.0, 0.0, 0.0), "B": (0.11, 0.0, 0.0), "C": (0.02, 0.09, 0.0), "D": (0.04, 0.03, 0.06)}
SIGMA_M = 2e-5


@dataclass(frozen=True, eq=False)
class Measured:
    """Rows of a file, with the true positions of SMR A (n, 3) and rotations of the flange (n, 3, 3)."""

    rows: Rows
    p_M: np.ndarray
    R_M: np.ndarray


def left_alone() -> Profile:
    """The twin's left arm alone; the simulated probe tells how its flange is really turned."""
    profile = small_twin(plant={"effects": {}})
    smr = Smr.model_validate({"offset": (0.045, 0.020, 0.060), "probe": {"rpy": (0.0, 0.0, 0.0)}})
    arm = profile.arms["left"].model_copy(update={"smr": smr})
    return profile.model_copy(update={"arms": {"left": arm}})


def measured(names: Sequence[str] = "ABC", seed: int = 3, **more: str) -> Measured:
    plant, rng = build_plant(left_alone()), np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (STOPS, 6))
    p_M, R_M = plant.smr_positions("left", q), plant.probe_rotations("left", q)
    rows: Rows = []
    for place, name in enumerate(names):
        points = p_M + R_M @ np.array(PLACES_S[name]) + SIGMA_M * rng.standard_normal((STOPS, 3))
        for stop in range(STOPS):
            rows.append(
                {
                    "configuration": str(stop),
                    "arm": "left",
                    "time_s": repr(10.0 * stop + place),
                    **{f"q{joint + 1}": repr(float(angle)) for joint, angle in enumerate(q[stop])},
                    **dict(zip(("x_m", "y_m", "z_m"), map(repr, points[stop].tolist()), strict=True)),
                    **more,
                    "smr": name,
                    "split": "validate" if stop % 3 == 0 else "identify",
                }
            )
    return Measured(sorted(rows, key=lambda row: int(row["configuration"])), p_M, R_M)


def imported(rows: Rows, folder: Path, **options: Any) -> RunFile:
    import_new_run(left_alone(), written(folder / "in.csv", rows), folder / "run", **options)
    return RunFile.open(folder / "run")


def in_sigmas(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the mean square of vectors (n, 3) by their covariances (n, 3, 3), for each degree of freedom."""
    return float(np.einsum("na,nab,nb->n", off, np.linalg.inv(covariance), off).mean()) / 3.0


@pytest.mark.parametrize("names", ["ABC", "ABCD", "DCBA"])
@pytest.mark.parametrize("more", [{"sigma_m": repr(SIGMA_M)}, {}], ids=["stated", "not stated"])
def test_position_and_rotation_are_as_good_as_their_covariances_say(
    names: str, more: dict[str, str], tmp_path: Path
) -> None:
    chi_of_turns, chi_of_points = [], []
    for seed in range(3):
        folder = tmp_path / str(seed)
        folder.mkdir()
        truth = measured(names, seed, **more)
        with imported(truth.rows, folder) as run:
            one = run.readings("left")
        assert len(one) == STOPS
        assert one.smr is None
        found = Rotation.from_quat(sure(one.quaternion_M), scalar_first=True).as_matrix()
        mounted = Rotation.from_matrix(truth.R_M.swapaxes(1, 2) @ found).mean().as_matrix()  # S in F
        off = rotation_vectors(found @ (truth.R_M @ mounted).swapaxes(1, 2))
        chi_of_turns.append(in_sigmas(off, sure(one.rotation_covariance_M)))
        if more:
            true_M = truth.p_M + truth.R_M @ np.array(PLACES_S[names[0]])
            chi_of_points.append(in_sigmas(one.p_M - true_M, sure(one.covariance_M)))
        else:
            assert one.covariance_M is None
    assert 0.7 < np.mean(chi_of_turns) < 1.3
    assert not more or 0.7 < np.mean(chi_of_points) < 1.3


def test_what_was_made_is_said_stored_and_taken_again(tmp_path: Path) -> None:
    rows = measured(sigma_m=repr(SIGMA_M)).rows
    fewer = [row for row in rows if not (row["configuration"] == "3" and row["smr"] != "A")]
    fewer = [row for row in fewer if not (row["configuration"] == "5" and row["smr"] != "B")]
    with imported(fewer, tmp_path) as run:
        one = run.readings("left")
        write_readings_csv(run, tmp_path / "out.csv")
        (note,) = (event.text for event in run.events() if event.level == "note")
    assert 5 not in one.configuration
    assert np.flatnonzero(np.isnan(sure(one.quaternion_M)[:, 0])).tolist() == [3]
    assert "one position (that of SMR A) and one rotation of SMRs A, B, C at 22 of 24 stops, to 0.3" in note
    assert "1 stop left out; smr.offset of the profile is that of A" in note
    with import_csv(left_alone(), tmp_path / "out.csv", tmp_path / "again") as run:
        again = run.readings("left")
    for name in ("p_M", "covariance_M", "quaternion_M", "rotation_covariance_M", "time_s"):
        np.testing.assert_array_equal(getattr(again, name), getattr(one, name))


def test_two_smrs_ask_which_one_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = measured("AB").rows
    with pytest.raises(WhichSmr, match=r"arm 'left' was measured at two SMRs, A and B; .* \(--smr NAME\)") as asked:
        imported(rows, tmp_path)
    assert asked.value.names == ("A", "B")
    asked_for = []

    def choose(question: str, answers: tuple[str, ...]) -> str:
        asked_for.append((question, answers))
        return "B"

    monkeypatch.setattr("cellapp.commands.import_.load_profile", lambda path: left_alone())
    request = ImportRequest(profile=PROFILES / "twin.yaml", csv=tmp_path / "in.csv", folder=tmp_path / "run")
    import_run(request, replace(quiet_work(), choose=choose))
    assert asked_for[0][1] == ("A", "B")
    with RunFile.open(tmp_path / "run") as run:
        assert run.rows("left").smr == ("B",) * STOPS
        assert len(run.readings("left")) == STOPS


def test_one_of_three_may_be_taken_by_name(tmp_path: Path) -> None:
    with imported(measured().rows, tmp_path, smr="C") as run:
        one = run.readings("left")
        assert (len(one), one.quaternion_M) == (STOPS, None)
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match="--smr: no reading is of an SMR 'E'; there are A, B, C"):
        imported(measured().rows, tmp_path / "other", smr="E")


def test_smrs_on_one_line_give_no_rotation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PLACES_S, "C", (0.05, 0.0, 0.0))
    with pytest.raises(InputError, match="no stop has all of A, B, C, or they stand on one line"):
        imported(measured().rows, tmp_path)


def test_a_figure_that_does_not_settle_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.estimation.readings.readings._ROUNDS", 1)
    with pytest.raises(NotConverged, match="fit of the SMRs on a flange did not converge"):
        imported(measured().rows, tmp_path)


def change(key: str, value: str, place: int) -> Callable[[Rows], None]:
    def act(rows: Rows) -> None:
        rows[place][key] = value

    return act
