"""The effect of a plug-in: discovery names it, tunes its constant, and reports it in its words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.commands.discover.tables import accepted_table
from cellapp.estimation.discovery.accepted import accepted_effect, contradictions
from cellapp.estimation.discovery.discover import discover_arm
from cellapp.estimation.discovery.outcome import Discovery
from cellapp.estimation.discovery.records import Contradiction, DiscoverResult, Noise, Place, TermDescription
from cellapp.estimation.discovery.verdict import remaining_structure
from cellapp.estimation.readings import Readings
from cellapp.robot.effects import EFFECTS, EffectTerm, term_from_json, term_to_json
from cellapp.robot.effects.data_driven import Quantity, Variable
from cellapp.robot.effects.effect import form_without_bounds
from cellapp.robot.effects.modulation import Modulation
from cellapp.robot.kinematics.chain import smr_positions
from cellapp.robot.model import ArmModel
from cellapp.robot.model.nominal import bodies_of, nominal_arm
from tests.arms import STATION
from tests.interfaces.plugins.installed import add_example, installed

TWIN = Path(__file__).parents[3] / "profiles" / "twin.yaml"
UP = STATION[:3, :3] @ np.array([0.0, 0.0, 1.0])
N = 240
HELD_OUT = 60
SIGMA_M = 10e-6
HOSE = "hose_pull"
TRUE_SLACK = 1.25
TRUE_PULL = np.array([3e-4, 4e-4, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture
def plugin(tmp_path: Path) -> Iterator[None]:
    """The example is installed."""
    with installed(add_example(tmp_path)):
        yield


@pytest.fixture
def discovery(plugin: None) -> Discovery:
    """What discovery finds in readings of an arm with a hose that pulls."""
    profile = load_profile(TWIN)
    few = profile.discovery.model_copy(update={"null_simulations": 60, "false_alarm": 0.02})
    profile = profile.model_copy(update={"discovery": few})
    arm = profile.arms["left"]
    geometry = nominal_arm(arm).with_T_M_B(STATION)
    model = ArmModel(geometry=geometry, nominal=geometry, bodies=bodies_of(arm), up_M=UP)
    rng = np.random.default_rng(5)
    q = rng.uniform(-2.5, 2.5, (N, 6))
    pull = -TRUE_PULL * np.sign(q) * np.maximum(np.abs(q) - TRUE_SLACK, 0.0)
    readings = Readings(
        configuration=np.arange(N, dtype=np.int64),
        time_s=np.full(N, np.nan),
        q=q,
        approach=np.zeros((N, 6), dtype=np.int8),
        p_M=smr_positions(geometry, q + pull) + rng.normal(0.0, SIGMA_M, (N, 3)),
        payload_kg=np.full(N, 2.0),
        sigma_m=np.full(N, SIGMA_M),
        split=("identify",) * (N - HELD_OUT) + ("validate",) * HELD_OUT,
    )
    return discover_arm(profile, "left", model, readings)


def test_discovery_names_a_new_effect_tunes_its_constant_and_reports_it(discovery: Discovery) -> None:
    ((accepted,), (term,)) = discovery.result.accepted, discovery.terms
    assert (accepted.effect, term.slug, accepted.where.joints) == (HOSE, HOSE, (1, 2))
    assert discovery.result.verdict == "explained"
    effect = EFFECTS[HOSE]
    slack = term.law.constants["slack"]
    nearest = min((0.6, 1.0, 1.6), key=lambda one: abs(one - TRUE_SLACK))
    assert abs(slack - TRUE_SLACK) < 0.02 < abs(nearest - TRUE_SLACK), "tuned off the grid"
    pulls = dict(zip(term.names, term.values.tolist(), strict=True))
    assert pulls["pull1"] == pytest.approx(TRUE_PULL[0], rel=0.05)
    assert pulls["pull2"] == pytest.approx(TRUE_PULL[1], rel=0.05)
    assert accepted.meaning is not None
    assert accepted.meaning.cause.startswith("The hose package at each of joints 1 and 2 is too short")
    table = accepted_table("left", discovery.result)
    titles = [column.title for column in table.columns]
    (row,) = (dict(zip(titles, row, strict=True)) for row in table.rows)
    assert row["effect"] == effect.title
    assert row["law"] == f"{effect.forms[0].words}, taut beyond {math.degrees(slack):.3g} deg"


def test_what_discovery_knows_about_its_findings_survives_json(discovery: Discovery) -> None:
    ((accepted,), (its,)) = discovery.result.accepted, discovery.terms
    structure = remaining_structure({"joints": 0.4, "order": 0.02}, chance=0.01)
    form = form_without_bounds(EFFECTS["backlash"], EFFECTS["backlash"].form("constant"))
    sentence = "behaves like backlash of the opposite sign at joint 2: check the approach convention"
    term = EffectTerm(
        "unknown", ("half_play2",), np.array([-4e-5]), np.array([1e-6]), ("rad",), form.law(), note=sentence
    )
    described = TermDescription(
        channel="joint 2",
        variables=("approach",),
        size_um=31.4,
        formula="",
        gain_over_curve=None,
        sentence=f"{sentence}; 31 µm rms at the SMR",
    )
    second = Place(joints=(2,), acts_on=("joint 2",))
    wrong = accepted_effect(term, second, accepted.evidence, 0.9, description=described)
    modulation = Modulation(its.law_names[0], Variable(Quantity.PAYLOAD), 1, low=0.5, high=5.0)
    free = replace(
        its,
        names=(*its.law_names, modulation.name),
        values=np.append(its.values[: len(its.law_names)], 1e-6),
        standard_errors=np.append(its.standard_errors[: len(its.law_names)], 1e-7),
        units=(*its.units[: len(its.law_names)], "rad"),
        modulations=(modulation,),
        law_misfit=0.12,
    )
    named = accepted_effect(free, accepted.where, accepted.evidence, 0.97)
    found = discovery.result.model_copy(
        update={
            "accepted": (named, wrong),
            "contradictions": contradictions((free, term), (named, wrong)),
            "noise_mm": Noise(rms=0.017, source="estimated"),
            "candidates": {HOSE: 0.97, "backlash": 0.01},
            "structure": structure,
        }
    )
    written = DiscoverResult(arms={"left": found}).to_json()
    arm = DiscoverResult.from_json(written, "here").arms["left"]
    assert (arm.accepted[0].posterior, arm.accepted[0].law_misfit) == (0.97, 0.12)
    assert tuple(arm.accepted[0].parameters) == its.law_names, "not those of the free part"
    assert arm.accepted[0].meaning is not None
    assert arm.accepted[0].meaning.check == EFFECTS[HOSE].meaning.at("each of joints 1 and 2").check
    assert (arm.noise_mm, arm.candidates) == (found.noise_mm, found.candidates)
    assert arm.structure == structure
    assert arm.contradictions == (Contradiction(effect="backlash", joints=(2,), size_um=31.4, sentence=sentence),)
    meaning = arm.accepted[1].meaning
    assert meaning is not None
    assert "Check the approach convention of the readings." in meaning.check
    assert "Measure 10 poses twice" in meaning.settle[0]
    uncertain = accepted_effect(free, accepted.where, accepted.evidence, math.nan)
    assert uncertain.posterior is None, "what was not computed is not claimed"


def a_term() -> EffectTerm:
    """A pull of joint 2."""
    law = EFFECTS[HOSE].law("own", {"slack": 1.0})
    return EffectTerm(HOSE, ("pull2",), np.array([3e-4]), np.array([1e-6]), ("rad/rad",), law)


@pytest.mark.fast
def test_an_effect_of_a_plugin_survives_json(plugin: None) -> None:
    term = a_term()
    again = term_from_json(term_to_json(term), EFFECTS)
    assert again.law == term.law
    np.testing.assert_array_equal(again.values, term.values)


@pytest.mark.fast
def test_a_term_of_a_plugin_that_was_removed_is_refused(tmp_path: Path) -> None:
    with installed(add_example(tmp_path)):
        content = term_to_json(a_term())
    assert HOSE not in EFFECTS
    with pytest.raises(ValueError, match="does not know the effect 'hose_pull'; if a plug-in has it, install that"):
        term_from_json(content, EFFECTS)
