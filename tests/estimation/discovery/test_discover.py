"""Hidden effects are named, with values inside their own uncertainty; nothing is named where nothing is hidden."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellapp.cell.driving.cell import build_plant, plant_arm
from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.run import discover_result
from cellapp.commands.run_results import read_results
from cellapp.commands.stages import CALIBRATION_FILE
from cellapp.commands.trials.blind import TrialNoise, blind_readings, with_hidden
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import ArmReadings, measured_quantities, measurement_conditions
from cellapp.estimation.discovery import discover, prior_fit
from cellapp.estimation.discovery.all_readings import fit_to_all
from cellapp.estimation.discovery.arm_data import has_smooth_terms
from cellapp.estimation.discovery.discover import Searched, discover_arm, search_rows
from cellapp.estimation.discovery.outcome import HeldOut
from cellapp.estimation.discovery.records import with_effects
from cellapp.ground.errors import NotConverged
from cellapp.ground.progress import Cancelled, JobSteps, JobToken
from cellapp.robot.effects import EFFECTS, MeasurementConditions
from cellapp.robot.kinematics.chain import flange_poses, smr_positions
from cellapp.robot.kinematics.transforms import rotation_vectors
from cellapp.robot.model import CellModel
from cellapp.robot.model.inverse import invert
from cellapp.robot.model.nominal import nominal_arm
from drivers.plant import suggest
from tests.arms import effect_term, true_geometry
from tests.cell.run.small_runs import import_csv
from tests.estimation.discovery.problems import calibrated_and_searched
from tests.evidence.shared.series import load_entrant, sample_rows
from tests.series import readings_at, twin
from tests.sure import sure
from tests.twin import altered

ROOT = Path(__file__).parents[3]
STIFFNESS = [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]
PLAY = [2.0e-4, 2.0e-4, 1.0e-4, 0.0, 0.0, 0.0]
FEW = 200
"""Stops that show most effects; a free curve of a joint's transmission and functions of two angles need all."""
ECCENTRIC = {"joints": [1], "eccentricity": [2.0e-6], "radius": [0.025], "phase": [0.3]}


def without_network(profile):
    """The profile without residual networks: discovery's findings do not depend on them, and training takes long."""
    return altered(profile, network={"kind": "none"})


def measured_run(folder, plan, effects, seed=7, noise_seed=0):
    """A run of a twin with ``effects`` by arm, measured in one go by the plant."""
    profile = load_profile(ROOT / "profiles" / "twin.yaml")
    profile = without_network(altered(profile, plant={"effects": effects, "seed": seed}))
    plant, rng = build_plant(profile), np.random.default_rng(noise_seed)

    def fill(run):
        for name, q in plan.items():
            approach, time_s = np.sign(np.diff(np.vstack([np.zeros(6), q]), axis=0)), np.arange(float(len(q)))
            p_M, covariance_M = plant.measure_positions(plant.smr_positions(name, q, approach=approach), rng)
            run.add_readings(name, readings_at(q, p_M, approach=approach, time_s=time_s, covariance_M=covariance_M))

    return RunFile.create(folder, profile, fill)


def discovered(folder, plan, effects, **seeds):
    with measured_run(folder, plan, effects, **seeds) as run:
        found = calibrated_and_searched(run)
        calibrated = sure(read_results(run).calibrate)
        return calibrated, found.arms, json.loads(with_effects(calibrated, discover_result(found)).to_json())


def names(discovery):
    return {term.slug for term in discovery.terms}


@pytest.mark.parametrize("most", [pytest.param(400, marks=pytest.mark.slow), 100])
def test_an_effect_that_makes_held_out_errors_larger_is_left_out_and_said(tmp_path, plan, monkeypatch, most):
    """The approach of the held-out stops is recorded with the wrong sign: the backlash of the others then does harm,
    also where a part of the readings was searched."""
    monkeypatch.setattr(discover, "_MOST_SEARCHED", most)
    with measured_run(tmp_path / "run", plan, {"left": {"backlash": {"play": PLAY}}}) as run:
        calibrate_run(run)
        model, readings = CellModel.load(run.folder / CALIBRATION_FILE).arms["left"], run.readings("left")
        as_recorded = discover_arm(ArmReadings.alone(run.profile, "left", model, readings))
        approach = readings.approach.copy()
        approach[readings.in_split("validate")] *= -1
        found = discover_arm(ArmReadings.alone(run.profile, "left", model, replace(readings, approach=approach)))
    assert names(as_recorded) == {"backlash"}
    assert found.terms == ()
    assert found.result.accepted == ()
    assert found.model.effects == ()
    assert found.result.heldout_mm.after == pytest.approx(found.result.heldout_mm.before)
    assert found.result.verdict == "unknown effect"
    assert "backlash" in found.result.sentence
    assert "made held-out errors larger" in found.result.sentence
    assert any("dropped in review: backlash" in step.what for step in found.result.steps)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_nothing_is_named_in_a_cell_without_effects(tmp_path, plan, seed):
    _, found, _ = discovered(tmp_path / "run", plan, {}, seed=seed, noise_seed=seed)
    for discovery in found.values():
        assert names(discovery) == set()
        assert discovery.result.verdict == "nothing missing"
        assert max(discovery.result.candidates.values()) < 0.5
        assert {test.against for test in sure(discovery.result.structure).tests} > {"joints", "approach", "position"}
        assert discovery.result.heldout_mm.after == pytest.approx(discovery.result.noise_floor_mm, rel=0.25)


@pytest.mark.parametrize("seed", [7, pytest.param(30, marks=pytest.mark.slow)])
def test_hidden_effects_are_named_and_measured(tmp_path, plan, seed):
    effects = {
        "left": {"joint_compliance": {"stiffness": STIFFNESS}, "encoder_eccentricity": ECCENTRIC},
        "right": {"backlash": {"play": PLAY}},
    }
    calibration, found, stored = discovered(tmp_path / "run", plan, effects, seed=seed, noise_seed=seed)
    left, right = found["left"], found["right"]
    assert names(left) == {"joint_compliance", "encoder_eccentricity"}
    assert names(right) == {"backlash"}
    truths = {
        "compliance2": 1.0 / STIFFNESS[1],
        "compliance3": 1.0 / STIFFNESS[2],
        "half_play1": 0.5 * PLAY[0],
        "half_play2": 0.5 * PLAY[1],
        "half_play3": 0.5 * PLAY[2],
    }
    for discovery in (left, right):
        assert discovery.result.verdict == "explained"
        assert discovery.result.heldout_mm.after < 1.2 * discovery.result.noise_floor_mm
        assert discovery.result.heldout_mm.after < 0.4 * discovery.result.heldout_mm.before
        for finding, term in zip(discovery.result.accepted, discovery.terms, strict=True):
            assert finding.evidence.corrected_p < 0.01
            assert finding.posterior == discovery.result.candidates[finding.effect] > 0.9
            assert finding.evidence.heldout_mm.after < finding.evidence.heldout_mm.before
            for name, value, error in zip(term.names, term.values, term.standard_errors, strict=True):
                if name in truths:
                    assert abs(value - truths.pop(name)) < 4.0 * error
    assert truths == {}
    amplitude = {n: v for term in left.terms for n, v in zip(term.names, term.values, strict=True)}
    assert np.hypot(amplitude["cos1q1"], amplitude["sin1q1"]) == pytest.approx(2.0e-6 / 0.025, rel=0.1)
    for name, discovery in found.items():
        shown = stored["arms"][name]["validate"]
        assert shown["effects"]["position_mm"]["rms"] == pytest.approx(discovery.result.heldout_mm.after)
        assert shown["effects"]["position_mm"]["mean"] < shown["geometry"]["position_mm"]["mean"]
        assert calibration.arms[name].best_stage == "geometry"
        assert {term.slug for term in discovery.model.effects} == names(discovery)


def blind(plan, effects, seed, noise=None, stops=FEW, **watched):
    """Discovery in the left arm of a cell whose data have all factors, from the first ``stops`` of a plan."""
    profile = with_hidden(load_profile(ROOT / "profiles" / "twin.yaml"), {"left": effects}, seed)
    readings = blind_readings(profile, {name: q[:stops] for name, q in plan.items()}, seed, noise)
    models = {name: calibrate_arm(profile, name, readings[name])[0].model for name in profile.arms}
    return discover_arm(ArmReadings.of_cell(profile, models, readings)["left"], **watched)


def drawn(slug, seed):
    """Parameters of a hidden effect at a realistic size for the left arm."""
    arms = load_profile(ROOT / "profiles" / "twin.yaml").arms
    return suggest(slug, np.random.default_rng(seed), plant_arm("left", arms["left"], {}))


VISIBLE = ["payload_compliance", "friction_windup", "joint_axis_wobble", "thermal_growth", "base_step", "target_slip"]
"""One of each kind: of loads, sides of approach, angles, air, time, and what sits at the flange."""
ALSO_VISIBLE = [
    "joint_compliance", "link_bending", "transmission_error", "unsettled_measurement", "joint_drift", "base_drift",
    "pedestal_compliance", "pedestal_coupling",
]  # fmt: skip


@pytest.mark.parametrize("slug", [*VISIBLE, *(pytest.param(one, marks=pytest.mark.slow) for one in ALSO_VISIBLE)])
def test_every_effect_with_a_visible_size_is_named(plan, slug):
    found = blind(plan, {slug: drawn(slug, 21)}, seed=21, stops=None if slug == "transmission_error" else FEW)
    assert names(found) == {slug}
    assert found.result.verdict in ("explained", "ambiguous")
    # a free curve of 40 cycles has some hundred coefficients, which three hundred readings leave uncertain
    dense = any(term.law.name == "curve" for term in found.terms)
    assert found.result.heldout_mm.after < (1.4 if dense else 1.15) * found.result.noise_floor_mm
    assert found.result.steps[0].heldout_mm == found.result.heldout_mm.before > found.result.heldout_mm.after
    assert "readings searched" in found.result.steps[0].what, "it is not the geometry that was calibrated"


@pytest.mark.parametrize(
    "noise", [TrialNoise("heavy"), TrialNoise(repeatability=8e-6)], ids=["heavy tails", "repeatability"]
)
def test_noise_other_than_stated_is_not_named_as_an_effect(plan, noise):
    found = blind(plan, {}, 31, noise)
    assert names(found) == set()
    assert found.result.verdict == "nothing missing"


@pytest.mark.parametrize(
    ("slug", "channel", "variables"),
    [
        # crosstalk of joint 5 into joint 4 is not outside: their axes meet at right angles, so it is the same motion as
        # a tilt of joint 5's axis that depends on q5, a law of joint_axis_wobble
        ("tool_sag", "tool", {"q5"}),
        ("wrist_cable", "joint 6", {"q4"}),
        pytest.param("dress_pack", "joint 1", {"q1", "q2"}, marks=pytest.mark.slow),
        ("draught", "tracker azimuth", {"time"}),
    ],
)
def test_an_effect_outside_the_library_is_called_unknown_and_described(plan, slug, channel, variables):
    found = blind(plan, {slug: drawn(slug, 5)}, seed=5, stops=FEW if len(variables) == 1 else None)
    assert found.result.verdict == "unknown effect"
    assert names(found) == {"unknown"}
    description = found.result.accepted[0].description
    assert description.channel == channel
    assert set(description.variables) == variables
    assert channel in found.result.sentence
    assert found.result.heldout_mm.after < 1.15 * found.result.noise_floor_mm
    # it is part of the model from then on, as a data-driven term
    assert found.model.effects[0].note == description.sentence
    text = CellModel(arms={"left": found.model}).to_json()
    back = CellModel.from_json(text).arms["left"]
    q = plan["left"][:5]
    conditions = MeasurementConditions(time_s=np.full(5, 9000.0))
    np.testing.assert_array_equal(back.predict(q, conditions=conditions), found.model.predict(q, conditions=conditions))


def test_look_alikes_that_the_data_cannot_distinguish_are_an_answer_set(plan):
    # all last steps have one size: an error behind the last motion may be either
    profile = with_hidden(load_profile(ROOT / "profiles" / "twin.yaml"), {"left": {}}, 3)
    readings = blind_readings(profile, plan, 3)["left"]
    offset = readings.approach * 1.2e-4
    plant = build_plant(profile)
    points, covariance = plant.measure_positions(
        plant.smr_positions("left", readings.q - offset), np.random.default_rng(3)
    )
    tied = replace(
        readings,
        p_M=points,
        covariance_M=covariance,
        step=0.3 * readings.approach.astype(np.float64),
        dwell_s=np.full(len(readings), 2.0),
    )
    model = calibrate_arm(profile, "left", tied)[0].model
    found = discover_arm(ArmReadings.alone(profile, "left", model, tied))
    assert found.result.verdict == "ambiguous"
    answers = set(found.result.accepted[0].answer_set)
    assert {"backlash", "unsettled_measurement"} <= answers
    # they share the probability
    shares = [found.result.candidates[slug] for slug in answers]
    assert max(shares) < 0.6
    assert min(shares) == pytest.approx(max(shares), abs=0.05)
    assert sum(found.result.candidates.values()) == pytest.approx(1.0, abs=0.1)


def test_effects_that_the_data_cannot_show_are_listed(plan):
    found = blind(plan, {}, seed=2)
    invisible = {entry.effect: entry for entry in found.result.invisible}
    assert "tracker_scale" in invisible
    seen = {entry.effect: entry for entry in found.result.not_found}
    smallest_mm, visible = seen["backlash"].smallest_seen_rms_mm, seen["pedestal_coupling"].visible_share
    assert sure(smallest_mm) < 0.02
    assert sure(visible) > 0.9
    assert set(invisible) | set(seen) == set(EFFECTS) - {"unknown"}


@pytest.mark.slow
def test_a_real_arm_hides_a_periodic_error_of_its_joints(tmp_path):
    profile = without_network(load_profile(ROOT / "profiles" / "ur10-real.yaml"))
    with import_csv(profile, ROOT / "tests" / "fixtures" / "ur10-real" / "readings.csv", tmp_path / "run") as run:
        discovery = calibrated_and_searched(run).arms["left"]
        inside = np.median(run.readings("left").q, axis=0)[None]
    invisible = {entry.effect: entry for entry in discovery.result.invisible}
    for slug in ("backlash", "friction_windup", "base_step", "payload_compliance"):
        assert invisible[slug].reason.startswith("not testable: ")
        assert invisible[slug].smallest_seen is None
    periodic = next(one for one in discovery.result.accepted if one.effect == "transmission_error")
    assert periodic.law.name == "curve"
    assert {1, 2, 3, 4, 5} <= set(periodic.where.joints)
    assert discovery.result.heldout_mm.after < 0.4 * discovery.result.heldout_mm.before
    # what is left is five times the tracker's noise, so the verdict must not be "explained"
    assert discovery.result.verdict == "unknown effect"
    # beyond the trained range the uncertainty grows
    outside = inside.copy()
    outside[0, 1] = 0.0  # joint 2 was trained from -186 to -90 degrees
    assert discovery.model.uncertainty(outside)[0] > 2.0 * discovery.model.uncertainty(inside)[0]


def test_a_search_ends_on_request_before_the_alternatives_of_the_next_effect(plan):
    cancel, said = JobToken(), []

    def report(done, words):
        said.append(words)
        if words == "review and alternatives":
            cancel.cancel()

    with pytest.raises(Cancelled):
        blind(plan, {"joint_compliance": drawn("joint_compliance", 21)}, 21, steps=JobSteps(report, cancel))
    assert said[-1] == "review and alternatives"


# -- Discovery in positions and orientations: the last joint shows, bounds hold, commands put the flange right ---------

SIGMA_M, SIGMA_RAD = 3e-5, 6e-5
LAST_RAD = 3e-4
SOFT = 1e-6
"""Compliance of a pedestal [rad/Nm]: 0.1 mrad under the arm's own weight."""


def turned_arm(n, seed):
    """An arm whose last joint errs twice a turn, with the probe's origin on its axis: points see nothing of it."""
    rng = np.random.default_rng(seed)
    nominal = nominal_arm(twin().arms["left"])
    T_M_B = np.eye(4)
    T_M_B[:3, 3] = [2.5, 0.5, 0.2]
    geometry = true_geometry(nominal.with_T_M_B(T_M_B), rng)
    geometry = replace(geometry, tool=np.array([0.0, 0.0, 0.1]), probe=np.array([0.1, 0.5, -2.0]))
    q = rng.uniform(-2.5, 2.5, (n, 6))
    true = q.copy()
    true[:, 5] += LAST_RAD * np.sin(2.0 * q[:, 5])
    return geometry, q, true, rng


def readings_of(geometry, q, true, rng):
    n = len(q)
    none = smr_positions(geometry, true, np.tile(np.eye(3), (n, 1, 1)))  # rotation vectors of the orientations
    R_M_S = Rotation.from_rotvec(SIGMA_RAD * rng.standard_normal((n, 3))) * Rotation.from_rotvec(none)
    p_M, quaternion_M = smr_positions(geometry, true) + SIGMA_M * rng.standard_normal((n, 3)), R_M_S.as_quat()
    angular = {"quaternion_M": np.roll(quaternion_M, 1, axis=1), "sigma_rad": SIGMA_RAD}
    return readings_at(q, p_M, sigma_m=SIGMA_M, split=3, **angular)


@pytest.fixture(scope="module")
def both():
    """The arm, its readings, and discovery in them with and without their orientations."""
    geometry, q, true, rng = turned_arm(180, 1)
    readings = readings_of(geometry, q, true, rng)
    profile = twin()
    profile = altered(profile, discovery={"null_simulations": 100, "network": "never"})
    found = {}
    for name, its in (("both", readings), ("points", replace(readings, quaternion_M=None, sigma_rad=None))):
        arm, _ = calibrate_arm(profile, "left", its)
        found[name] = discover_arm(ArmReadings.alone(profile, "left", arm.model, its))
    return readings, found


def last_joint(discovery):
    return [one.effect for one in discovery.result.accepted if "joint 6" in str(one.where)]


def test_the_last_joint_shows_by_orientation_only(both):
    _, found = both
    assert last_joint(found["both"]) == ["transmission_error"]
    assert not last_joint(found["points"])
    (term,) = found["both"].terms
    largest = np.abs(term.values).max()
    assert largest == pytest.approx(LAST_RAD, rel=0.1)
    errors = found["both"].result.heldout_orientation_mrad
    assert errors.before.mean > 1.3 * errors.after.mean
    assert found["points"].result.heldout_orientation_mrad is None


def test_stated_intervals_of_orientations_hold(both):
    readings, found = both
    its = measured_quantities(readings, measurement_conditions(readings))
    model, rows = found["both"].model, sure(its.angular) & np.isin(its.reading, readings.in_split("validate"))
    left = its.readings.p_M - model.predict(its.readings.q, conditions=its.conditions)
    sd = model.measured_uncertainty(its.readings.q, its.conditions)
    assert 0.90 < np.mean(np.abs(left[rows]) < 1.96 * sd[rows, None]) < 0.99
    assert sure(model.posterior).noise.rad == pytest.approx(SIGMA_RAD, rel=0.15)


def test_commands_put_the_flange_where_base_and_links_turn_it(both):
    """A model with a soft pedestal is inverted: position and orientation are then both as wanted."""
    law = EFFECTS["pedestal_compliance"].law("isotropic")
    tilting = effect_term("pedestal_compliance", {"pedestal_tilt": SOFT}, "rad/Nm", law=law)
    found = both[1]["both"].model
    model = replace(found, effects=(*found.effects, tilting))
    q = np.random.default_rng(5).uniform(-1.5, 1.5, (5, 6))
    stiff = flange_poses(model.geometry, model.true_joints(q))[0]
    wanted_M, (wanted_R, _) = model.predict(q), model.flange(q)
    assert np.linalg.norm(rotation_vectors(stiff.swapaxes(1, 2) @ wanted_R), axis=1).max() > 2e-5
    back = invert(model, wanted_M, wanted_R, q + 0.02)
    assert back.reached.all()
    np.testing.assert_allclose(model.predict(back.q), wanted_M, atol=1e-6)
    off = rotation_vectors(model.flange(back.q)[0] @ wanted_R.swapaxes(1, 2))
    assert np.abs(off).max() < 1e-6


# -- More readings than are searched never make it worse, and a numerical failure is no finding ------------------------


SEARCHED, ROWS = 200, 320


@cache
def drawn_beyond():
    """A draw of a real UR10: its readings with splits."""
    series = load_entrant("D")
    readings = sample_rows(series, ROWS, 3).split(series.readings)
    arm, _ = calibrate_arm(series.profile, series.arm, readings)
    return ArmReadings.alone(series.profile, series.arm, arm.model, readings)


@cache
def searched() -> Searched:
    drawn = drawn_beyond()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(discover, "_MOST_SEARCHED", SEARCHED)
        return search_rows(drawn.take(drawn.readings.in_split("identify")))


def held_out() -> HeldOut:
    return HeldOut.of(drawn_beyond())


def test_rows_beyond_those_that_are_searched_lower_the_error():
    result = searched()
    assert has_smooth_terms(result.found.fit.terms)
    assert (result.only_some, len(result.search.data), result.fitted) == ("", SEARCHED, ROWS)
    of_search = Searched.of_search(result.search, result.data).model
    assert held_out().rms_mm(result.model) < held_out().rms_mm(of_search) < held_out().rms_mm(drawn_beyond().model)


@pytest.mark.slow
def test_where_the_fit_to_all_fails_the_model_of_the_search_is_in_force_and_said(monkeypatch):
    found = searched().search
    monkeypatch.setattr(discover, "_MOST_SEARCHED", SEARCHED)
    monkeypatch.setattr(discover, "search", lambda *_: found)
    monkeypatch.setattr(prior_fit, "_STEPS", 1)
    result = discover_arm(drawn_beyond()).result
    assert [one.effect for one in result.accepted] == [term.slug for term in found.fit.terms]
    assert result.heldout_mm.after < 0.5 * result.heldout_mm.before
    assert f"the model rests on {SEARCHED} of {ROWS} readings" in result.sentence
    assert "no finding" in result.sentence
    assert "measure more" not in result.sentence
    assert not any("fitted to all" in step.what for step in result.steps)


def test_a_fit_that_does_not_converge_is_an_error(monkeypatch):
    monkeypatch.setattr(prior_fit, "_STEPS", 1)
    result = searched()
    with pytest.raises(NotConverged, match="effects to all readings"):
        fit_to_all(result.search, result.data, result.search.threshold)


def test_held_out_readings_judge_the_whole_and_select_no_terms():
    """The last term of the model is spoilt: the geometry alone stays in force."""
    result, judge = searched(), held_out()
    terms = result.found.fit.terms
    spoilt = replace(
        result.model,
        effects=(*result.model.effects[:-1], replace(result.model.effects[-1], values=np.full(terms[-1].size, 5e-3))),
    )
    left = discover._judged_by_held_out(replace(result, model=spoilt, only_some="spoilt here"), judge)
    assert left.harmful == tuple(dict.fromkeys(term.slug for term in terms))
    assert not any((left.found.fit.terms, left.found.reviews, left.model.effects))
