"""Perceptron: its normal equations against automatic derivatives, its layers against the network that uses them."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.calibration.learning import Perceptron
from cellapp.robot.model.model import ResidualNetwork, network_inputs

pytestmark = pytest.mark.fast

NETS = [Perceptron(12, 7, 3), Perceptron(7, 1, 3), Perceptron(2, 4, 1)]


def problem(net, rows=9):
    rng = np.random.default_rng(2)
    return net.start(rng), rng.normal(size=(rows, net.inputs)), rng.normal(size=(rows, net.outputs))


@pytest.mark.parametrize("net", NETS)
def test_normal_equations_are_those_of_the_numerical_jacobian(net):
    p, x, e = problem(net)
    step = 1e-6
    J = np.stack(
        [(net.predict(p + d, x) - net.predict(p - d, x)).ravel() / (2.0 * step) for d in step * np.eye(len(p))], axis=1
    )
    gram, slope = net.normal_equations(p, x, e)
    np.testing.assert_allclose(gram, J.T @ J, atol=1e-7)
    np.testing.assert_allclose(slope, J.T @ e.ravel(), atol=1e-7)
    np.testing.assert_array_equal(gram, gram.T)


def test_parameters_are_split_into_the_layers_of_a_network():
    net = Perceptron(12, 7, 3)
    p, _, _ = problem(net)
    q = np.random.default_rng(3).uniform(-2.0, 2.0, (5, 6))
    low, high = np.full(6, -3.0), np.full(6, 3.0)
    network = ResidualNetwork("sincos", low, high, high, False, 1e-3, (net.layers(p),))
    computed = net.predict(p, network_inputs("sincos", low, high, q))
    np.testing.assert_allclose(network.correct(q), 1e-3 * computed, rtol=1e-12)


def test_cosine_and_sine_of_a_joint_share_a_weight_decay():
    net = Perceptron(4, 2, 3)
    q = np.array([[0.3, 0.8]])
    at_0 = network_inputs("sincos", q[0], q[0], q)[0]
    assert at_0.tolist() == pytest.approx([np.cos(0.3), np.cos(0.8), np.sin(0.3), np.sin(0.8)])
    rest = [0] * net.sizes[1]
    assert net.decay_groups("sincos").tolist() == [1, 2, 1, 2, 0, 1, 2, 1, 2, 0, *rest]
    assert net.decay_groups("angles").tolist() == [1, 2, 3, 4, 0, 1, 2, 3, 4, 0, *rest]
