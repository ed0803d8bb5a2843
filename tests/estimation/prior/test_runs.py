"""``calibrate --prior`` on runs of a real arm: chains of earlier runs, what is stored, what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile, import_csv
from cellapp.cell.run.arm_identity import CONTROLLERS_RESULT
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import calibration_tables, tracker_sentences
from cellapp.commands.discover.run import discover_run
from cellapp.commands.report.result import read_results
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile

ROOT = Path(__file__).parents[3]


def profile_of(name: str, identify: int) -> Profile:
    profile = load_profile(ROOT / "profiles" / f"{name}.yaml")
    return profile.model_copy(
        update={
            "splits": profile.splits.model_copy(update={"identify": identify}),
            "network": profile.network.model_copy(update={"kind": "none"}),
        }
    )


def imported(folder: Path, name: str, first: int, every: int, count: int, identify: int) -> Path:
    """A run of some rows of a series."""
    header, *rows = (ROOT / "tests" / "fixtures" / name / "readings.csv").read_text("utf-8").splitlines()
    csv = folder.with_suffix(".csv")
    csv.write_text("\n".join([header, *rows[first::every][:count]]) + "\n", "utf-8")
    import_csv(profile_of(name, identify), csv, folder).close()
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """``first``: series C; ``second``: D with the first as prior; ``third``: other rows of D with the second."""
    folder = tmp_path_factory.mktemp("priors")
    first = imported(folder / "first", "ur10-real", 0, 9, 300, 260)
    second = imported(folder / "second", "ur10-real-d", 0, 4, 150, 30)
    third = imported(folder / "third", "ur10-real-d", 1, 4, 150, 30)
    prior = None
    for path in (first, second, third):
        with RunFile.open(path, write=True) as run:
            calibrate_run(run, prior=prior)
        prior = path
    return {"first": first, "second": second, "third": third}


@pytest.fixture
def copies(runs: dict[str, Path], tmp_path: Path) -> dict[str, Path]:
    """The runs in a folder where a test may change them."""
    return {name: Path(shutil.copytree(path, tmp_path / name)) for name, path in runs.items()}


def test_the_prior_is_stored_and_shown(runs: dict[str, Path]) -> None:
    with RunFile.open(runs["second"]) as run:
        stages = read_stages(run)
        result = read_results(run).calibrate
        basis = stages.current["calibrate"].basis
    assert result is not None
    assert basis is not None
    arm = result.arms["left"]
    assert arm.prior is not None
    assert (Path(arm.prior.run), arm.prior.stage) == (runs["first"], "calibrate")
    assert arm.prior.sha256 == basis.priors["left"].sha256
    assert arm.prior.tested > 20
    assert arm.validate_["effects"].position_mm.mean <= arm.validate_["geometry"].position_mm.mean
    assert any("taken from you" in note for note in result.notes)
    assert any("earlier calibration of" in table.title for table in calibration_tables(result))
    assert any("is the prior" in sentence for sentence in tracker_sentences(result))
    assert CalibrateResult.from_json(result.to_json(), "again") == result


def test_without_a_prior_nothing_changes(copies: dict[str, Path]) -> None:
    with RunFile.open(copies["first"], write=True) as run:
        before = read_stages(run).current["calibrate"]
        calibrate_run(run)
        after = read_stages(run).current["calibrate"]
    assert before.digest == after.digest
    assert "prior" not in json.loads(after.text)["arms"]["left"]


def test_a_chain_of_earlier_runs_holds_until_one_changes(copies: dict[str, Path]) -> None:
    second, third = copies["second"], copies["third"]
    with RunFile.open(third, write=True) as run:
        calibrate_run(run, prior=second)
        assert not read_stages(run).out_of_date
        with RunFile.open(second, write=True) as earlier:
            alone = calibrate_run(earlier)  # another model
        assert any("which was its prior before" in note for note in alone.notes)
        assert "has changed since" in read_stages(run).out_of_date["calibrate"]
        with pytest.raises(InputError, match="has changed since; run 'cellapp calibrate"):
            discover_run(run)


def test_discovery_keeps_what_was_carried_over(copies: dict[str, Path]) -> None:
    with RunFile.open(copies["third"], write=True) as run:
        calibrated = model_of(run, stage_in_force(run, read_stages(run))).arms["left"]
        result = discover_run(run)
        stages = read_stages(run)
        model = model_of(run, stage_in_force(run, stages)).arms["left"]
        assert stages.current["discover"].basis is not None
        assert stages.current["discover"].basis.priors
    assert "carried over: geometry" in result.arms["left"].sentence
    if not result.arms["left"].accepted:
        assert model.geometry.vector().tolist() == calibrated.geometry.vector().tolist()


def test_an_earlier_run_that_is_gone_is_said(copies: dict[str, Path], tmp_path: Path) -> None:
    with RunFile.open(copies["second"], write=True) as run:
        calibrate_run(run, prior=copies["first"])
        copies["first"].rename(tmp_path / "elsewhere")
        assert not read_stages(run).out_of_date
        with pytest.raises(InputError, match="cannot be read"):
            discover_run(run)


def refused(run: Path, prior: Path) -> str:
    with RunFile.open(run, write=True) as opened, pytest.raises(InputError) as error:
        calibrate_run(opened, prior=prior)
    return str(error.value)


def test_what_is_no_earlier_calibration_is_refused(copies: dict[str, Path], tmp_path: Path) -> None:
    second = copies["second"]
    assert "the same run" in refused(second, second)
    assert "give the folder" in refused(second, copies["first"] / "calibration.json")
    assert "run" in refused(second, tmp_path / "nothing")
    again = Path(shutil.copytree(second, tmp_path / "copy"))
    assert "the same readings" in refused(second, again)
    bare = imported(tmp_path / "bare", "ur10-real", 3, 30, 60, 40)
    assert "not calibrated" in refused(second, bare)


def test_another_arm_is_refused(copies: dict[str, Path], tmp_path: Path) -> None:
    other = imported(tmp_path / "other", "ur5-real", 970, 1, 50, 30)
    with RunFile.open(other, write=True) as run:
        calibrate_run(run)
    assert "is a UR5 there and a UR10 here" in refused(copies["second"], other)
    for name, serial in (("first", "2017300001"), ("second", "2019300002")):
        identity = {"model": "UR10", "serial": serial, "software": "3.15", "dh_checksum": "1"}
        with RunFile.open(copies[name], write=True) as run:
            run.write_result(CONTROLLERS_RESULT, json.dumps({"left": identity}))
    assert "serial number 2017300001 there, 2019300002 here" in refused(copies["second"], copies["first"])
