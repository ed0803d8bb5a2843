"""The method ``neural-network``: residuals of the geometry by a small network of torch. It names nothing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cellapp.commands.trials.benchmark.methods.gaussian_process import on_circles
from cellapp.commands.trials.benchmark.problem import Answer, Problem
from cellapp.robot.kinematics.transforms import Array

_HIDDEN, _STEPS, _PATIENCE = 32, 1500, 150
_RATE, _DECAY = 3e-3, 1e-3
_SEED = 0


def neural_network(problem: Problem) -> Answer:
    """Predict by geometry and network; training stops when left-out rows get worse."""
    model, residual = problem.geometry_fit.model, problem.geometry_residual
    scale = float(residual.std()) or 1.0
    found = _trained(on_circles(problem.learn.q), residual / scale, on_circles(problem.held_out.q))
    return Answer(problem.predicted(model) + scale * found)


def _trained(table: Array, y: Array, asked: Array) -> Array:
    """Train a network on ``y`` (n, 3) from ``table``; return its best state's values (m, 3) at rows ``asked``."""
    import torch

    generator = torch.Generator().manual_seed(_SEED)
    sizes = (table.shape[1], _HIDDEN, _HIDDEN, y.shape[1])
    weights = [
        torch.randn(a, b, generator=generator, dtype=torch.float64).div_(a**0.5).requires_grad_()
        for a, b in pairwise(sizes)
    ]
    biases = [torch.zeros(b, dtype=torch.float64, requires_grad=True) for b in sizes[1:]]

    def output(x: torch.Tensor) -> torch.Tensor:
        for place, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            x = x @ weight + bias
            if place < len(weights) - 1:
                x = torch.tanh(x)
        return x

    x, target, at = (torch.tensor(part) for part in (table, y, asked))
    tested = torch.arange(len(x)) % 5 == 0
    optimizer = torch.optim.AdamW([*weights, *biases], lr=_RATE, weight_decay=_DECAY)
    best, found, since = float((target[tested] ** 2).mean()), np.zeros((len(asked), y.shape[1])), 0
    for _ in range(_STEPS):
        optimizer.zero_grad()
        torch.autograd.backward(((output(x[~tested]) - target[~tested]) ** 2).mean())
        optimizer.step()
        with torch.no_grad():
            left, since = float(((output(x[tested]) - target[tested]) ** 2).mean()), since + 1
            if left < best:
                best, found, since = left, output(at).numpy().copy(), 0
        if since > _PATIENCE:
            break
    return found
