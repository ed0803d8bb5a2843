"""Training of the residual network: Levenberg-Marquardt on torch.func Jacobians, everything chosen by cross-validation.

A few hundred poses are little. So: a committee of as many members as folds, each trained without its fold and stopped
where its fold is predicted best (Krogh, Vedelsby, NIPS 7 (1995) 231); weight decay by the evidence of the data while it
trains (MacKay, Neural Computation 4 (1992) 415; Foresee, Hagan, ICNN 1997, 1930); inputs, width and depth by the error
on the left-out folds. Nothing of the validation split is seen. All members train at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count as count_from
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from cellapp.kinematics.transforms import Array
from cellapp.model.network import Inputs, Layers, ResidualNetwork, network_inputs, turn_about_z
from cellapp.progress import CancelToken

if TYPE_CHECKING:
    import torch

_MARGIN = 0.1
"""The correction fades over this share of each trained joint range."""
_WORTH = 0.98
"""A network is kept only if it leaves less than this share of the error (rms) on folds it has not seen."""


@dataclass(frozen=True)
class Shape:
    """A candidate: what it sees, its hidden layers, and whether it speaks in a frame that turns with joint 1."""

    inputs: Inputs
    hidden: tuple[int, ...]
    turning: bool = False


SHAPES: tuple[Shape, ...] = (
    Shape("sincos", (8, 8)),
    Shape("sincos", (6, 6), turning=True),
    Shape("sincos", (8, 8), turning=True),
    Shape("angles", (6, 6), turning=True),
)
_SCREENING = 40
"""Iterations after which the candidates are compared; only the best one is trained to the end."""
_PATIENCE = 8
"""Iterations without any member predicting its fold better, after which training ends."""


@dataclass(frozen=True)
class Training:
    """What training ended with.

    Attributes
    ----------
    network : ResidualNetwork or None
        None where no candidate predicted left-out folds better than no network.
    shape : Shape
        The best candidate.
    left_out_rms, without_rms : float
        Error on left-out folds with the best candidate and without any network [m], root mean square length.
    tried : tuple
        (shape, left-out rms [m]) of every candidate when they were compared.
    """

    network: ResidualNetwork | None
    shape: Shape
    left_out_rms: float
    without_rms: float
    tried: tuple[tuple[Shape, float], ...]


def train_network(
    q: Array,
    residual: Array,
    *,
    seed: int,
    folds: int = 5,
    iterations: int = 150,
    shapes: Sequence[Shape] = SHAPES,
    cancel: CancelToken | None = None,
) -> Training:
    """Train on joint positions ``q`` (n, N) [rad] and residuals (n, 3) [m] in the frame the correction is wanted in."""
    import torch

    cancel = cancel or CancelToken()
    # Many small matrices: threads inside one product would only wait for one another. Arms train side by side instead.
    torch.set_num_threads(1)
    low, high = q.min(axis=0), q.max(axis=0)
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    fold = np.random.default_rng([seed, 0xF01D]).permutation(len(q)) % folds
    inside = torch.from_numpy((fold[None, :] != np.arange(folds)[:, None]).astype(np.float64))
    outputs = {
        False: torch.from_numpy(residual / scale),
        True: torch.from_numpy(turn_about_z(residual / scale, -q[:, 0])),
    }
    inputs = {kind: torch.from_numpy(network_inputs(kind, low, high, q)) for kind in {s.inputs for s in shapes}}
    compared: list[tuple[_Committee, Shape, Iterator[_Committee]]] = []
    for shape in shapes:
        cancel.check()
        steps = _train_members(inputs[shape.inputs], outputs[shape.turning], inside, shape, seed)
        *_, committee = islice(steps, min(_SCREENING, iterations))
        compared.append((committee, shape, steps))
    committee, shape, steps = min(compared, key=lambda entry: entry[0].left_out)
    while committee.iteration < iterations and (later := next(steps, None)) is not None:
        cancel.check()
        committee = later
    error = committee.left_out
    members = [_layers(member.numpy(), committee.sizes) for member in committee.members]
    tried = [(tried_shape, screened.left_out * scale) for screened, tried_shape, _ in compared]
    without = float(np.sqrt(np.mean(np.sum((residual / scale) ** 2, axis=1))))
    margin = _MARGIN * np.maximum(high - low, 1e-3)
    network = ResidualNetwork(shape.inputs, low, high, margin, shape.turning, scale, tuple(members))
    return Training(
        network=network if error < _WORTH * without else None,
        shape=shape,
        left_out_rms=error * scale,
        without_rms=without * scale,
        tried=tuple(tried),
    )


@dataclass(frozen=True)
class _Committee:
    """The members so far: for each, the parameters that predicted its fold best; and the rms over all folds."""

    members: torch.Tensor
    sizes: tuple[int, ...]
    left_out: float
    iteration: int


def _train_members(
    x: torch.Tensor, y: torch.Tensor, inside: torch.Tensor, shape: Shape, seed: int
) -> Iterator[_Committee]:
    """Train one member a fold, all at once, an iteration a turn; ends when nothing is gained any more."""
    import torch
    from torch.func import jacrev, vmap

    sizes = (x.shape[1], *shape.hidden, y.shape[1])
    count = sum(b * a + b for a, b in pairwise(sizes))
    folds = len(inside)
    forward = _forward(sizes)
    at_each_row = vmap(jacrev(lambda p, row: forward(p, row)), (None, 0))
    at_each_member = vmap(at_each_row, (0, None))
    predict = vmap(forward, (0, None))

    generator = torch.Generator().manual_seed(seed)
    p = torch.cat(
        [
            torch.randn(folds, b * a + b, generator=generator, dtype=torch.float64) / (a + 1.0) ** 0.5
            for a, b in pairwise(sizes)
        ],
        dim=1,
    )
    rows = inside[:, :, None].expand(-1, -1, y.shape[1]).reshape(folds, -1)
    data = rows.sum(dim=1)
    alpha, beta = torch.full((folds,), 0.01, dtype=torch.float64), torch.ones(folds, dtype=torch.float64)
    damping = torch.full((folds,), 1e-2, dtype=torch.float64)
    identity = torch.eye(count, dtype=torch.float64)

    def errors(p: torch.Tensor) -> torch.Tensor:
        off: torch.Tensor = (y - predict(p, x)).reshape(folds, -1)
        return off

    def objective(e: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        return beta * (rows * e**2).sum(dim=1) + alpha * (p**2).sum(dim=1)

    def left_out(e: torch.Tensor) -> torch.Tensor:
        return ((1.0 - rows) * e**2).sum(dim=1)

    e = errors(p)
    best, best_error = p.clone(), left_out(e)
    stale = 0
    left_out_rows = (1.0 - inside).sum()
    for iteration in count_from(0):
        J = at_each_member(p, x).reshape(folds, -1, count) * rows[:, :, None]
        gram = J.transpose(1, 2) @ J
        slope = (J.transpose(1, 2) @ e[:, :, None])[:, :, 0]
        H = beta[:, None, None] * gram + alpha[:, None, None] * identity
        damped = H + damping[:, None, None] * torch.diag_embed(torch.diagonal(H, dim1=1, dim2=2))
        factor = torch.linalg.cholesky(damped)
        step = torch.cholesky_solve((beta[:, None] * slope - alpha[:, None] * p)[:, :, None], factor)[:, :, 0]
        trial, trial_e = p + step, errors(p + step)
        better = objective(trial_e, trial) < objective(e, p)
        p = torch.where(better[:, None], trial, p)
        e = torch.where(better[:, None], trial_e, e)
        damping = torch.where(better, damping / 5.0, damping * 5.0).clamp(1e-9, 1e9)
        if iteration % 2 == 0:
            # the evidence: how many weights do the data determine, and how much noise and decay does that leave
            inverse = torch.cholesky_inverse(torch.linalg.cholesky(H))
            gamma = count - alpha * torch.diagonal(inverse, dim1=1, dim2=2).sum(dim=1)
            alpha = (gamma / (p**2).sum(dim=1).clamp_min(1e-12)).clamp(1e-6, 1e6)
            beta = ((data - gamma).clamp_min(1.0) / (rows * e**2).sum(dim=1).clamp_min(1e-12)).clamp(1e-6, 1e9)
        now = left_out(e)
        gained = now < best_error
        best = torch.where(gained[:, None], p, best)
        best_error = torch.where(gained, now, best_error)
        stale = 0 if bool(gained.any()) else stale + 1
        yield _Committee(best, sizes, float(torch.sqrt(best_error.sum() / left_out_rows)), iteration + 1)
        if stale >= _PATIENCE:
            return


def _forward(sizes: Sequence[int]) -> Callable[[Any, Any], Any]:
    """``f(parameters (P,), rows (..., in))`` of a perceptron with these layer sizes."""
    import torch

    def forward(p: Any, rows: Any) -> Any:
        place = 0
        for depth, (a, b) in enumerate(pairwise(sizes)):
            weights = p[place : place + b * a].reshape(b, a)
            offsets = p[place + b * a : place + b * a + b]
            place += b * a + b
            rows = rows @ weights.T + offsets
            if depth < len(sizes) - 2:
                rows = torch.tanh(rows)
        return rows

    return forward


def _layers(p: Array, sizes: Sequence[int]) -> Layers:
    layers, place = [], 0
    for a, b in pairwise(sizes):
        weights = p[place : place + b * a].reshape(b, a).copy()
        layers.append((weights, p[place + b * a : place + b * a + b].copy()))
        place += b * a + b
    return tuple(layers)
