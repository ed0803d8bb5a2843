"""Training of the residual network that a profile asks for: the committee, or one that extends it with all readings.

Both are judged on the same left-out blocks of time: each reading is predicted by the member that did not learn from its
block. Readings close in time are alike, in a motion more than at stops; a left-out reading between two that were learnt
from would test nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.least_squares import inverse_diagonal, solve_psd
from cellapp.estimation.calibration.records import BatchesResult, NetworkResult
from cellapp.estimation.readings.readings import Groups, folds_of, repeats, undivided
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Network
from cellapp.ground.progress import UNTOLD, JobSteps
from cellapp.robot.kinematics.transforms import Array, rms_length
from cellapp.robot.model.model import Inputs, Layers, ResidualNetwork, network_inputs, rotate_about_z

# -- Training of the residual network by Levenberg-Marquardt, selected by cross-validation ----------------------------
#
# A few hundred configurations are few data. Therefore:
#
# - The network is a committee with one member per fold. Each member is trained without its fold and stopped where it
#   predicts that fold best (Krogh, Vedelsby, NIPS 7 (1995) 231).
# - Weight decay follows from the evidence of the data in training (MacKay, Neural Computation 4 (1992) 415; Foresee,
#   Hagan, ICNN 1997, 1930), with one decay for the inputs of each joint.
# - The inputs and the frame of the output are selected by the error on the left-out folds.
#
# The validation split is not used.

# -- Perceptron with one hidden layer, and its least-squares normal equations in closed form --------------------------
#
#     h = tanh(W a),  y = V b,  a = (x, 1),  b = (h, 1)
#
# The derivative of output k by ``W[o, i]`` is ``V[k, o] (1 - h_o^2) a_i`` and by ``V[k, j]`` it is ``b_j``. All outputs
# share ``(1 - h_o^2) a_i`` and ``b_j``; therefore one product over the rows gives the normal matrix of all outputs.

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
        """Sample random parameters that give signals of scale ``_BENT`` to the hidden layer, about 1 to the outputs."""
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
_DECAY = 0.1
"""Initial weight decay, in units of the noise precision; the evidence adjusts it."""
_DECAY_LIMITS = (1e-6, 1e6)
_EVIDENCE_EVERY = 3
"""Iterations between two updates of the decay: the formula holds at a minimum, and costs an inverse."""
_IMPROVED = 0.998
"""Ratio to a member's best squared error on its fold below which an iteration counts as an improvement."""
_PATIENCE = 8
"""Number of iterations without improvement after which the training of a member ends."""
_SCREENED, _SCREENING = 2, 15
"""Number of members, and of iterations of each, after which candidates are compared; only the best one is trained
further."""


@dataclass(frozen=True)
class NetForm:
    """A candidate network: inputs, size of the hidden layer, and whether its output frame rotates with joint 1."""

    inputs: Inputs
    hidden: int
    rotates_with_joint_1: bool = False

    def result(self, *, used: bool, left_out_rms_m: float, without_rms_m: float) -> NetworkResult:
        """State the network, whether it is used, and the errors on left-out folds with and without it."""
        return NetworkResult(
            used=used,
            inputs=self.inputs,
            hidden=(self.hidden,),
            turning=self.rotates_with_joint_1,
            left_out_rms_mm=left_out_rms_m * 1e3,
            without_rms_mm=without_rms_m * 1e3,
        )


_READINGS_A_UNIT = 16
"""Readings per hidden unit: an arm of 6 joints then has 3 measured coordinates for each parameter."""
_FEWEST_UNITS, _MOST_UNITS = 10, 20
"""Limits of the hidden layer. Fewer units do worse even from 50 readings; more are not worth their cubic time."""
_MOST_READINGS = 1200
"""Maximum number of readings to train on. Twice as many lower the held-out error by some 6 % and double the time."""
_CANDIDATES = 3
"""Number of shapes that ``candidate_shapes`` returns."""


def candidate_shapes(readings: int) -> tuple[NetForm, ...]:
    """Return the candidate shapes for a number of readings.

    The output is in a frame that rotates with joint 1, or in one that does not. Angles as inputs suit errors that grow
    along the range of a joint, for example by play: a joint at the upper end of its range most often came from below.
    """
    hidden = int(np.clip(readings // _READINGS_A_UNIT, _FEWEST_UNITS, _MOST_UNITS))
    return (
        NetForm("sincos", hidden, rotates_with_joint_1=True),
        NetForm("sincos", hidden),
        NetForm("angles", hidden, rotates_with_joint_1=True),
    )


@dataclass(frozen=True)
class Training:
    """Result of training.

    Attributes
    ----------
    network : ResidualNetwork or None
        None if the best candidate predicts left-out folds no better than none, by ``WORTH`` and a standard error.
    shape : NetForm
        The best candidate.
    result : NetworkResult
        With the rms lengths of the residual on left-out folds: the readings of one half of a fold are predicted by the
        member that predicted the other half best.
    """

    network: ResidualNetwork | None
    shape: NetForm
    result: NetworkResult


def train_network(
    network: Network,
    q: Array,
    residual: Array,
    seed: int,
    steps: JobSteps = UNTOLD,
    *,
    shapes: Sequence[NetForm] | None = None,
    fold: NDArray[np.int64] | None = None,
) -> Training:
    """Train a residual network on at most ``_MOST_READINGS`` readings; sample them by ``seed`` if there are more.

    Parameters
    ----------
    network : Network
        Number of folds and of members, and the largest number of iterations of a member.
    q : array, shape (n, N)
        Joint positions [rad].
    residual : array, shape (n, 3)
        Measured minus computed positions in the frame of the correction, the base frame [m].
    seed : int
    steps : JobSteps
        There are ``training_steps(len(shapes))``.
    shapes : sequence of NetForm, optional
        Candidates; the default depends on the number of readings.
    fold : array of int, shape (n,), optional
        Fold of each reading; sampled by ``seed`` if not given.
    """
    shapes = candidate_shapes(len(q)) if shapes is None else shapes
    low, high = q.min(axis=0), q.max(axis=0)
    if len(q) > _MOST_READINGS:
        sample = np.random.default_rng([seed, 0x5A3]).permutation(len(q))[:_MOST_READINGS]
        q, residual, fold = q[sample], residual[sample], None if fold is None else fold[sample]
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    group = undivided(q)
    if group.max() + 1 < 2 * network.folds:
        none = rms_length(residual)
        return Training(None, shapes[0], shapes[0].result(used=False, left_out_rms_m=none, without_rms_m=none))
    fold = folds_of(group, network.folds, np.random.default_rng([seed, 0xF01D])) if fold is None else fold
    outputs = {False: residual / scale, True: rotate_about_z(residual / scale, -q[:, 0])}
    inputs = {kind: network_inputs(kind, low, high, q) for kind in {shape.inputs for shape in shapes}}
    candidates = [
        _Committee(shape, inputs[shape.inputs], outputs[shape.rotates_with_joint_1], fold, group, seed)
        for shape in shapes
    ]
    for number, candidate in enumerate(candidates if len(shapes) > 1 else ()):
        steps(number, f"network {number + 1} of {len(shapes)}")
        candidate.train(_SCREENED, min(_SCREENING, network.iterations), steps)
    committee = min(candidates, key=_Committee.left_out) if len(shapes) > 1 else candidates[0]
    steps(len(shapes), "best network")
    committee.train(int(fold.max()) + 1, network.iterations, steps)
    steps(len(shapes) + 1, "network trained")
    shape, squares = committee.shape, committee.left_out_squares()
    of_none = np.sum((residual / scale) ** 2, axis=1)
    left_out, without = (float(np.sqrt(one.mean())) for one in (squares, of_none))
    margin = MARGIN * np.maximum(high - low, 1e-3)
    members = tuple(committee.net.layers(member.best) for member in committee.members)
    found = ResidualNetwork(shape.inputs, low, high, margin, shape.rotates_with_joint_1, scale, members)
    used = left_out < WORTH * without and standard_errors(of_none - squares, group) > 1.0
    result = shape.result(used=used, left_out_rms_m=left_out * scale, without_rms_m=without * scale)
    return Training(found if used else None, shape, result)


def standard_errors(gain: Array, group: Groups) -> float:
    """Return the mean of a gain (n,) in standard errors over the groups of its rows."""
    of_group = np.bincount(group, gain)
    return float(of_group.mean() / max(of_group.std(ddof=1) / np.sqrt(len(of_group)), 1e-300))


def training_steps(shapes: int = _CANDIDATES) -> int:
    """Return the number of steps that a training reports: one for each candidate, one for the best."""
    return shapes + 1


class _Committee:
    """One member for each fold, trained without it.

    Attributes
    ----------
    members : list of _Member
        Those trained so far, of the first folds.
    """

    def __init__(self, shape: NetForm, x: Array, y: Array, fold: NDArray[np.int64], group: Groups, seed: int) -> None:
        self.shape, self.net = shape, Perceptron(x.shape[1], shape.hidden, y.shape[1])
        self.members: list[_Member] = []
        self._x, self._y, self._fold, self._group, self._seed = x, y, fold, group, seed

    def train(self, count: int, iterations: int, steps: JobSteps) -> None:
        """Train the members of the first ``count`` folds, each for at most ``iterations`` in all."""
        for number in range(count):
            if number == len(self.members):
                start = self.net.start(np.random.default_rng([self._seed, number]))
                groups = self.net.decay_groups(self.shape.inputs)
                out = self._fold == number
                self.members.append(_Member(self.net, self._x, self._y, out, self._group, groups, start))
            self.members[number].train(iterations, steps)

    def left_out(self) -> float:
        """Compute the rms length of the errors on the folds that the members were trained without."""
        rows = np.count_nonzero(self._fold < len(self.members))
        return float(np.sqrt(sum(member.error for member in self.members) / rows))

    def left_out_squares(self) -> Array:
        """Return the squared error (n,) of each reading on its fold; see ``_Member.squares``."""
        squares = np.zeros(len(self._y))
        for number, member in enumerate(self.members):
            squares[self._fold == number] = member.squares
        return squares


class _Member:
    """Member in training, which minimises ``beta sum e^2 + sum alpha_g p^2`` over the readings that are not left out.

    Attributes
    ----------
    best : array, shape (P,)
        Parameters that predicted the left-out readings best, and ``error``, their sum of squares there.
    squares : array
        Squared error of each left-out reading by the parameters that predicted best those of the other half of the
        groups: these were not chosen by it.
    """

    def __init__(
        self, net: Perceptron, x: Array, y: Array, left_out: NDArray[np.bool_], group: Groups, groups: Array, p: Array
    ) -> None:
        self._net, self._x, self._y, self._groups = net, x[~left_out], y[~left_out], groups
        self._left_out = x[left_out], y[left_out]
        self._half = np.unique(group[left_out], return_inverse=True)[1] % 2
        self._least, self.squares = [math.inf, math.inf], np.zeros(np.count_nonzero(left_out))
        self._counts = np.bincount(groups)
        self._alpha = np.full(len(self._counts), _DECAY)  # precision of each group of parameters
        self._beta = 1.0  # precision of the noise
        self._damping = _DAMPING
        self._iteration = self._stale = 0
        self._p, self._e = p, self._y - net.predict(p, self._x)
        self._gram, self._slope = net.normal_equations(p, self._x, self._e)
        self.best, self.error = p, self._error(p)

    def train(self, iterations: int, steps: JobSteps) -> None:
        """Iterate until there were ``iterations`` in all, or ``_PATIENCE`` without improvement."""
        while self._iteration < iterations and self._stale < _PATIENCE:
            steps.check()
            self._step(with_evidence=self._iteration % _EVIDENCE_EVERY == 0)
            self._iteration += 1
            now = self._error(self._p)
            self._stale = 0 if now < _IMPROVED * self.error else self._stale + 1
            if now < self.error:
                self.best, self.error = self._p, now

    def _error(self, p: Array) -> float:
        x, y = self._left_out
        squares = np.sum((y - self._net.predict(p, x)) ** 2, axis=1)
        for half, least in enumerate(self._least):
            own = self._half == half
            if (now := float(squares[own].sum())) < least:
                self._least[half], self.squares[~own] = now, squares[~own]
        return float(squares.sum())

    def _step(self, *, with_evidence: bool) -> None:
        """Take the first damped step that lowers the objective; none if ``_TRIES`` steps fail."""
        decay = self._alpha[self._groups] / self._beta
        hessian = self._gram  # of half the objective, divided by the precision of the noise
        diagonal = hessian.diagonal() + decay
        moved = self._move(hessian, diagonal, self._slope - decay * self._p, decay)
        if with_evidence:
            np.fill_diagonal(hessian, diagonal)
            self._update_evidence(inverse_diagonal(hessian) / self._beta)
        if moved:
            self._gram, self._slope = self._net.normal_equations(self._p, self._x, self._e)
        else:
            np.fill_diagonal(hessian, diagonal - decay)

    def _move(self, hessian: Array, diagonal: Array, descent: Array, decay: Array) -> bool:
        """Try steps with ``diagonal``, damped, in the place of that of ``hessian``, which is changed."""
        objective = np.sum(self._e**2) + np.sum(decay * self._p**2)
        for _ in range(_TRIES):
            np.fill_diagonal(hessian, (1.0 + self._damping) * diagonal)
            p = self._p + solve_psd(hessian, descent)
            e = self._y - self._net.predict(p, self._x)
            if np.sum(e**2) + np.sum(decay * p**2) < objective:
                self._p, self._e = p, e
                self._damping = max(self._damping / _DAMPING_DOWN, _DAMPING_LIMITS[0])
                return True
            self._damping = min(self._damping * _DAMPING_UP, _DAMPING_LIMITS[1])
        return False

    def _update_evidence(self, variance: Array) -> None:
        """Set decay and noise to maximise the evidence, given the number of parameters that the data determine."""
        determined = np.maximum(self._counts - self._alpha * np.bincount(self._groups, variance), 1e-3)
        squares = np.maximum(np.bincount(self._groups, self._p**2), 1e-12)
        self._alpha = np.clip(determined / squares, *_DECAY_LIMITS)
        freedom = max(self._y.size - float(determined.sum()), 1.0)
        self._beta = float(np.clip(freedom / max(float(np.sum(self._e**2)), 1e-12), 1e-6, 1e9))


_BLOCKS_A_FOLD = 8
_SURE = 2.0
"""Number of standard errors by which a network in batches must be better than the committee."""
_SEED = 0xBA7C
_STRAIGHT = 1e-4
"""Scale of the arguments for which tanh is the identity: within 3e-9 of it, and far above rounding."""


def learning_steps(network: Network) -> int:
    """Return the number of steps that ``learn`` reports."""
    return training_steps() + (network.kind == "batches")


def require_learner(network: Network) -> None:
    """Raise ``InputError``, which says what to install, if the requested network needs a missing package."""
    if network.kind == "batches":
        load_torch()


def learn(network: Network, q: Array, residual: Array, time_s: Array, seed: int, steps: JobSteps = UNTOLD) -> Training:
    """Train the network that the profile requests.

    Parameters
    ----------
    network : Network
        Section of the profile, of kind ``mlp`` or ``batches``.
    q : array, shape (n, N)
        Joint positions [rad].
    residual : array, shape (n, 3)
        Measured minus computed positions in the frame of the correction, the base frame [m].
    time_s : array, shape (n,)
        Times of measurement, from which the blocks of time are cut.
    seed, steps
        As of ``train_network``.

    Raises
    ------
    InputError
        If torch is needed and not installed.
    Cancelled
        On request.
    """
    folds = network.folds
    if network.kind != "batches" or len(q) < 2 * folds * _BLOCKS_A_FOLD:
        return train_network(network, q, residual, seed, steps)
    order = np.argsort(time_s, kind="stable")
    q, residual = q[order], residual[order]
    block = np.arange(len(q)) * (folds * _BLOCKS_A_FOLD) // len(q)
    fold = (np.random.default_rng([seed, _SEED]).permutation(folds * _BLOCKS_A_FOLD) % folds)[block]
    fold = fold[np.unique(group := repeats(q), return_index=True)[1]][group]
    committee = train_network(network, q, residual, seed, steps, fold=fold)
    network_of_all, device = _in_batches(committee, q, residual, fold, seed, steps)
    steps(training_steps() + 1, "networks compared")
    return _better(committee, network_of_all, device, q, residual, fold, block)


def _in_batches(
    committee: Training, q: Array, residual: Array, fold: NDArray[np.int64], seed: int, steps: JobSteps
) -> tuple[ResidualNetwork, str]:
    """Train a network on all readings: the committee, if it helps, plus layers from batches; also return the device."""
    low, high = q.min(axis=0), q.max(axis=0)
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    rotates = committee.shape.rotates_with_joint_1
    x = network_inputs("both", low, high, q)
    y = rotate_about_z(residual / scale, -q[:, 0]) if rotates else residual / scale
    known = _known_layers(committee, q.shape[1], int(fold.max()) + 1, scale)
    misfit = np.stack([y - (np.tanh(x @ W.T + b) @ V.T + c) for (W, b), (V, c) in known])
    added, device = train_members(x, misfit, fold, seed=seed, steps=steps.after(training_steps(), f"{len(q)} readings"))
    members = tuple(_beside(first, second) for first, second in zip(known, added, strict=True))
    return ResidualNetwork("both", low, high, MARGIN * np.maximum(high - low, 1e-3), rotates, scale, members), device


def _known_layers(committee: Training, joints: int, folds: int, scale: float) -> list[Layers]:
    """Convert the members' layers to inputs ``both`` and outputs in ``scale`` [m]; zero layers without a network."""
    if committee.network is None:
        return [((np.zeros((0, 3 * joints)), np.zeros(0)), (np.zeros((3, 0)), np.zeros(3)))] * folds
    columns = slice(0, joints) if committee.network.inputs == "angles" else slice(joints, 3 * joints)
    ratio = committee.network.scale / scale
    found: list[Layers] = []
    for (weights, offsets), (to_outputs, last) in committee.network.members:
        W = np.zeros((len(weights), 3 * joints))
        W[:, columns] = weights
        found.append(((W, offsets), (to_outputs * ratio, last * ratio)))
    return found


def _beside(known: Layers, added: Layers) -> Layers:
    """Combine a perceptron of one hidden layer and one of two into a single one that gives their sum.

    Units of the former pass the second layer where tanh is linear: ``tanh(e h) / e = h`` within e^2 / 3.
    """
    (W, b), (V, c) = known
    (W1, b1), (W2, b2), (W3, b3) = added
    passing = np.eye(len(W)) * _STRAIGHT
    second = np.block([[passing, np.zeros((len(W), len(W1)))], [np.zeros((len(W2), len(W))), W2]])
    return (
        (np.vstack([W, W1]), np.concatenate([b, b1])),
        (second, np.concatenate([np.zeros(len(W)), b2])),
        (np.hstack([V / _STRAIGHT, W3]), c + b3),
    )


def _better(
    committee: Training,
    of_all: ResidualNetwork,
    device: str,
    q: Array,
    residual: Array,
    fold: NDArray[np.int64],
    block: NDArray[np.int64],
) -> Training:
    """Return the training with the network that predicts left-out blocks better; the committee if in doubt."""
    counts = np.bincount(block)
    squares = [
        np.bincount(block, _left_out_squares(network, q, residual, fold)) / counts
        for network in (of_all, committee.network)
    ]
    sigmas = standard_errors(squares[1] - squares[0], np.arange(len(counts)))
    own, other = (float(np.sqrt(np.sum(of_blocks * counts) / len(q))) for of_blocks in squares)
    used = own < WORTH * other and sigmas > _SURE
    batches = BatchesResult(
        used=used,
        readings=len(q),
        blocks=len(counts),
        hidden=HIDDEN,
        device=device,
        left_out_rms_mm=own * 1e3,
        committee_rms_mm=other * 1e3,
        sigmas=sigmas,
    )
    result = committee.result.model_copy(update={"batches": batches})
    if not used:
        return replace(committee, result=result)
    of_network = {"inputs": of_all.inputs, "hidden": HIDDEN, "left_out_rms_mm": own * 1e3}
    result = result.model_copy(update={"used": True, "without_rms_mm": rms_length(residual) * 1e3, **of_network})
    return replace(committee, network=of_all, result=result)


def _left_out_squares(network: ResidualNetwork | None, q: Array, residual: Array, fold: NDArray[np.int64]) -> Array:
    """Compute squared errors (n,) [m^2] by the member that did not learn from a reading's fold, or by no network."""
    errors = residual.copy()
    if network is not None:
        for number, member in enumerate(network.members):
            rows = fold == number
            errors[rows] -= replace(network, members=(member,)).correct(q[rows])
    return np.asarray(np.sum(errors**2, axis=1))


# -- Training of the residual network from all readings, in batches, by torch -----------------------------------------
#
# The committee above solves normal equations, whose time limits it to some thousand readings; its
# evidence and its few units generalise well to configurations that were never measured. Training in batches starts from
# it: each member of the committee gets two more hidden layers that learn its residuals, by Adam (Kingma, Ba, ICLR 2015)
# from batches sampled from all readings outside its fold. They start at zero correction and keep the weights that
# predicted the fold best. The learning rate falls along a cosine to zero. The number of steps is bounded: a million
# readings take hardly longer than a hundred thousand.
#
# torch is loaded here only. The result is stored as a ``ResidualNetwork``, which numpy evaluates.


Tensor: TypeAlias = Any
"""A torch tensor; torch may not be installed."""

HIDDEN = (48, 48)
"""Sizes of the hidden layers beside those of the committee."""
_GAIN = 2.0
"""Gain of the initial input weights; with 1, fine errors are learnt later."""
_BATCH = 512
_RATE = 1e-2
"""Largest learning rate of Adam. A third of it leaves errors of eight cycles a turn unlearnt."""
_BATCHES_DECAY = 1e-4
"""Weight decay of a step, as a share of the learning rate."""
_EPOCHS = 12
_FEWEST_STEPS, _MOST_STEPS = 1000, 2500
"""Number of steps for few readings, and for 100 000 and more."""
_LOOKS = 20
"""Number of evaluations of the members on their folds during the training."""


def load_torch() -> Any:
    """Import torch; raise ``InputError`` with the command that installs it if it is missing."""
    try:
        import torch  # takes 1 to 3 s, and only training in batches needs it
    except ImportError as error:
        raise InputError(
            f"a residual network from all readings needs torch, which is not installed ({error}): python -m pip install"
            " 'cellapp[learn]', or take the network 'mlp', which needs none"
        ) from None
    return torch


def train_members(
    x: Array, y: Array, fold: NDArray[np.int64], *, seed: int, steps: JobSteps
) -> tuple[list[Layers], str]:
    """Train one member for each fold on the rows of the others; return them and the device, ``cpu`` or a GPU's name.

    Parameters
    ----------
    x : array, shape (n, inputs)
        Inputs of the first layer.
    y : array, shape (M, n, outputs)
        Training targets of each member, scaled to about one.
    fold : array of int, shape (n,)
        Fold of each row. Every fold and its complement must hold rows.

    Raises
    ------
    InputError
        If torch is not installed.
    Cancelled
        On request.
    """
    torch = load_torch()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-6)
    with _one_thread(torch):
        trainer = _Trainer(torch, device, (x - mean) / spread, y, fold, seed)
        best = trainer.run(steps)
    members: list[Layers] = []
    for number in range(len(trainer.rows)):
        layers = [(weights[number].T, offsets[number, 0]) for weights, offsets in best]
        weights, offsets = layers[0]
        layers[0] = (weights / spread, offsets - weights @ (mean / spread))  # the first layer now takes unscaled inputs
        members.append(tuple((np.ascontiguousarray(w), o.copy()) for w, o in layers))
    return members, torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"


@contextmanager
def _one_thread(torch: Any) -> Iterator[None]:
    """Run torch in one thread: the matrices of a step are small, and its threads would wait for one another."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Trainer:
    """Trainer of all members at once: each weight tensor has one matrix per member.

    Attributes
    ----------
    rows : list of tensors
        Rows of each fold.
    """

    def __init__(self, torch: Any, device: Any, x: Array, y: Array, fold: NDArray[np.int64], seed: int) -> None:
        self._torch = torch
        self._x = torch.tensor(x, dtype=torch.float32, device=device)
        self._y = torch.tensor(y, dtype=torch.float32, device=device)
        folds = int(fold.max()) + 1
        self.rows = [torch.tensor(np.flatnonzero(fold == k), device=device) for k in range(folds)]
        others = [np.flatnonzero(fold != k) for k in range(folds)]
        self._counts = torch.tensor([len(rows) for rows in others], device=device)[:, None]
        most = max(len(rows) for rows in others)
        self._others = torch.tensor(np.stack([np.resize(rows, most) for rows in others]), device=device)
        self._random = torch.Generator(device=device).manual_seed(seed)
        self._each = torch.arange(folds, device=device)[:, None]
        sizes = (x.shape[1], *HIDDEN, y.shape[2])
        gains = (_GAIN, *(1.0 for _ in HIDDEN[1:]), 0.0)
        self._layers = [self._start(folds, *ends, gain, device) for ends, gain in zip(pairwise(sizes), gains)]

    def run(self, told: JobSteps) -> list[tuple[Array, Array]]:
        """Train; return for each layer the weights (M, in, out) and offsets (M, 1, out) that predict the folds best."""
        torch, parameters = self._torch, [p for layer in self._layers for p in layer]
        steps = int(np.clip(_EPOCHS * len(self._x) // _BATCH, _FEWEST_STEPS, _MOST_STEPS))
        adam = torch.optim.AdamW(parameters, lr=_RATE, weight_decay=_BATCHES_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(adam, max_lr=_RATE, total_steps=steps, pct_start=0.1)
        best, least = [p.detach().clone() for p in parameters], self._left_out()
        for step in range(1, steps + 1):
            if step % 10 == 1:
                told.check()
            adam.zero_grad()
            self._loss().backward()
            adam.step()
            schedule.step()
            if step % (steps // _LOOKS) == 0 or step == steps:
                told(0, f"step {step} of {steps} in batches of {_BATCH}")
                now = self._left_out()
                better = now < least
                least = torch.where(better, now, least)
                for kept, p in zip(best, parameters):
                    kept[better] = p.detach()[better]
        arrays = [kept.double().cpu().numpy() for kept in best]
        return list(zip(arrays[::2], arrays[1::2]))

    def _start(self, members: int, inputs: int, outputs: int, gain: float, device: Any) -> tuple[Any, Any]:
        torch = self._torch
        weights = torch.randn((members, inputs, outputs), generator=self._random, device=device)
        weights *= gain / math.sqrt(inputs)
        return weights.requires_grad_(), torch.zeros((members, 1, outputs), device=device, requires_grad=True)

    def _loss(self) -> Tensor:
        """Sum the mean squared errors of one batch for each member; the members do not affect one another."""
        torch = self._torch
        sampled = torch.rand((len(self.rows), _BATCH), generator=self._random, device=self._x.device)
        rows = self._others.gather(1, (sampled * self._counts).long())
        errors = _outputs(torch, self._layers, self._x[rows]) - self._y[self._each, rows]
        return errors.square().mean(dim=(1, 2)).sum()

    def _left_out(self) -> Tensor:
        """Compute the mean squared error of each member on its fold."""
        torch, found = self._torch, []
        with torch.no_grad():
            for number, rows in enumerate(self.rows):
                one = [(weights[[number]], offsets[[number]]) for weights, offsets in self._layers]
                found.append((_outputs(torch, one, self._x[rows][None]) - self._y[number, rows]).square().mean())
        return torch.stack(found)


def _outputs(torch: Any, layers: Sequence[tuple[Any, Any]], x: Tensor) -> Tensor:
    """Compute the outputs (M, n, outputs) of the members for inputs (M, n, inputs)."""
    for weights, offsets in layers[:-1]:
        x = torch.tanh(torch.baddbmm(offsets, x, weights))
    weights, offsets = layers[-1]
    return torch.baddbmm(offsets, x, weights)
