"""A network beside the effects: trained where the profile asks, chosen by left-out folds, not by held-out readings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.commands.trials.blind import blind_readings, with_hidden
from cellapp.estimation.calibration.calibrate import calibrate_arm
from cellapp.estimation.calibration.quantities import measurement_conditions
from cellapp.estimation.discovery.discover import discover_arm, needs_network, with_network
from cellapp.ground.progress import CancelToken
from cellapp.robot.model.model import network_to_json

PROFILE = load_profile(Path(__file__).parents[3] / "profiles" / "twin.yaml")
COMPLIANT = {"left": {"joint_compliance": {"stiffness": [9.0e4, 6.0e4, 3.5e4, 1.2e4, 1.2e4, 1.2e4]}}}


def asking(network, kind="mlp"):
    return PROFILE.model_copy(
        update={
            "discovery": PROFILE.discovery.model_copy(update={"network": network}),
            "network": PROFILE.network.model_copy(update={"kind": kind}),
        }
    )


@pytest.fixture(scope="module")
def searched(plan):
    """The left arm with compliance: its readings, its calibrated model, and what discovery found."""
    profile = with_hidden(PROFILE.model_copy(update={"seed": 2}), COMPLIANT, 2)
    readings = blind_readings(profile, plan, 2)["left"]
    model = calibrate_arm(profile, "left", readings)[0].model
    discovery = discover_arm(profile, "left", model, readings)
    assert discovery.terms
    return profile, readings, model, discovery


def judged(discovery, verdict):
    return replace(discovery, result=discovery.result.model_copy(update={"verdict": verdict}))


def trained(searched, readings, verdict="explained", **changes):
    profile, _, model, discovery = searched
    discovery = replace(judged(discovery, verdict), **changes)
    return with_network(profile, model, discovery, readings, measurement_conditions(readings), CancelToken())


@pytest.mark.parametrize(
    ("network", "kind", "explained", "unknown"),
    [
        ("unknown", "mlp", False, True),
        ("always", "mlp", True, True),
        ("never", "mlp", False, False),
        ("always", "none", False, False),
    ],
)
def test_a_network_is_trained_where_the_profile_asks(searched, network, kind, explained, unknown):
    discovery, profile = searched[3], asking(network, kind)
    assert needs_network(profile, judged(discovery, "explained")) == explained
    assert needs_network(profile, judged(discovery, "unknown effect")) == unknown


def test_explained_effects_leave_nothing_to_a_network(searched):
    found = trained(searched, searched[1])
    assert found.result.network_mm.after < 0.01
    assert found.model.network is None


def test_a_network_models_what_has_no_name(searched):
    _, readings, model, discovery = searched
    # as if compliance had no name: the geometry alone stands for the accepted terms
    found = trained(searched, readings, verdict="unknown effect", model=model)
    assert found.model.network is not None
    assert found.result.heldout_mm.after < 0.8 * discovery.result.heldout_mm.before
    assert found.result.steps[-1].heldout_mm == found.result.heldout_mm.after
    assert trained(searched, readings, model=model).model.network is None  # explained: the effects are the model


def test_held_out_readings_do_not_choose_the_network(searched):
    _, readings, model, _ = searched
    p_M = readings.p_M.copy()
    rows = readings.in_split("validate")
    p_M[rows] += np.random.default_rng(1).normal(0.0, 5e-3, (len(rows), 3))
    found = [
        trained(searched, data, verdict="unknown effect", model=model)
        for data in (readings, replace(readings, p_M=p_M))
    ]
    texts = [json.dumps(network_to_json(one.model.network)) for one in found]
    assert texts[0] == texts[1]
