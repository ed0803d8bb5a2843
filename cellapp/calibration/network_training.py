"""Training of the residual network by Levenberg-Marquardt on Jacobians from torch.func, selected by cross-validation.

A few hundred poses are few data. Therefore:

- The network is a committee with one member per fold. Each member is trained without its fold and stopped where it
  predicts that fold best (Krogh, Vedelsby, NIPS 7 (1995) 231).
- Weight decay follows from the evidence of the data during training (MacKay, Neural Computation 4 (1992) 415; Foresee,
  Hagan, ICNN 1997, 1930).
- Inputs, width and depth are selected by the error on the left-out folds.

The validation split is not used. All members are trained at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count as count_from
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from cellapp.kinematics.transforms import Array
from cellapp.model.network import Inputs, Layers, ResidualNetwork, network_inputs, rotate_about_z
from cellapp.progress import CancelToken, Report, ignore_report

if TYPE_CHECKING:
    import torch

_MARGIN = 0.1
"""Share of each trained joint range over which the correction fades to zero outside it."""
_WORTH = 0.98
"""A network is used only if the rms error on left-out folds falls below this share of that without a network."""
_DAMPING = (1e-2, 5.0, 1e-9, 1e9)
"""Damping at the start, factor per step, and its limits, as shares of the diagonal of the Hessian."""
_DECAY = 0.01
"""Weight decay at the start, in units of the noise precision; the evidence adjusts it."""


@dataclass(frozen=True)
class Shape:
    """A candidate network: inputs, hidden layers, and whether its output frame rotates with joint 1 about z."""

    inputs: Inputs
    hidden: tuple[int, ...]
    rotates_with_joint_1: bool = False


SHAPES: tuple[Shape, ...] = (
    Shape("sincos", (8, 8)),
    Shape("sincos", (6, 6), rotates_with_joint_1=True),
    Shape("sincos", (8, 8), rotates_with_joint_1=True),
    Shape("angles", (6, 6), rotates_with_joint_1=True),
)
_SCREENING = 40
"""Iterations after which candidates are compared; only the best one is trained further."""
_REPORTED = 10
"""Iterations between two reports: a second or less."""
_PATIENCE = 8
"""Training ends after this number of iterations in which no member predicted its fold better."""


@dataclass(frozen=True)
class Training:
    """Result of training.

    Attributes
    ----------
    network : ResidualNetwork or None
        None where no candidate predicts left-out folds better than no network does.
    shape : Shape
        The best candidate.
    left_out_rms, without_rms : float
        Rms length of the residual on left-out folds, with the best candidate and without a network [m].
    tried : tuple
        (shape, left-out rms [m]) of every candidate at the time of the comparison.
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
    report: Report = ignore_report,
) -> Training:
    """Train a residual network.

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
        Most iterations of a member.
    shapes : sequence of Shape
        Candidates.
    cancel : CancelToken, optional
    report : callable
        Takes the steps done, of ``training_steps(shapes)``, and words.
    """
    import torch

    cancel = cancel or CancelToken()
    # The matrices are too small for threads within one product; the arms are trained in parallel instead.
    torch.set_num_threads(1)
    low, high = q.min(axis=0), q.max(axis=0)
    scale = max(float(np.sqrt(np.mean(residual**2))), 1e-12)
    fold = np.random.default_rng([seed, 0xF01D]).permutation(len(q)) % folds
    inside = torch.from_numpy((fold[None, :] != np.arange(folds)[:, None]).astype(np.float64))
    outputs = {
        False: torch.from_numpy(residual / scale),
        True: torch.from_numpy(rotate_about_z(residual / scale, -q[:, 0])),
    }
    inputs = {kind: torch.from_numpy(network_inputs(kind, low, high, q)) for kind in {s.inputs for s in shapes}}
    candidates = []
    for shape in shapes:
        cancel.check()
        candidates.append(
            (shape, _train_members(inputs[shape.inputs], outputs[shape.rotates_with_joint_1], inside, shape, seed))
        )
    shape, committee, screened = _train_best(candidates, iterations, cancel, report)
    without = float(np.sqrt(np.mean(np.sum((residual / scale) ** 2, axis=1))))
    margin = _MARGIN * np.maximum(high - low, 1e-3)
    members = tuple(_layers(member.numpy(), committee.sizes) for member in committee.members)
    network = ResidualNetwork(shape.inputs, low, high, margin, shape.rotates_with_joint_1, scale, members)
    return Training(
        network=network if committee.left_out < _WORTH * without else None,
        shape=shape,
        left_out_rms=committee.left_out * scale,
        without_rms=without * scale,
        tried=tuple((tried, error * scale) for tried, error in screened),
    )


def training_steps(shapes: Sequence[Shape] = SHAPES) -> int:
    """Number of steps that the training of these candidates reports: each is trained, then the best one further."""
    return len(shapes) + 1


def _train_best(
    candidates: Sequence[tuple[Shape, Iterator[_Committee]]], iterations: int, cancel: CancelToken, report: Report
) -> tuple[Shape, _Committee, list[tuple[Shape, float]]]:
    """Train all candidates for some iterations and the best one to the end; also each one's error at the comparison."""
    compared: list[tuple[_Committee, Shape, Iterator[_Committee]]] = []
    for number, (shape, training) in enumerate(candidates):
        for committee in islice(training, min(_SCREENING, iterations)):
            cancel.check()
            if committee.iteration % _REPORTED == 1:
                report(number, f"network {number + 1} of {len(candidates)}, {_training_words(committee)}")
        compared.append((committee, shape, training))
    committee, shape, training = min(compared, key=lambda entry: entry[0].left_out)
    while committee.iteration < iterations and (later := next(training, None)) is not None:
        cancel.check()
        committee = later
        if committee.iteration % _REPORTED == 1:
            report(len(candidates), f"best network, {_training_words(committee)}")
    report(len(candidates) + 1, "network trained")
    return shape, committee, [(tried, screened.left_out) for screened, tried, _ in compared]


def _training_words(committee: _Committee) -> str:
    return f"{len(committee.members)} folds, iteration {committee.iteration}"


@dataclass(frozen=True)
class _Committee:
    """Members after an iteration: of each the parameters that predicted its fold best, and the rms over all folds."""

    members: torch.Tensor
    sizes: tuple[int, ...]
    left_out: float
    iteration: int


def _train_members(
    x: torch.Tensor, y: torch.Tensor, inside: torch.Tensor, shape: Shape, seed: int
) -> Iterator[_Committee]:
    """Train one member per fold, all at the same time, and yield the committee after each iteration.

    ``inside`` (folds, n) is 1 for the rows that train a member, 0 for its fold. Ends after ``_PATIENCE`` iterations
    without improvement.
    """
    import torch

    problem = _MemberProblem(x, y, inside, (x.shape[1], *shape.hidden, y.shape[1]))
    state = problem.start(seed)
    best, best_error = state.p.clone(), problem.left_out(state.e)
    stale = 0
    left_out_rows = (1.0 - inside).sum()
    for iteration in count_from(0):
        state, hessian = problem.step(state)
        if iteration % 2 == 0:  # not each time: the evidence is an estimate at a minimum, and costs an inverse
            state = problem.with_evidence(state, hessian)
        error = problem.left_out(state.e)
        improved = error < best_error
        best = torch.where(improved[:, None], state.p, best)
        best_error = torch.where(improved, error, best_error)
        stale = 0 if bool(improved.any()) else stale + 1
        yield _Committee(best, problem.sizes, float(torch.sqrt(best_error.sum() / left_out_rows)), iteration + 1)
        if stale >= _PATIENCE:
            return


@dataclass(frozen=True)
class _State:
    """All members during training, one per fold.

    Attributes
    ----------
    p : tensor, shape (folds, P)
        Parameters.
    e : tensor, shape (folds, 3 n)
        Errors of all rows.
    alpha, beta : tensor, shape (folds,)
        Precision of the prior on the parameters (weight decay), and of the noise.
    damping : tensor, shape (folds,)
    """

    p: torch.Tensor
    e: torch.Tensor
    alpha: torch.Tensor
    beta: torch.Tensor
    damping: torch.Tensor


class _MemberProblem:
    """Minimise ``beta sum e^2 + alpha sum p^2`` of every member over its own rows, vectorised over members."""

    def __init__(self, x: torch.Tensor, y: torch.Tensor, inside: torch.Tensor, sizes: tuple[int, ...]) -> None:
        import torch
        from torch.func import jacrev, vmap

        self.sizes = sizes
        self._x, self._y = x, y
        self._folds = len(inside)
        self._count = sum(b * a + b for a, b in pairwise(sizes))
        forward = _forward(sizes)
        at_each_row = vmap(jacrev(lambda p, row: forward(p, row)), (None, 0))
        self._jacobian = vmap(at_each_row, (0, None))
        self._predict = vmap(forward, (0, None))
        self._rows = inside[:, :, None].expand(-1, -1, y.shape[1]).reshape(self._folds, -1)
        self._identity = torch.eye(self._count, dtype=torch.float64)

    def start(self, seed: int) -> _State:
        """Random parameters with the variance that keeps the signal's scale through the layers."""
        import torch

        generator = torch.Generator().manual_seed(seed)
        layers = [
            torch.randn(self._folds, b * a + b, generator=generator, dtype=torch.float64) / (a + 1.0) ** 0.5
            for a, b in pairwise(self.sizes)
        ]
        p = torch.cat(layers, dim=1)
        ones = torch.ones(self._folds, dtype=torch.float64)
        return _State(p, self.errors(p), _DECAY * ones, ones, _DAMPING[0] * ones)

    def errors(self, p: torch.Tensor) -> torch.Tensor:
        off: torch.Tensor = (self._y - self._predict(p, self._x)).reshape(self._folds, -1)
        return off

    def left_out(self, e: torch.Tensor) -> torch.Tensor:
        """Sum of squared errors of each member on its left-out fold, shape (folds,)."""
        return ((1.0 - self._rows) * e**2).sum(dim=1)

    def step(self, state: _State) -> tuple[_State, torch.Tensor]:
        """A Levenberg-Marquardt step of each member, taken where it lowers the objective; and the Hessian before it."""
        import torch

        J = self._jacobian(state.p, self._x).reshape(self._folds, -1, self._count) * self._rows[:, :, None]
        gram = J.transpose(1, 2) @ J
        slope = (J.transpose(1, 2) @ state.e[:, :, None])[:, :, 0]
        H = state.beta[:, None, None] * gram + state.alpha[:, None, None] * self._identity
        damped = H + state.damping[:, None, None] * torch.diag_embed(torch.diagonal(H, dim1=1, dim2=2))
        descent = (state.beta[:, None] * slope - state.alpha[:, None] * state.p)[:, :, None]
        p = state.p + torch.cholesky_solve(descent, torch.linalg.cholesky(damped))[:, :, 0]
        e = self.errors(p)
        better = self._objective(e, p, state) < self._objective(state.e, state.p, state)
        _, factor, least, most = _DAMPING
        stepped = replace(
            state,
            p=torch.where(better[:, None], p, state.p),
            e=torch.where(better[:, None], e, state.e),
            damping=torch.where(better, state.damping / factor, state.damping * factor).clamp(least, most),
        )
        return stepped, H

    def with_evidence(self, state: _State, hessian: torch.Tensor) -> _State:
        """Decay and noise that maximise the evidence, given the number gamma of parameters that the data determine."""
        import torch

        inverse = torch.cholesky_inverse(torch.linalg.cholesky(hessian))
        gamma = self._count - state.alpha * torch.diagonal(inverse, dim1=1, dim2=2).sum(dim=1)
        data, squares = self._rows.sum(dim=1), (self._rows * state.e**2).sum(dim=1)
        return replace(
            state,
            alpha=(gamma / (state.p**2).sum(dim=1).clamp_min(1e-12)).clamp(1e-6, 1e6),
            beta=((data - gamma).clamp_min(1.0) / squares.clamp_min(1e-12)).clamp(1e-6, 1e9),
        )

    def _objective(self, e: torch.Tensor, p: torch.Tensor, state: _State) -> torch.Tensor:
        return state.beta * (self._rows * e**2).sum(dim=1) + state.alpha * (p**2).sum(dim=1)


def _forward(sizes: Sequence[int]) -> Callable[[Any, Any], Any]:
    """The function ``f(parameters (P,), rows (..., in))`` of a perceptron with these layer sizes."""
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
    """Weights and offsets of each layer from a parameter vector (P,)."""
    layers, place = [], 0
    for a, b in pairwise(sizes):
        weights = p[place : place + b * a].reshape(b, a).copy()
        layers.append((weights, p[place + b * a : place + b * a + b].copy()))
        place += b * a + b
    return tuple(layers)
