"""A network from all readings in batches: used where it predicts left-out blocks of time better, and only there."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from cellapp.estimation.calibration import learning
from cellapp.estimation.calibration.learning import learn, require_learner
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Network
from cellapp.ground.progress import Cancelled, CancelToken
from cellapp.robot.model.model import network_from_json, network_to_json, rotate_about_z

BATCHES = Network(kind="batches", folds=3, iterations=40)
NOISE_M = 15e-6


def fine(q):
    """A residual [m] with a part of six cycles a turn: more than a committee of 1200 readings learns."""
    sag = 1e-4 * np.cos(q[:, 1]) + 2e-4 * np.sin(6.0 * q[:, 2]) * np.cos(q[:, 3])
    return rotate_about_z(np.stack([sag, 0.3 * sag, -sag], axis=1), q[:, 0])


def poses(n, seed=0):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (n, 4))


def noise(n, seed=1):
    return np.random.default_rng(seed).normal(0.0, NOISE_M, (n, 3))


@pytest.fixture(scope="module")
def trained():
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    q = poses(8_000)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(learning, "_FEWEST_STEPS", 500)
        return learn(BATCHES, q, fine(q) + noise(len(q)), np.arange(8_000.0), seed=3)


def rms(vectors):
    return np.sqrt(np.mean(np.sum(vectors**2, axis=1)))


def test_all_readings_show_what_a_sample_of_them_does_not(trained):
    assert trained.batches is not None
    assert trained.batches.used
    assert trained.batches.readings == 8_000
    assert trained.left_out_rms == trained.batches.left_out_rms < 0.5 * trained.batches.committee_rms
    new = poses(2000, seed=9)
    assert rms(fine(new) - trained.network.correct(new)) < 0.2 * rms(fine(new))
    assert rms(fine(new) - trained.network.correct(new)) < 2.0 * trained.left_out_rms


def test_the_stored_network_needs_no_torch(trained):
    stored = network_to_json(trained.network)
    again = network_from_json(stored)
    q = poses(50, seed=4)
    np.testing.assert_array_equal(again.correct(q), trained.network.correct(q))
    script = (
        "import sys, json, numpy as np\n"
        "sys.modules['torch'] = None\n"
        "from cellapp.robot.model.model import network_from_json\n"
        "print(np.abs(network_from_json(json.load(sys.stdin)).correct(np.ones((1, 4)))).max())\n"
    )
    said = subprocess.run(
        [sys.executable, "-c", script], input=json.dumps(stored), capture_output=True, text=True, check=True
    )
    assert float(said.stdout) == np.abs(trained.network.correct(np.ones((1, 4)))).max()


def test_noise_gets_no_network(monkeypatch):
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(learning, "_FEWEST_STEPS", 100)
    training = learn(BATCHES, poses(1500), noise(1500), np.arange(1500.0), seed=3)
    assert training.network is None
    assert training.batches is not None
    assert not training.batches.used


def test_the_committee_stays_where_batches_are_not_better(monkeypatch):
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(learning, "_FEWEST_STEPS", 20)
    monkeypatch.setattr(learning, "_MOST_STEPS", 20)
    q = poses(600)
    smooth = 3e-4 * np.stack([np.cos(q[:, 1]), np.sin(q[:, 2]), np.cos(q[:, 1])], axis=1) + noise(600)
    training = learn(BATCHES, q, smooth, np.arange(600.0), seed=3)
    assert training.batches is not None
    assert not training.batches.used
    assert training.network is not None
    assert training.left_out_rms < training.without_rms


def test_blocks_are_cut_by_time_and_not_by_the_order_of_rows(monkeypatch):
    """Residuals that belong to a block of time and to no posture: folds drawn by reading would learn them."""
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(learning, "_FEWEST_STEPS", 200)
    rng = np.random.default_rng(5)
    time_s = rng.permutation(2400).astype(float)
    block = (time_s // 100).astype(int)
    q = rng.normal(0.0, 1.0, (24, 4))[block] + rng.normal(0.0, 1e-3, (2400, 4))
    slow = rng.normal(0.0, 1e-4, (24, 3))[block]
    training = learn(BATCHES, q, slow, time_s, seed=3)
    assert training.batches is not None
    assert training.batches.left_out_rms > 0.7 * rms(slow)


def test_few_readings_are_left_to_the_committee():
    training = learn(BATCHES, poses(40), noise(40), np.arange(40.0), seed=3)
    assert training.batches is None


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"needs torch, which is not installed .*pip install 'cellapp\[learn\]'"):
        require_learner(BATCHES)
    require_learner(Network())


def test_training_ends_on_request():
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    cancel = CancelToken()

    def stop(_done, words):
        if "in batches" in words:
            cancel.cancel()

    with pytest.raises(Cancelled):
        learn(BATCHES, poses(300), noise(300), np.arange(300.0), seed=3, cancel=cancel, report=stop)
