"""Perceptron with one hidden layer, and its least-squares normal equations in closed form.

    h = tanh(W a),  y = V b,  a = (x, 1),  b = (h, 1)

The derivative of output k by ``W[o, i]`` is ``V[k, o] (1 - h_o^2) a_i`` and by ``V[k, j]`` it is ``b_j``. All outputs
share ``(1 - h_o^2) a_i`` and ``b_j``; therefore one product over the rows gives the normal matrix of all outputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.network import Inputs, Layers

_BENT = 2.0
"""Scale of the first hidden signals. Errors of gears have many cycles a turn; from small weights, which bend the units
little, most iterations only make them grow."""


@dataclass(frozen=True)
class Perceptron:
    """Sizes of a perceptron; its parameters p are the rows of W, then those of V."""

    inputs: int
    hidden: int
    outputs: int

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of parameters in W and in V."""
        return self.hidden * (self.inputs + 1), self.outputs * (self.hidden + 1)

    def start(self, rng: np.random.Generator) -> Array:
        """Draw random parameters that give signals of scale ``_BENT`` to the hidden layer, about 1 to the outputs."""
        scales = np.repeat([_BENT * (self.inputs + 1) ** -0.5, (self.hidden + 1) ** -0.5], self.sizes)
        return np.asarray(rng.standard_normal(sum(self.sizes)) * scales)

    def predict(self, p: Array, x: Array) -> Array:
        """Compute the outputs (n, outputs) for rows ``x`` (n, inputs)."""
        W, V = self._matrices(p)
        return np.asarray(_with_one(np.tanh(_with_one(x) @ W.T)) @ V.T)

    def normal_equations(self, p: Array, x: Array, e: Array) -> tuple[Array, Array]:
        """Compute ``J^T J`` (P, P) and ``J^T e`` (P,): J is the Jacobian of the outputs at ``x`` (n, inputs), ``e`` the
        errors (n, outputs)."""
        W, V = self._matrices(p)
        a = _with_one(x)
        h = np.tanh(a @ W.T)
        b, slope, n_W = _with_one(h), 1.0 - h**2, W.size
        shared = np.concatenate([(slope[:, :, None] * a[:, None, :]).reshape(len(x), n_W), b], axis=1)
        product = shared.T @ shared
        to_outputs = V[:, :-1]
        gram = np.zeros((len(p), len(p)))
        W_by_W = product[:n_W, :n_W].reshape(self.hidden, a.shape[1], self.hidden, a.shape[1])
        gram[:n_W, :n_W] = (W_by_W * (to_outputs.T @ to_outputs)[:, None, :, None]).reshape(n_W, n_W)
        W_by_V = np.repeat(to_outputs.T, a.shape[1], axis=0)[:, :, None] * product[:n_W, None, n_W:]
        gram[:n_W, n_W:] = W_by_V.reshape(n_W, -1)
        gram[n_W:, :n_W] = gram[:n_W, n_W:].T
        gram[n_W:, n_W:] = np.kron(np.eye(self.outputs), product[n_W:, n_W:])
        return gram, np.concatenate([(((e @ to_outputs) * slope).T @ a).ravel(), (e.T @ b).ravel()])

    def layers(self, p: Array) -> Layers:
        """Return the weights and offsets of each layer."""
        return tuple((matrix[:, :-1].copy(), matrix[:, -1].copy()) for matrix in self._matrices(p))

    def decay_groups(self, kind: Inputs) -> Array:
        """Return the weight-decay group (P,) of each parameter: one for the inputs of each joint, one for the rest.

        The evidence then switches off joints that the residual does not depend on: automatic relevance determination
        (MacKay, ASHRAE Transactions 100 (1994) 1053; Neal, Bayesian Learning for Neural Networks, 1996).
        """
        joints = self.inputs // (2 if kind == "sincos" else 1)
        of_row = np.append(1 + np.arange(self.inputs) % joints, 0)  # the offset belongs to no joint
        return np.concatenate([np.tile(of_row, self.hidden), np.zeros(self.sizes[1], dtype=of_row.dtype)])

    def _matrices(self, p: Array) -> tuple[Array, Array]:
        n_W = self.sizes[0]
        return p[:n_W].reshape(self.hidden, -1), p[n_W:].reshape(self.outputs, -1)


def _with_one(rows: Array) -> Array:
    return np.concatenate([rows, np.ones((len(rows), 1))], axis=1)
