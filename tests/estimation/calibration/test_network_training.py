"""Residual network: learns a smooth residual, rejects noise, and fades to zero outside the trained ranges."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest

from cellapp.estimation.calibration.learning import Perceptron, Shape, candidate_shapes, train_network
from cellapp.robot.model.model import network_from_json, network_to_json, rotate_about_z

SMALL = (Shape("sincos", 6), Shape("sincos", 6, rotates_with_joint_1=True))


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
    return q, train_network(q, bend(q) + noise, seed=3, shapes=SMALL, iterations=80)


def test_a_smooth_residual_is_learnt_from_200_poses(trained):
    _, training = trained
    new = poses(500, seed=9)
    before = np.linalg.norm(bend(new), axis=1).mean()
    after = np.linalg.norm(bend(new) - training.network.correct(new), axis=1).mean()
    assert after < 0.3 * before
    assert training.left_out_rms < 0.4 * training.without_rms
    assert training.shape.rotates_with_joint_1  # the residual of the fixture rotates with joint 1
    assert len(training.network.members) == 5


def test_pure_noise_gets_no_network():
    q = poses(200)
    training = train_network(
        q, np.random.default_rng(4).normal(0.0, 15e-6, (200, 3)), seed=3, shapes=SMALL, iterations=40
    )
    assert training.network is None
    assert training.left_out_rms > 0.95 * training.without_rms


def test_the_same_seed_gives_the_same_network(trained):
    q, training = trained
    noise = np.random.default_rng(1).normal(0.0, 15e-6, (200, 3))
    again = train_network(q, bend(q) + noise, seed=3, shapes=SMALL, iterations=80)
    assert again.network is not None
    assert json.dumps(network_to_json(again.network)) == json.dumps(network_to_json(training.network))


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
    training = train_network(q[~gap], bend(q[~gap]), seed=3, shapes=SMALL[1:], iterations=80)
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


def test_joints_that_do_not_matter_are_left_out(trained):
    """The fixture's residual depends on joints 1 to 3; the evidence removes the weights of the others."""
    _, training = trained
    q = poses(200, seed=11)
    moved = {joint: q.copy() for joint in (1, 5)}
    for joint, rows in moved.items():
        rows[:, joint] = poses(200, seed=12)[:, joint]
    change = {
        joint: np.abs(training.network.correct(rows) - training.network.correct(q)).mean()
        for joint, rows in moved.items()
    }
    assert change[5] < 0.05 * change[1]


def test_the_network_grows_with_the_readings_up_to_a_limit():
    hidden = [candidate_shapes(readings)[0].hidden for readings in (10, 60, 200, 300, 12_000, 1_000_000)]
    assert hidden == sorted(hidden)
    assert hidden[2] < hidden[3] < hidden[4] == hidden[5]


def test_many_readings_take_no_more_memory_than_their_sample():
    q = poses(12_000)
    tracemalloc.start()
    training = train_network(q, bend(q), seed=3, iterations=2)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 60e6
    assert training.network is not None
    np.testing.assert_array_equal(training.network.low, q.min(axis=0))


def test_normal_equations_are_those_of_automatic_derivatives():
    import torch  # an independent check of the closed form

    net, rng = Perceptron(12, 7, 3), np.random.default_rng(2)
    p, x, e = net.start(rng), rng.normal(size=(9, 12)), rng.normal(size=(9, 3))
    n_W = net.sizes[0]

    def outputs(parameters):
        W, V = parameters[:n_W].reshape(net.hidden, -1), parameters[n_W:].reshape(net.outputs, -1)
        ones = torch.ones(len(x), 1, dtype=torch.float64)
        hidden = torch.tanh(torch.cat([torch.from_numpy(x), ones], dim=1) @ W.T)
        return (torch.cat([hidden, ones], dim=1) @ V.T).reshape(-1)

    J = torch.autograd.functional.jacobian(outputs, torch.from_numpy(p)).numpy()
    gram, slope = net.normal_equations(p, x, e)
    np.testing.assert_allclose(gram, J.T @ J, atol=1e-12)
    np.testing.assert_allclose(slope, J.T @ e.ravel(), atol=1e-12)


# -- Perceptron: its normal equations against automatic derivatives, its layers against the network that uses them -----
