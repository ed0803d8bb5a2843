"""Training of the residual network that a profile asks for: the committee, or one that extends it with all readings.

Both are judged on the same left-out blocks of time: each reading is predicted by the member that did not learn from its
block. Readings close in time are alike, in a motion more than at stops; a left-out reading between two that were learnt
from would test nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellapp.estimation.calibration.batch_training import HIDDEN, load_torch, train_members
from cellapp.estimation.calibration.network_training import (
    MARGIN,
    WORTH,
    Batches,
    Training,
    train_network,
    training_steps,
)
from cellapp.ground.profile import Network
from cellapp.ground.progress import CancelToken, Report, ignore_report
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
