"""Conditions of blind trials, sizes of what is hidden, scores of probabilities and of second names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.trials.judge import TRIAL_RESULT, StoredTrial, judge_trials, score_run
from cellapp.commands.trials.judge_records import ArmFindings, DescribedTerm, NoiseLengths, ScoredRun
from cellapp.commands.trials.scoring import scores
from cellapp.commands.trials.sealed import ExpectedTerm, GroundTruth, HiddenLaw, open_truth, seal_trials
from cellapp.commands.trials.sealed_setup import EXPECTED, Setup
from cellapp.commands.trials.visible_size import beyond_law, registered_model
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.outcome import HeldOut
from cellapp.estimation.discovery.records import BeforeAfter
from cellapp.ground.errors import InputError
from cellapp.ground.executors import Work
from cellapp.ground.profile import Profile
from tests.twin import PROFILES, small_twin

SEED = 5


def twin(name: str = "twin") -> Profile:
    """A profile whose search sets its threshold from few simulations."""
    profile = load_profile(PROFILES / f"{name}.yaml")
    discovery = profile.discovery.model_copy(update={"null_simulations": 20})
    return profile.model_copy(update={"discovery": discovery})


# -- conditions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["twin", "twin-foreign"])
def test_narrow_ranges_are_10_to_50_degrees_wide(tmp_path: Path, profile: str) -> None:
    seal_trials(twin(profile), tmp_path / "t", 1, Setup(kind="none", ranges="narrow", stops=60), seed=SEED)
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        for name, arm in run.profile.arms.items():
            q = run.readings(name).q
            assert q.shape == (60, len(arm.type.joints))
            assert (np.degrees(np.ptp(q, axis=0)) < 50.0).all()
            assert (np.degrees(np.ptp(q, axis=0)) > 5.0).all()


def test_arms_of_other_makes_are_sealed_as_well(tmp_path: Path) -> None:
    seal_trials(twin("twin-foreign"), tmp_path / "t", 4, Setup(laws="other", stops=60), seed=SEED)
    assert {trial.arm for trial in open_truth(tmp_path / "t").trials} == {"elbow", "seven"}
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        assert run.readings("elbow").joints == 6
        assert run.readings("seven").joints == 7


def test_readings_state_nothing_where_they_shall_not(tmp_path: Path) -> None:
    kept = {}
    for stated in (True, False):
        setup = Setup(kind="none", stops=60, stated=stated)
        seal_trials(twin(), tmp_path / str(stated), 1, setup, seed=SEED)
        with RunFile.open(tmp_path / str(stated) / "run-0001") as run:
            kept[stated] = run.readings("left")
    assert kept[True].covariance_M is not None
    assert kept[False].covariance_M is None
    assert np.array_equal(kept[True].p_M, kept[False].p_M)
    noise_um = open_truth(tmp_path / "False").trials[0].noise_um["left"]
    assert noise_um == open_truth(tmp_path / "True").trials[0].noise_um["left"] > 20.0


def test_flipped_signs_are_those_of_the_way_back(tmp_path: Path) -> None:
    seal_trials(twin(), tmp_path / "t", 4, Setup(stops=60, flip_approach=True), seed=SEED)
    truth = open_truth(tmp_path / "t")
    assert {trial.effects[0].effect for trial in truth.trials} == {"backlash", "friction_windup"}
    assert {trial.kind for trial in truth.trials} == {"flipped"}
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        readings = run.readings("left")
        assert readings.step is None
        assert np.array_equal(readings.approach[1:], -np.sign(np.diff(readings.q, axis=0)))


def test_recordings_are_judged_by_stops_at_rest(tmp_path: Path) -> None:
    seal_trials(small_twin(60), tmp_path / "t", 1, Setup(kind="none", sweeps=1, stops=25), seed=SEED)
    (judged,) = judge_trials(tmp_path / "t", Work()).trials
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        stored = StoredTrial.model_validate_json(run.read_result(TRIAL_RESULT) or "")
        assert [len(run.readings("left").in_split(split)) for split in ("identify", "validate")] == [1, 24]
        floor_um = 1e3 * HeldOut.of(run.readings("left"), measurement_conditions(run.readings("left"))).noise_floor_mm()
    for name, arm in judged.arms.items():
        assert arm.names == ()
        assert arm.seconds > 0.0
        motion = stored.arms[name].discovery.motion
        assert motion is not None
        assert motion.effects == ()
        assert arm.heldout_um.after != pytest.approx(1e3 * motion.heldout_mm.after), "blocks of the recording"
    assert judged.arms["left"].noise_um.stated == pytest.approx(floor_um)


def test_splits_follow_the_number_of_stops() -> None:
    motion = Setup(sweeps=7).cell(twin())
    assert (motion.plan.stops, motion.splits.identify, int(motion.splits.validate_)) == (107, 7, 100)
    for stops in (40, 60, 150, 400):
        splits = Setup(stops=stops).cell(twin()).splits
        assert splits.identify + splits.train + int(splits.validate_) == stops
        assert min(splits.identify, splits.train, int(splits.validate_)) >= 10


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"laws": "odd"}, "--laws: 'odd' is not known; laws are same, other"),
        ({"ranges": "tiny"}, "--ranges: 'tiny' is not known; ranges are full, narrow"),
        ({"stops": 12}, "--stops: 12 are too few to identify the geometry; give 25 or more"),
        ({"mass_error": 1.0}, "--mass-error: 1 is not a share"),
        ({"flip_approach": True, "kind": "pair"}, "leave out --kind pair"),
        ({"sweeps": 5, "flip_approach": True}, "--sweeps: motion has no approach signs to flip"),
        ({"sweeps": 5, "ranges": "narrow"}, "--sweeps needs the full joint ranges"),
        ({"sweeps": 20, "stops": 29}, "--stops: 29 with 20 to sweep at leave too few to judge by; give 30 or more"),
    ],
)
def test_conditions_that_make_no_sense_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Setup(**changes).check()


# -- sizes ------------------------------------------------------------------------------------------------------------


def test_what_the_library_follows_is_not_beyond_its_law(tmp_path: Path) -> None:
    """The share beyond the law is small for laws of the same shape, and larger for others."""
    shares: dict[str, list[float]] = {}
    for laws in ("same", "other"):
        seal_trials(twin(), tmp_path / laws, 12, Setup(laws=laws, stops=60), seed=SEED)
        found = [effect for trial in open_truth(tmp_path / laws).trials for effect in trial.effects]
        smooth = [effect for effect in found if effect.effect not in ("transmission_error", "joint_axis_wobble")]
        shares[laws] = [effect.beyond_law_um / effect.visible_um for effect in smooth if effect.beyond_law_um]
        for effect in found:
            assert effect.beyond_law_um is None or effect.beyond_law_um <= effect.visible_um * (1.0 + 1e-9)
    assert np.median(shares["same"]) < 0.03
    assert np.median(shares["other"]) > 2.0 * np.median(shares["same"])


def test_a_displacement_by_a_column_is_within_its_law(tmp_path: Path) -> None:
    profile = twin()
    seal_trials(profile, tmp_path / "t", 1, Setup(kind="none", stops=60), seed=SEED)
    with RunFile.open(tmp_path / "t" / "run-0001") as run:
        readings = run.readings("left")
    model = registered_model(profile, "left", readings.q, readings.p_M)
    conditions = measurement_conditions(readings)
    drift = (readings.time_s / readings.time_s.max())[:, None] * np.array([5e-5, 0.0, 2e-5])
    left = beyond_law(model, "base_drift", readings.q, conditions, drift)
    assert left is not None
    assert np.abs(left).max() < 3e-7, "the last of the run is not exactly its end"
    assert beyond_law(model, "no such effect", readings.q, conditions, drift) is None


# -- scores -----------------------------------------------------------------------------------------------------------


def truth(kind: str, *slugs: str, visible_um: float = 100.0) -> GroundTruth:
    expected = EXPECTED[slugs[0]] if kind == "outside" else None
    return GroundTruth(
        run="run-0001",
        kind=kind,
        look_alikes=False,
        arm="left",
        effects=tuple(
            HiddenLaw(effect=slug, plant=slug, parameters={"law": "odd"}, raw_um=200.0, visible_um=visible_um)
            for slug in slugs
        ),
        expected=None if expected is None else ExpectedTerm(channel=expected[0], variables=expected[1]),
        noise_um={"left": 26.0},
        held_out_um={"left": 25.0},
        seeds={},
        readings="",
    )


def found(*accepted: str, **changes: Any) -> ArmFindings:
    values: dict[str, Any] = {
        "accepted": accepted,
        "answer_sets": tuple((slug,) for slug in accepted),
        "described": (),
        "verdict": "unknown effect" if "unknown" in accepted else "explained",
        "heldout_um": BeforeAfter(before=30.0, after=25.0),
        "noise_um": NoiseLengths(stated=None, drawn=25.0),
        "seconds": 1.0,
        "cpu_seconds": 0.9,
    }
    return ArmFindings(**{**values, **changes})


def term(channel: str, *variables: str, sentence: str = "") -> DescribedTerm:
    return DescribedTerm(channel=channel, variables=variables, sentence=sentence)


def judged(true: GroundTruth, arm: ArmFindings) -> ScoredRun:
    return score_run(true, {"left": arm})


@pytest.mark.parametrize(
    ("terms", "description"),
    [
        ((term("tracker radial", "range", "azimuth"),), "right"),
        ((term("base shift", "x", "y", "z"),), "right"),
        ((term("tracker", "position"),), "right"),
        ((term("base shift y", "elevation", sentence="a field over the position"),), "right"),
        ((term("base shift y", "elevation"),), "part"),
        ((term("joint 2", "range", "azimuth"),), ""),
        ((term("base shift", "time"),), ""),
        ((), ""),
    ],
)
def test_a_field_is_described_by_position(terms: tuple[DescribedTerm, ...], description: str) -> None:
    arm = found(*["unknown"] * len(terms), described=terms)
    assert judged(truth("outside", "workspace_field"), arm).description == description


@pytest.mark.parametrize(
    ("hidden", "arm", "second"),
    [
        (("backlash",), found("backlash"), []),
        (("backlash",), found("friction_windup"), []),
        (("backlash",), found("backlash", "friction_windup"), [("friction_windup", True)]),
        (("backlash",), found("backlash", "unknown", described=(term("joint 2", "step2"),)),
         [("joint 2: step2", True)]),
        (("backlash",), found("backlash", "base_step"), [("base_step", False)]),
        (("joint_compliance",), found("joint_compliance", "unknown", "unknown",
                                      described=(term("joint 3", "torque4", "q6"), term("base shift", "time"))),
         [("joint 3: torque4, q6", True), ("base shift: time", False)]),
        (("backlash", "base_step"), found("joint_drift", "base_step", "target_slip"), [("target_slip", True)]),
    ],
)  # fmt: skip
def test_second_names(hidden: tuple[str, ...], arm: ArmFindings, second: list[tuple[str, bool]]) -> None:
    run = judged(truth("pair" if len(hidden) > 1 else "one", *hidden), arm)
    assert [(one.name, one.same_cause) for one in run.second_names] == second


def test_a_law_outside_the_library_needs_one_description() -> None:
    crosstalk = truth("outside", "crosstalk")
    one = found("unknown", described=(term("joint 4", "q5"),))
    assert judged(crosstalk, one).second_names == ()
    two = found("unknown", "transmission_error", described=(term("joint 4", "q5"),))
    assert [(second.name, second.same_cause) for second in judged(crosstalk, two).second_names] == [
        ("transmission_error", True)
    ]


def test_flipped_signs_must_be_said() -> None:
    flipped = truth("flipped", "backlash")
    said = "joint 2 behaves like backlash of the opposite sign: check the approach convention"
    runs = [
        judged(flipped, found("unknown", described=(term("joint 2", "approach", sentence=said),))),
        judged(flipped, found(verdict="unknown effect", sentence=said)),
        judged(flipped, found(verdict="unknown effect", sentence="something is missing")),
        judged(flipped, found("backlash", sentence="explained")),
    ]
    result = scores(runs)
    (target,) = [one for one in result.targets if one.kind == "flipped"]
    assert (target.reached, target.n, target.met, target.missed) == (2, 4, False, False)
    assert [miss.verdict for miss in result.misses] == ["unknown effect", "explained"]


def test_brier_score_and_reliability() -> None:
    runs = [
        judged(truth("one", "backlash"), found("backlash", posteriors={"backlash": 0.9, "base_step": 0.3})),
        judged(truth("one", "backlash"), found("base_step", posteriors={"backlash": 0.2, "base_step": 0.7})),
        judged(
            truth("one", "base_drift", visible_um=1.0), found(posteriors={"base_drift": 0.1}, invisible=("backlash",))
        ),
        judged(truth("one", "backlash"), found("backlash")),  # nothing stated
    ]
    by_name = {score.about: score for score in scores(runs).posteriors}
    stated = by_name["effects with a stated probability"]
    assert stated.n == 4
    assert stated.brier == pytest.approx((0.1**2 + 0.3**2 + 0.8**2 + 0.7**2) / 4)
    assert [(one.n, one.true) for one in stated.bins] == [(0, None), (2, 0.5), (0, None), (1, 0.0), (1, 1.0)]
    accepted = by_name["accepted names"]
    assert accepted.n == 2
    assert accepted.brier == pytest.approx((0.1**2 + 0.7**2) / 2)
    every = by_name["every effect that the plan can show"]
    assert every.brier == pytest.approx(4 * stated.brier / every.n), "what is not stated counts as stated with zero"
    targets = [target for target in scores(runs).targets if target.target.startswith("Brier")]
    assert {target.bar for target in targets} == {True}


def test_a_bar_counts_from_enough_trials() -> None:
    def missed(n: int) -> list[str]:
        runs = [judged(truth("one", "backlash"), found("friction_windup")) for _ in range(n)]
        return [target.target for target in scores(runs).missed]

    assert missed(33) == []
    assert missed(34) == ["visible: exactly its name"]
