"""Training of the residual network by Levenberg-Marquardt, selected by cross-validation.

A few hundred configurations are few data. Therefore:

- The network is a committee with one member per fold. Each member is trained without its fold and stopped where it
  predicts that fold best (Krogh, Vedelsby, NIPS 7 (1995) 231).
- Weight decay follows from the evidence of the data during training (MacKay, Neural Computation 4 (1992) 415; Foresee,
  Hagan, ICNN 1997, 1930), with one decay for the inputs of each joint.
- The inputs and the frame of the output are selected by the error on the left-out folds.

The validation split is not used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count as count_from
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.progress import CancelToken, Report, ignore_report
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.network import Inputs, Layers, ResidualNetwork, network_inputs, rotate_about_z

# -- Perceptron with one hidden layer, and its least-squares normal equations in closed form --------------------------
#
#     h = tanh(W a),  y = V b,  a = (x, 1),  b = (h, 1)
#
# The derivative of output k by ``W[o, i]`` is ``V[k, o] (1 - h_o^2) a_i`` and by ``V[k, j]`` it is ``b_j``. All outputs
# share ``(1 - h_o^2) a_i`` and ``b_j``; therefore one product over the rows gives the normal matrix of all outputs.


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
        """Draw random parameters whose variance keeps the scale of the signal through the layers."""
        scales = np.repeat([(self.inputs + 1) ** -0.5, (self.hidden + 1) ** -0.5], self.sizes)
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


MARGIN = 0.1
"""Width over which the correction fades to zero outside the trained joint range, as a share of that range."""
WORTH = 0.98
"""Largest ratio of the rms errors on left-out folds, with and without a network, at which the network is used."""
_DAMPING = 1e-2
"""Initial damping, as a share of the diagonal of the Hessian."""
_DAMPING_LIMITS = (1e-9, 1e9)
_DAMPING_DOWN, _DAMPING_UP = 10.0, 5.0
"""Damping factors: divisor after a step that lowers the objective, multiplier after one that does not."""
_TRIES = 6
"""Maximum number of steps tried with one Jacobian: together they raise the damping by a factor of 15 000."""
_DECAY = 0.01
"""Initial weight decay, in units of the noise precision; the evidence adjusts it."""
_DECAY_LIMITS = (1e-6, 1e6)
_EVIDENCE_EVERY = 3
"""Iterations between two updates of the decay: the formula holds at a minimum, and costs an inverse."""
_IMPROVED = 0.998
"""Ratio to a member's best squared error on its fold below which an iteration counts as an improvement."""
_PATIENCE = 8
"""Number of iterations without improvement after which the training of a member ends."""
_SCREENING = 15
"""Number of iterations after which candidates are compared; only the best one is trained further."""
_REPORTED = 10
"""Iterations between two progress reports: a second or less."""


@dataclass(frozen=True)
class Shape:
    """A candidate network: inputs, size of the hidden layer, and whether its output frame rotates with joint 1."""

    inputs: Inputs
    hidden: int
    rotates_with_joint_1: bool = False


_READINGS_A_UNIT = 16
"""Readings per hidden unit: an arm of 6 joints then has 3 measured coordinates for each parameter."""
_FEWEST_UNITS, _MOST_UNITS = 10, 20
"""Limits of the hidden layer. Fewer units do worse even from 50 readings; more are not worth their cubic time."""
_MOST_READINGS = 1200
"""Maximum number of readings to train on. Twice as many lower the held-out error by some 6 % and double the time."""
_CANDIDATES = 3
"""Number of shapes that ``candidate_shapes`` returns."""


def candidate_shapes(readings: int) -> tuple[Shape, ...]:
    """Return the candidate shapes for a number of readings.

    The output is in a frame that rotates with joint 1, or in one that does not. Angles as inputs suit errors that grow
    along the range of a joint, for example by play: a joint at the upper end of its range most often came from below.
    """
    hidden = int(np.clip(readings // _READINGS_A_UNIT, _FEWEST_UNITS, _MOST_UNITS))
    return (
        Shape("sincos", hidden, rotates_with_joint_1=True),
        Shape("sincos", hidden),
        Shape("angles", hidden, rotates_with_joint_1=True),
    )


@dataclass(frozen=True)
class Training:
    """Result of training.

    Attributes
    ----------
    network : ResidualNetwork or None
        None if no candidate predicts left-out folds clearly better than no network (``WORTH``).
    shape : Shape
        The best candidate.
    left_out_rms, without_rms : float
        Rms length of the residual on left-out folds, with the best candidate and without a network [m].
    tried : tuple
        (shape, left-out rms [m]) of every candidate at the time of the comparison.
    batches : Batches or None
        Comparison with a training from all readings; None if none was requested.
    """

    network: ResidualNetwork | None
    shape: Shape
    left_out_rms: float
    without_rms: float
    tried: tuple[tuple[Shape, float], ...]
    batches: Batches | None = None


@dataclass(frozen=True)
class Batches:
    """Comparison of a network trained in batches from all readings with the committee, on the same left-out blocks.

    Attributes
    ----------
    used : bool
        Whether it replaces the committee.
    readings, blocks : int
        Number of readings that it learnt from, and of blocks of time that they were cut into.
    hidden : tuple of int
    device : str
        Device that trained it.
    left_out_rms, committee_rms : float
        Rms length of the residual on left-out blocks of all readings [m], of the batches and of the committee; the
        latter is without a network if the committee is not better than none.
    sigmas : float
        Decrease of the mean square from the committee's, in standard errors over the blocks.
    """

    used: bool
    readings: int
    blocks: int
    hidden: tuple[int, ...]
    device: str
    left_out_rms: float
    committee_rms: float
    sigmas: float


def train_network(
    q: Array,
    residual: Array,
    *,
    seed: int,
    folds: int = 5,
    iterations: int = 150,
    shapes: Sequence[Shape] | None = None,
    fold: NDArray[np.int64] | None = None,
    cancel: CancelToken | None = None,
    report: Report = ignore_report,
) -> Training:
    """Train a residual network on at most ``_MOST_READINGS`` readings; draw them by ``seed`` if there are more.

    Parameters
    ----------
    q : array, shape (n, N)
        Joint positions [rad].
    residual : array, shape (n, 3)
        Measured minus computed positions in the frame of the correction, the base frame [m].
    seed : int
    folds : int
        Number of folds and of members.
    iterations : int
        Maximum number of iterations of a member.
    shapes : sequence of Shape, optional
        Candidates; the default depends on the number of readings.
    fold : array of int, shape (n,), optional
        Fold of each reading; drawn by ``seed`` if not given.
    cancel : CancelToken, optional
    report : callable
        Callback that takes the number of steps done, of ``training_steps(len(shapes))``, and a text.
    """
    cancel = cancel or CancelToken()
    shapes = candidate_shapes(len(q)) if shapes is None else shapes
    low, high = q.min(axis=0), q.max(axis=0)
    if len(q) > _MOST_READINGS:
        sample = np.random.default_rng([seed, 0x5A3]).permutation(len(q))[:_MOST_READINGS]
        q, residual, fold = q[sample], residual[sample], None if fold is None else fold[sample]
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    fold = np.random.default_rng([seed, 0xF01D]).permutation(len(q)) % folds if fold is None else fold
    outputs = {False: residual / scale, True: rotate_about_z(residual / scale, -q[:, 0])}
    inputs = {kind: network_inputs(kind, low, high, q) for kind in {shape.inputs for shape in shapes}}
    candidates = [
        (shape, _train_committee(inputs[shape.inputs], outputs[shape.rotates_with_joint_1], fold, shape, seed, cancel))
        for shape in shapes
    ]
    shape, committee, screened = _train_best(candidates, iterations, report)
    without = float(np.sqrt(np.mean(np.sum((residual / scale) ** 2, axis=1))))
    margin = MARGIN * np.maximum(high - low, 1e-3)
    members = tuple(committee.net.layers(p) for p in committee.members)
    network = ResidualNetwork(shape.inputs, low, high, margin, shape.rotates_with_joint_1, scale, members)
    return Training(
        network=network if committee.left_out < WORTH * without else None,
        shape=shape,
        left_out_rms=committee.left_out * scale,
        without_rms=without * scale,
        tried=tuple((tried, error * scale) for tried, error in screened),
    )


def training_steps(shapes: int = _CANDIDATES) -> int:
    """Return the number of steps that a training reports: one for each candidate, one for the best."""
    return shapes + 1


def _train_best(
    candidates: Sequence[tuple[Shape, Iterator[_Committee]]], iterations: int, report: Report
) -> tuple[Shape, _Committee, list[tuple[Shape, float]]]:
    """Train all candidates for some iterations and the best one to the end; return it with all errors when compared."""
    compared: list[tuple[_Committee, Shape, Iterator[_Committee]]] = []
    for number, (shape, training) in enumerate(candidates):
        for committee in islice(training, min(_SCREENING, iterations)):
            if committee.iteration % _REPORTED == 1:
                report(number, f"network {number + 1} of {len(candidates)}, {_training_words(committee)}")
        compared.append((committee, shape, training))
    committee, shape, training = min(compared, key=lambda entry: entry[0].left_out)
    while committee.iteration < iterations and (later := next(training, None)) is not None:
        committee = later
        if committee.iteration % _REPORTED == 1:
            report(len(candidates), f"best network, {_training_words(committee)}")
    report(len(candidates) + 1, "network trained")
    return shape, committee, [(tried, screened.left_out) for screened, tried, _ in compared]


def _training_words(committee: _Committee) -> str:
    return f"{len(committee.members)} folds, iteration {committee.iteration}"


@dataclass(frozen=True)
class _Committee:
    """Members after an iteration: the parameters of each that predicted its fold best, and the rms over all folds."""

    net: Perceptron
    members: tuple[Array, ...]
    left_out: float
    iteration: int


def _train_committee(
    x: Array, y: Array, fold: NDArray[np.int64], shape: Shape, seed: int, cancel: CancelToken
) -> Iterator[_Committee]:
    """Train one member per fold; yield the committee after each iteration until no member improves any more."""
    net = Perceptron(x.shape[1], shape.hidden, y.shape[1])
    groups = net.decay_groups(shape.inputs)
    rng = np.random.default_rng(seed)
    numbers = range(int(fold.max()) + 1)
    members = [_Member(net, x[fold != k], y[fold != k], groups, net.start(rng)) for k in numbers]
    left_out = [(x[fold == k], y[fold == k]) for k in numbers]
    best = [member.p for member in members]
    error = [_squares(net, *left_out[k], best[k]) for k in numbers]
    stale = [0 for _ in numbers]
    for iteration in count_from(1):
        for k in numbers:
            if stale[k] >= _PATIENCE:
                continue
            cancel.check()
            members[k].step(with_evidence=iteration % _EVIDENCE_EVERY == 1)
            now = _squares(net, *left_out[k], members[k].p)
            stale[k] = 0 if now < _IMPROVED * error[k] else stale[k] + 1
            if now < error[k]:
                best[k], error[k] = members[k].p, now
        yield _Committee(net, tuple(best), float(np.sqrt(sum(error) / len(x))), iteration)
        if min(stale) >= _PATIENCE:
            return


def _squares(net: Perceptron, x: Array, y: Array, p: Array) -> float:
    return float(np.sum((y - net.predict(p, x)) ** 2))


class _Member:
    """Member in training, which minimises ``beta sum e^2 + sum alpha_g p^2`` over its rows.

    Attributes
    ----------
    p : array, shape (P,)
        Parameters.
    """

    def __init__(self, net: Perceptron, x: Array, y: Array, groups: Array, p: Array) -> None:
        self.p = p
        self._net, self._x, self._y, self._groups = net, x, y, groups
        self._counts = np.bincount(groups)
        self._alpha = np.full(len(self._counts), _DECAY)  # precision of each group of parameters
        self._beta = 1.0  # precision of the noise
        self._damping = _DAMPING
        self._e = y - net.predict(p, x)
        self._gram, self._slope = net.normal_equations(p, x, self._e)

    def step(self, *, with_evidence: bool) -> None:
        """Take the first damped step that lowers the objective; none if ``_TRIES`` steps fail."""
        decay = self._alpha[self._groups]
        hessian = self._beta * self._gram
        np.einsum("ii->i", hessian)[:] += decay
        moved = self._move(hessian, self._beta * self._slope - decay * self.p, decay)
        if with_evidence:
            self._update_evidence(hessian)
        if moved:
            self._gram, self._slope = self._net.normal_equations(self.p, self._x, self._e)

    def _move(self, hessian: Array, descent: Array, decay: Array) -> bool:
        objective = self._beta * np.sum(self._e**2) + np.sum(decay * self.p**2)
        diagonal = np.diag(hessian).copy()
        damped = hessian.copy()
        for _ in range(_TRIES):
            np.einsum("ii->i", damped)[:] = (1.0 + self._damping) * diagonal
            p = self.p + np.linalg.solve(damped, descent)  # numpy's, not scipy's: it releases the interpreter lock
            e = self._y - self._net.predict(p, self._x)
            if self._beta * np.sum(e**2) + np.sum(decay * p**2) < objective:
                self.p, self._e = p, e
                self._damping = max(self._damping / _DAMPING_DOWN, _DAMPING_LIMITS[0])
                return True
            self._damping = min(self._damping * _DAMPING_UP, _DAMPING_LIMITS[1])
        return False

    def _update_evidence(self, hessian: Array) -> None:
        """Set decay and noise to maximise the evidence, given the number of parameters that the data determine."""
        variance = np.diag(np.linalg.inv(hessian))
        determined = np.maximum(self._counts - self._alpha * np.bincount(self._groups, variance), 1e-3)
        squares = np.maximum(np.bincount(self._groups, self.p**2), 1e-12)
        self._alpha = np.clip(determined / squares, *_DECAY_LIMITS)
        freedom = max(self._y.size - float(determined.sum()), 1.0)
        self._beta = float(np.clip(freedom / max(float(np.sum(self._e**2)), 1e-12), 1e-6, 1e9))
