"""Rows of several SMRs on a flange through the one door: one position and one rotation a stop, or one SMR of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant
from cellapp.cell.run import RunFile, import_csv, write_readings_csv
from cellapp.cell.run.csv_import import WhichSmr
from cellapp.commands.import_ import ImportRequest, import_new_run
from cellapp.commands.import_ import run as import_run
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.ground.profile.sections import Smr
from cellapp.robot.kinematics.transforms import rotation_vectors
from tests.cell.run.csv_rows import Rows, written
from tests.commands.quiet_work import quiet_work
from tests.twin import PROFILES, small_twin

pytestmark = pytest.mark.fast
STOPS = 24
PLACES_S = {
    "A": (0.0, 0.0, 0.0),
    "B": (0.11, 0.0, 0.0),
    "C": (0.02, 0.09, 0.0),
    "D": (0.04, 0.03, 0.06),
}
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
        assert one.quaternion_M is not None
        assert one.turning_covariance_M is not None
        found = Rotation.from_quat(one.quaternion_M, scalar_first=True).as_matrix()
        mounted = Rotation.from_matrix(truth.R_M.swapaxes(1, 2) @ found).mean().as_matrix()  # S in F
        off = rotation_vectors(found @ (truth.R_M @ mounted).swapaxes(1, 2))
        chi_of_turns.append(in_sigmas(off, one.turning_covariance_M))
        if more:
            assert one.covariance_M is not None
            true_M = truth.p_M + truth.R_M @ np.array(PLACES_S[names[0]])
            chi_of_points.append(in_sigmas(one.p_M - true_M, one.covariance_M))
        else:
            assert one.covariance_M is None
    assert 0.7 < np.mean(chi_of_turns) < 1.3
    assert not more or 0.7 < np.mean(chi_of_points) < 1.3


def test_the_frame_of_the_rotation_lies_in_the_smrs(tmp_path: Path) -> None:
    """x points from the first SMR to the second one, z is normal to the first three: as the places are written here."""
    truth = measured()
    with imported(truth.rows, tmp_path) as run:
        quaternion = run.readings("left").quaternion_M
    turned = rotation_vectors(Rotation.from_quat(quaternion, scalar_first=True).as_matrix().swapaxes(1, 2) @ truth.R_M)
    assert np.abs(turned).max() < 8.0 * SIGMA_M / 0.09


def test_what_was_made_is_said_stored_and_taken_again(tmp_path: Path) -> None:
    rows = measured(sigma_m=repr(SIGMA_M)).rows
    fewer = [row for row in rows if not (row["configuration"] == "3" and row["smr"] != "A")]
    fewer = [row for row in fewer if not (row["configuration"] == "5" and row["smr"] != "B")]
    with imported(fewer, tmp_path) as run:
        one = run.readings("left")
        write_readings_csv(run, tmp_path / "out.csv")
        (note,) = (event.text for event in run.events() if event.level == "note")
    assert 5 not in one.configuration
    assert one.quaternion_M is not None
    assert np.flatnonzero(np.isnan(one.quaternion_M[:, 0])).tolist() == [3]
    assert "one position (that of SMR A) and one rotation of SMRs A, B, C at 22 of 24 stops, to 0.3" in note
    assert "1 stop left out; smr.offset of the profile is that of A" in note
    with import_csv(left_alone(), tmp_path / "out.csv", tmp_path / "again") as run:
        again = run.readings("left")
    for name in ("p_M", "covariance_M", "quaternion_M", "turning_covariance_M", "time_s"):
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


def exchange(rows: Rows) -> None:
    other = {"A": "A", "B": "C", "C": "B"}
    for row in rows:
        if row["configuration"] == "4":
            row["smr"] = other[row["smr"]]


def change(key: str, value: str, place: int) -> Callable[[Rows], None]:
    def act(rows: Rows) -> None:
        rows[place][key] = value

    return act


@pytest.mark.parametrize(
    ("spoil", "line", "column", "says"),
    [
        (exchange, 14, "smr", "the SMRs are off their places at other stops by"),
        (change("q3", "0.7", 7), 9, "q3", "rad from another row of the stop"),
        (change("split", "train", 4), 6, "split", "train, but identify in another row of the same stop"),
        (change("x_m", "3.5", 10), 11, "smr", "the SMRs are off their places at other stops by"),
        (change("smr", "A", 1), 3, "configuration", "0 of arm left was given in line 2 already"),
    ],
)
def test_a_mistake_is_named_by_row(
    tmp_path: Path, spoil: Callable[[Rows], None], line: int, column: str, says: str
) -> None:
    rows = measured().rows
    spoil(rows)
    path = written(tmp_path / "in.csv", rows)
    with pytest.raises(InputError) as caught:
        import_csv(left_alone(), path, tmp_path / "run")
    first = str(caught.value).splitlines()[0]
    assert first.startswith(f"{path}:{line}: {column}: "), caught.value
    assert says in str(caught.value)
