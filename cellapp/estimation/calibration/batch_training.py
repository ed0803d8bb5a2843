"""Training of the residual network from all readings, in batches, by torch.

The committee of ``network_training`` solves normal equations, whose time limits it to some thousand readings; its
evidence and its few units generalise well to configurations that were never measured. Training in batches starts from
it: each member of the committee gets two more hidden layers that learn its residuals, by Adam (Kingma, Ba, ICLR 2015)
from batches drawn from all readings outside its fold. They start at zero correction and keep the weights that predicted
the fold best. The learning rate falls along a cosine to zero. The number of steps is bounded: a million readings take
hardly longer than a hundred thousand.

torch is loaded here only. The result is stored as a ``ResidualNetwork``, which numpy evaluates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.errors import InputError
from cellapp.ground.progress import CancelToken, Told
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.network import Layers

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
