"""Residual network: learns a smooth residual, rejects noise, and fades to zero outside the trained ranges."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from cellapp.estimation.calibration import network_training
from cellapp.estimation.calibration.network_training import NetForm, learn, require_learner, train_network
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Network
from cellapp.ground.progress import Cancelled, JobSteps, JobToken
from cellapp.robot.model.model import network_from_json, network_to_json, rotate_about_z
from tests.sure import sure

QUICK = Network(iterations=80)
SMALL = (NetForm("sincos", 6), NetForm("sincos", 6, rotates_with_joint_1=True))


def bend(q):
    """A smooth residual [m], a few tenths of a millimetre, that turns with the first joint."""
    sag = 3e-4 * np.cos(q[:, 1]) + 2e-4 * np.sin(q[:, 1] + q[:, 2])
    return rotate_about_z(np.stack([sag, 0.3 * sag, -sag], axis=1), q[:, 0])


def poses(n, seed=0):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (n, 6))


@pytest.fixture(scope="module")
def trained():
    q = poses(200)
    noise = np.random.default_rng(1).normal(0.0, 15e-6, (200, 3))
    return q, train_network(QUICK, q, bend(q) + noise, 3, shapes=SMALL)


def test_a_smooth_residual_is_learnt_from_200_poses(trained):
    _, training = trained
    new = poses(500, seed=9)
    before = np.linalg.norm(bend(new), axis=1).mean()
    after = np.linalg.norm(bend(new) - training.network.correct(new), axis=1).mean()
    assert after < 0.3 * before
    assert training.result.left_out_rms_mm < 0.4 * training.result.without_rms_mm
    assert training.shape.rotates_with_joint_1  # the residual of the fixture rotates with joint 1
    assert len(training.network.members) == 5


def test_pure_noise_gets_no_network():
    q = poses(200)
    noise = np.random.default_rng(4).normal(0.0, 15e-6, (200, 3))
    training = train_network(Network(iterations=40), q, noise, 3, shapes=SMALL)
    assert training.network is None
    found = training.result
    assert found.left_out_rms_mm > found.without_rms_mm, "a fold that ends the training is no judge of it"


def test_the_same_seed_gives_the_same_network(trained):
    q, training = trained
    noise = np.random.default_rng(1).normal(0.0, 15e-6, (200, 3))
    again = train_network(QUICK, q, bend(q) + noise, 3, shapes=SMALL)
    assert json.dumps(network_to_json(sure(again.network))) == json.dumps(network_to_json(training.network))


def test_beyond_the_trained_ranges_the_correction_fades_to_zero(trained):
    _, training = trained
    network = training.network
    q = poses(20, seed=5)
    for joint in range(6):
        edge = q.copy()
        edge[:, joint] = network.high[joint]
        far = q.copy()
        far[:, joint] = network.high[joint] + 1.001 * network.margin[joint]
        half = q.copy()
        half[:, joint] = network.high[joint] + 0.5 * network.margin[joint]
        assert np.abs(network.correct(far)).max() == 0.0
        assert np.abs(network.spread(far)).max() == 0.0
        assert np.abs(network.correct(half)).max() > 0.0
        just = edge.copy()
        just[:, joint] += 1e-9
        np.testing.assert_allclose(network.correct(just), network.correct(edge), atol=1e-9)


def test_the_spread_grows_where_data_are_missing(trained):
    q = poses(400)
    gap = (q[:, 1] > 0.2) & (q[:, 1] < 1.4)
    training = train_network(QUICK, q[~gap], bend(q[~gap]), 3, shapes=SMALL[1:])
    new = poses(500, seed=6)
    inside = (new[:, 1] > 0.4) & (new[:, 1] < 1.2)
    assert training.network is not None
    spread = np.linalg.norm(training.network.spread(new), axis=1)
    assert np.median(spread[inside]) > 1.2 * np.median(spread[~inside])
    # and it is of the size of the error it stands for
    q, training = trained
    off = np.linalg.norm(training.network.correct(new) - bend(new), axis=1)
    assert 0.3 < np.median(np.linalg.norm(training.network.spread(new), axis=1)) / np.median(off) < 6.0


def test_the_file_keeps_every_bit_and_needs_no_torch(trained):
    _, training = trained
    text = json.dumps(network_to_json(training.network))
    q = poses(7, seed=8)
    np.testing.assert_array_equal(network_from_json(json.loads(text)).correct(q), training.network.correct(q))
    program = (
        "import json, sys, numpy as np\n"
        "from cellapp.robot.model.model import network_from_json\n"
        "network = network_from_json(json.loads(sys.stdin.read()))\n"
        "print(network.correct(np.zeros((1, 6))).tolist(), 'torch' in sys.modules)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], input=text, capture_output=True, text=True, timeout=60, check=True
    )
    assert result.stdout.strip() == f"{training.network.correct(np.zeros((1, 6))).tolist()} False"


# -- A network from all readings in batches: used where it predicts left-out blocks of time better, and only there -----


BATCHES = Network(kind="batches", folds=3, iterations=40)
NOISE_M = 15e-6


def fine(q):
    """A residual [m] with a part of six cycles a turn: more than a committee of 1200 readings learns."""
    sag = 1e-4 * np.cos(q[:, 1]) + 2e-4 * np.sin(6.0 * q[:, 2]) * np.cos(q[:, 3])
    return rotate_about_z(np.stack([sag, 0.3 * sag, -sag], axis=1), q[:, 0])


def poses_in_batches(n, seed=0):
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (n, 4))


def noise(n, seed=1):
    return np.random.default_rng(seed).normal(0.0, NOISE_M, (n, 3))


@pytest.fixture(scope="module")
def trained_in_batches():
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    q = poses_in_batches(8_000)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(network_training, "_FEWEST_STEPS", 500)
        return learn(BATCHES, q, fine(q) + noise(len(q)), np.arange(8_000.0), seed=3)


def rms(vectors):
    return np.sqrt(np.mean(np.sum(vectors**2, axis=1)))


def test_all_readings_show_what_a_sample_of_them_does_not(trained_in_batches):
    found = trained_in_batches.result
    assert found.batches.used
    assert found.batches.readings == 8_000
    assert found.left_out_rms_mm == found.batches.left_out_rms_mm < 0.5 * found.batches.committee_rms_mm
    new = poses_in_batches(2000, seed=9)
    assert rms(fine(new) - trained_in_batches.network.correct(new)) < 0.2 * rms(fine(new))
    assert rms(fine(new) - trained_in_batches.network.correct(new)) < 2e-3 * found.left_out_rms_mm


def test_blocks_are_cut_by_time_and_not_by_the_order_of_rows(monkeypatch):
    """Residuals that belong to a block of time and to no posture: folds drawn by reading would learn them."""
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    monkeypatch.setattr(network_training, "_FEWEST_STEPS", 200)
    rng = np.random.default_rng(5)
    time_s = rng.permutation(2400).astype(float)
    block = (time_s // 100).astype(int)
    q = rng.normal(0.0, 1.0, (24, 4))[block] + rng.normal(0.0, 1e-3, (2400, 4))
    slow = rng.normal(0.0, 1e-4, (24, 3))[block]
    training = learn(BATCHES, q, slow, time_s, seed=3)
    assert sure(training.result.batches).left_out_rms_mm > 0.7e3 * rms(slow)


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"needs torch, which is not installed .*pip install 'cellapp\[learn\]'"):
        require_learner(BATCHES)
    require_learner(Network())


def test_training_ends_on_request():
    pytest.importorskip("torch", reason="torch, of the extra learn, is not installed")
    cancel = JobToken()

    def stop(_done, words):
        if "in batches" in words:
            cancel.cancel()

    with pytest.raises(Cancelled):
        learn(BATCHES, poses_in_batches(300), noise(300), np.arange(300.0), seed=3, steps=JobSteps(stop, cancel))
