"""An arm calibrated again: what is believed, what is free, and which changes are proven."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.cell.run.run_arms import CONTROLLERS_RESULT
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.calibrate.view import calibration_tables, tracker_sentences
from cellapp.commands.discover.run import discover_run
from cellapp.commands.run_results import read_results
from cellapp.commands.stages import read_stages
from cellapp.commands.stored_model import model_of, stage_in_force
from cellapp.estimation.calibration.identification import identify
from cellapp.estimation.calibration.parameters import candidate_columns, weak_priors
from cellapp.estimation.calibration.quantities import ArmReadings, measured_quantities
from cellapp.estimation.calibration.records import CalibrateResult
from cellapp.estimation.discovery.prior_fit import posterior
from cellapp.estimation.prior.belief import Belief, is_own
from cellapp.estimation.prior.calibrate import Earlier, SearchWithPriors, believed, stated_model, updated_arm
from cellapp.estimation.prior.update import Updated, first_model, update
from cellapp.ground.errors import InputError, NotConverged
from cellapp.ground.profile import Profile
from cellapp.robot.effects import EFFECTS
from cellapp.robot.kinematics.chain import parameter_names, smr_positions
from cellapp.robot.kinematics.transforms import rotation_vectors
from tests.arms import effect_term
from tests.cell.run.small_runs import import_csv
from tests.estimation.prior.conftest import ELSEWHERE, SimulatedArm, earlier_of
from tests.sure import sure
from tests.twin import altered

TOOL = np.array([-0.03, 0.05, 0.11])


def again(arm: SimulatedArm, earlier: Earlier, count: int, seed: int = 2) -> Updated:
    readings = arm.readings(count, seed)
    return update(ArmReadings.alone(arm.profile, "left", arm.model, readings), earlier.belief, earlier.since)


def error_um(arm: SimulatedArm, outcome: Updated) -> float:
    """Mean distance of predictions from the truth [um]."""
    q = np.random.default_rng(9).uniform(-2.0, 2.0, (200, 6))
    return float(np.linalg.norm(outcome.found.model.predict(q) - arm.model.predict(q), axis=1).mean()) * 1e6


def test_readings_without_information_return_the_prior(arm: SimulatedArm, earlier: Earlier) -> None:
    readings = replace(arm.readings(20, seed=3), sigma_m=np.full(20, 1e4))
    measured = replace(measured_quantities(readings), sigma=np.asarray(readings.sigma_m))
    belief = earlier.belief
    model = first_model(arm.profile, "left", measured, belief)
    prior = belief.prior(model.nominal, np.zeros(0))
    after = Belief.of(posterior(model, measured, prior, weighed=True), np.ones(len(prior.mean)))
    absolute = [one.nominal.vector()[list(one.columns)] for one in (belief, after)]
    K = len(belief.columns)
    before_mean = np.concatenate([absolute[0] + belief.mean[:K], belief.mean[K:]])
    after_mean = np.concatenate([absolute[1] + after.mean[:K], after.mean[K:]])
    sd = np.sqrt(np.diag(belief.covariance))
    np.testing.assert_allclose((after_mean - before_mean) / sd, 0.0, atol=1e-3)
    np.testing.assert_allclose(after.covariance / sd / sd[:, None], belief.covariance / sd / sd[:, None], atol=1e-3)


def test_a_belief_that_knows_nothing_gives_the_geometry_of_today(arm: SimulatedArm) -> None:
    bare = replace(arm, model=replace(arm.model, effects=()))
    readings = bare.readings(40, seed=4)
    measured = replace(measured_quantities(readings), sigma=np.asarray(readings.sigma_m))
    weak = weak_priors(6)
    columns = tuple(column for column in candidate_columns(arm.model.nominal) if is_own(column, 6))
    sigma = np.array([weak[parameter_names(6)[column]] for column in columns])
    belief = Belief(arm.model.nominal, columns, (), np.zeros(len(sigma)), np.diag(sigma**2), sigma)
    model = first_model(arm.profile, "left", measured, belief)
    prior = belief.prior(model.nominal, np.zeros(0))
    found = posterior(model, measured, prior, weighed=True)
    today = identify(
        model.geometry, readings.q, readings.p_M, sigma=readings.sigma_m, prior_sigma=weak_priors(6),
        prior_mean=model.nominal,
    )  # fmt: skip
    q = np.random.default_rng(9).uniform(-2.0, 2.0, (100, 6))
    off = smr_positions(found.model.geometry, q) - smr_positions(today.geometry, q)
    assert np.abs(off).max() < 2e-7


def test_orientation_of_few_stops_names_changes_that_their_positions_do_not_prove(arm: SimulatedArm) -> None:
    six = arm.with_probe(np.array([0.1, -0.2, 0.3]))
    change = np.zeros((6, 5))
    change[4, 0], change[2, 0] = 2e-4, 1e-4
    told = {}
    for kind in (arm, six):
        belief, count = believed(ArmReadings.alone(kind.profile, "left", kind.model, kind.readings(200, seed=1)))
        now = kind.mounted(ELSEWHERE, TOOL).with_rows(change)
        now = now if kind is arm else now.with_probe(np.array([0.5, -0.2, 0.3]))
        told[kind is six] = now, again(now, earlier_of(belief, count), 14)
    assert told[False][1].changes == ()
    now, outcome = told[True]
    assert {one.what for one in outcome.changes} == {"zero of joint 3", "zero of joint 5"}
    assert outcome.scatter_rad == pytest.approx(2e-5, abs=2e-5)
    q = np.random.default_rng(9).uniform(-2.0, 2.0, (100, 6))
    off = outcome.found.model.orientation(q) @ now.model.orientation(q).swapaxes(1, 2)
    assert np.linalg.norm(rotation_vectors(off), axis=1).mean() < 2e-5


def test_few_readings_with_the_earlier_calibration_are_as_good_as_many(arm: SimulatedArm, earlier: Earlier) -> None:
    moved = arm.mounted(ELSEWHERE, TOOL)
    few = error_um(moved, again(moved, earlier, 30))
    loose = replace(earlier, belief=earlier.belief.widened(np.full(len(earlier.belief.mean), 1e-6)))
    many = error_um(moved, again(moved, loose, 30))
    assert few < 0.7 * many


@pytest.mark.parametrize(("joint", "sign"), [(2, 1.0), (4, -1.0)], ids=["joint 3", "joint 5"])
def test_a_changed_joint_zero_is_found_named_and_measured(
    arm: SimulatedArm, earlier: Earlier, joint: int, sign: float
) -> None:
    change = np.zeros((6, 5))
    change[joint, 0] = sign * 0.31e-3
    moved = arm.with_rows(change).mounted(ELSEWHERE, TOOL)
    outcome = again(moved, earlier, 40)
    found = [one for one in outcome.changes if one.what == f"zero of joint {joint + 1}"]
    assert len(outcome.changes) == len(found) == 1
    assert found[0].value == pytest.approx(sign * 0.31e-3, abs=4.0 * (found[0].standard_error or 0.0))
    assert (found[0].sigmas or 0.0) > 5.0
    assert "since 2026-03-01" in found[0].sentence
    assert error_um(moved, outcome) < 10.0


def test_an_effect_that_vanished_is_named(arm: SimulatedArm, earlier: Earlier) -> None:
    term = arm.model.effects[0]
    values = term.values.copy()
    values[1] = 0.0  # of joint 3
    repaired = replace(arm, model=replace(arm.model, effects=(replace(term, values=values),)))
    outcome = again(repaired.mounted(ELSEWHERE, TOOL), earlier, 40)
    assert [one.part for one in outcome.changes] == ["effects"]
    assert "joint 3" in outcome.changes[0].what
    assert "vanished" in outcome.changes[0].sentence


def test_an_arm_that_is_another_one_is_not_believed(arm: SimulatedArm, earlier: Earlier) -> None:
    rng = np.random.default_rng(8)
    other = arm.with_rows(rng.normal(0.0, 1e-3, (6, 5)) * [1, 1, 1, 1, 0])
    outcome = again(other.mounted(ELSEWHERE, TOOL), earlier, 60)
    assert (outcome.parts["geometry"].drift or 1.0) > 1e-4
    assert error_um(other.mounted(ELSEWHERE, TOOL), outcome) < 30.0


def test_an_effect_that_appeared_is_found_beside_what_was_carried_over(arm: SimulatedArm, earlier: Earlier) -> None:
    law = EFFECTS["encoder_eccentricity"].forms[0].law()
    readings = arm.readings(70, seed=6, learn=40)
    columns = EFFECTS["encoder_eccentricity"].columns(arm.model.context(readings.q), law)
    new = effect_term("encoder_eccentricity", {one.name: 1e-4 for one in columns if one.joint == 1}, law=law)
    worn = replace(arm, model=replace(arm.model, effects=(*arm.model.effects, new))).mounted(ELSEWHERE, TOOL)
    readings = worn.readings(70, seed=6, learn=40)
    measured = ArmReadings.alone(worn.profile, "left", worn.model, readings)
    outcome = updated_arm(measured, earlier)
    found = SearchWithPriors({"left": earlier})(replace(measured, model=stated_model(outcome.found, 0)))
    assert [effect.effect for effect in found.result.accepted] == ["encoder_eccentricity"]
    assert "joint 2 has appeared since 2026-03-01" in found.result.sentence
    assert [term.slug for term in found.model.effects] == ["joint_compliance", "encoder_eccentricity"]
    np.testing.assert_allclose(found.model.effects[1].values, 1e-4, atol=3e-5)


def test_of_a_quite_different_arm_nothing_is_used(arm: SimulatedArm, earlier: Earlier) -> None:
    belief = earlier.belief
    terms = tuple(replace(term, values=-3.0 * term.values) for term in belief.terms)
    mean = np.concatenate([-8.0 * belief.mean[: len(belief.columns)], *(term.values for term in terms)])
    outcome = again(arm.mounted(ELSEWHERE, TOOL), replace(earlier, belief=replace(belief, mean=mean, terms=terms)), 60)
    assert not outcome.used
    assert not any(part.used for part in outcome.parts.values())
    assert outcome.changes == ()
    assert outcome.found.model.effects == ()


def test_drifts_whose_search_does_not_end_are_no_statement_about_the_arm(
    arm: SimulatedArm, earlier: Earlier, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cellapp.estimation.prior.update._EVALUATIONS", 5)
    with pytest.raises(NotConverged, match="search of the drifts since an earlier calibration did not converge"):
        again(arm, earlier, 30)


# -- ``calibrate --prior`` on runs of a real arm: chains of earlier runs, what is stored, what is refused --------------

ROOT = Path(__file__).parents[3]


def profile_of(name: str, identify: int) -> Profile:
    profile = load_profile(ROOT / "profiles" / f"{name}.yaml")
    return altered(profile, splits={"identify": identify}, network={"kind": "none"})


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
    arm = result.arms["left"]
    assert arm.prior is not None
    assert (Path(arm.prior.run), arm.prior.stage) == (runs["first"], "calibrate")
    assert arm.prior.sha256 == sure(basis).priors["left"].sha256
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
        assert sure(stages.current["discover"].basis).priors
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
            run.write_document(CONTROLLERS_RESULT, json.dumps({"left": identity}))
    assert "serial number 2017300001 there, 2019300002 here" in refused(copies["second"], copies["first"])
