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

from cellapp.estimation.calibration.network_training import (
    MARGIN,
    WORTH,
    Batches,
    Training,
    train_network,
    training_steps,
)
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Network
from cellapp.ground.progress import CancelToken, Report, Told, ignore_report
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.network import Layers, ResidualNetwork, network_inputs, rotate_about_z

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


def learn(
    network: Network,
    q: Array,
    residual: Array,
    time_s: Array,
    *,
    seed: int,
    cancel: CancelToken | None = None,
    report: Report = ignore_report,
) -> Training:
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
    seed, cancel, report
        As of ``train_network``.

    Raises
    ------
    InputError
        If torch is needed and not installed.
    Cancelled
        On request.
    """
    cancel = cancel or CancelToken()
    folds, iterations = network.folds, network.iterations
    fewest = 2 * folds * _BLOCKS_A_FOLD
    if network.kind != "batches" or len(q) < fewest:
        return train_network(q, residual, seed=seed, folds=folds, iterations=iterations, cancel=cancel, report=report)
    order = np.argsort(time_s, kind="stable")
    q, residual = q[order], residual[order]
    block = np.arange(len(q)) * (folds * _BLOCKS_A_FOLD) // len(q)
    fold = (np.random.default_rng([seed, _SEED]).permutation(folds * _BLOCKS_A_FOLD) % folds)[block]
    committee = train_network(
        q, residual, seed=seed, folds=folds, iterations=iterations, fold=fold, cancel=cancel, report=report
    )
    network_of_all, device = _in_batches(committee, q, residual, fold, seed, cancel, report)
    report(training_steps() + 1, "networks compared")
    return _better(committee, network_of_all, device, q, residual, fold, block)


def _in_batches(
    committee: Training,
    q: Array,
    residual: Array,
    fold: NDArray[np.int64],
    seed: int,
    cancel: CancelToken,
    report: Report,
) -> tuple[ResidualNetwork, str]:
    """Train a network on all readings: the committee, if it helps, plus layers from batches; also return the device."""
    low, high = q.min(axis=0), q.max(axis=0)
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    rotates = committee.shape.rotates_with_joint_1
    x = network_inputs("both", low, high, q)
    y = rotate_about_z(residual / scale, -q[:, 0]) if rotates else residual / scale
    known = _known_layers(committee, q.shape[1], int(fold.max()) + 1, scale)
    trained = train_members(
        x,
        np.stack([y - (np.tanh(x @ W.T + b) @ V.T + c) for (W, b), (V, c) in known]),
        fold,
        seed=seed,
        cancel=cancel,
        told=lambda words: report(training_steps(), f"{len(q)} readings: {words}"),
    )
    members = tuple(_beside(first, second) for first, second in zip(known, trained.members, strict=True))
    return ResidualNetwork(
        "both", low, high, MARGIN * np.maximum(high - low, 1e-3), rotates, scale, members
    ), trained.device


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
    gain = squares[1] - squares[0]
    sigmas = float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-300))
    own, other = (float(np.sqrt(np.sum(of_blocks * counts) / len(q))) for of_blocks in squares)
    used = own < WORTH * other and sigmas > _SURE
    batches = Batches(used, len(q), len(counts), HIDDEN, device, own, other, sigmas)
    if not used:
        return replace(committee, batches=batches)
    without = float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))
    return replace(committee, network=of_all, left_out_rms=own, without_rms=without, batches=batches)


def _left_out_squares(network: ResidualNetwork | None, q: Array, residual: Array, fold: NDArray[np.int64]) -> Array:
    """Compute squared errors (n,) [m^2] by the member that did not learn from a reading's fold, or by no network."""
    left = residual.copy()
    if network is not None:
        for number, member in enumerate(network.members):
            rows = fold == number
            left[rows] -= replace(network, members=(member,)).correct(q[rows])
    return np.asarray(np.sum(left**2, axis=1))


# -- Training of the residual network from all readings, in batches, by torch -----------------------------------------
#
# The committee of ``network_training`` solves normal equations, whose time limits it to some thousand readings; its
# evidence and its few units generalise well to configurations that were never measured. Training in batches starts from
# it: each member of the committee gets two more hidden layers that learn its residuals, by Adam (Kingma, Ba, ICLR 2015)
# from batches drawn from all readings outside its fold. They start at zero correction and keep the weights that
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
_DECAY = 1e-4
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


@dataclass(frozen=True)
class BatchMembers:
    """Trained members, one for each fold, and the device that trained them: ``cpu``, or the name of a GPU."""

    members: tuple[Layers, ...]
    device: str


def train_members(
    x: Array, y: Array, fold: NDArray[np.int64], *, seed: int, cancel: CancelToken, told: Told
) -> BatchMembers:
    """Train one member for each fold on the rows of the others.

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
        best = trainer.run(cancel, told)
    members = []
    for number in range(len(trainer.rows)):
        layers = [(weights[number].T, offsets[number, 0]) for weights, offsets in best]
        weights, offsets = layers[0]
        layers[0] = (weights / spread, offsets - weights @ (mean / spread))  # the first layer now takes unscaled inputs
        members.append(tuple((np.ascontiguousarray(w), o.copy()) for w, o in layers))
    return BatchMembers(tuple(members), torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu")


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

    def run(self, cancel: CancelToken, told: Told) -> list[tuple[Array, Array]]:
        """Train; return for each layer the weights (M, in, out) and offsets (M, 1, out) that predict the folds best."""
        torch, parameters = self._torch, [p for layer in self._layers for p in layer]
        steps = int(np.clip(_EPOCHS * len(self._x) // _BATCH, _FEWEST_STEPS, _MOST_STEPS))
        adam = torch.optim.AdamW(parameters, lr=_RATE, weight_decay=_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(adam, max_lr=_RATE, total_steps=steps, pct_start=0.1)
        best, least = [p.detach().clone() for p in parameters], self._left_out()
        for step in range(1, steps + 1):
            if step % 10 == 1:
                cancel.check()
            adam.zero_grad()
            self._loss().backward()
            adam.step()
            schedule.step()
            if step % (steps // _LOOKS) == 0 or step == steps:
                told(f"step {step} of {steps} in batches of {_BATCH}")
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
        drawn = torch.rand((len(self.rows), _BATCH), generator=self._random, device=self._x.device)
        rows = self._others.gather(1, (drawn * self._counts).long())
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
