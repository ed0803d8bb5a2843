"""Residual network of an arm model: evaluation with numpy alone, and its JSON form.

A committee of small multilayer perceptrons (tanh, linear output) maps joint positions to the residual of the SMR
position. The mean of the members is the correction, their standard deviation its uncertainty. Outside the trained joint
ranges the correction fades to zero over a margin, because a network does not extrapolate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from cellapp.robot.kinematics.transforms import Array

Inputs = Literal["angles", "sincos", "both"]
Layers = tuple[tuple[Array, Array], ...]


@dataclass(frozen=True)
class ResidualNetwork:
    """A trained committee.

    Attributes
    ----------
    inputs : str
        ``angles`` scaled to the trained ranges, ``sincos``, or ``both``.
    low, high : array, shape (N,)
        Trained joint ranges [rad].
    margin : array, shape (N,)
        Distance outside the ranges over which the correction fades to zero [rad].
    rotates_with_joint_1 : bool
        Whether the members' output frame rotates with joint 1 about z. Effects of gravity and gears do not depend on
        joint 1 in that frame. The correction is rotated back.
    scale : float
        Scale of the outputs [m].
    members : tuple of layers
        For each member and layer: weights (out, in) and offsets (out,).
    """

    inputs: Inputs
    low: Array
    high: Array
    margin: Array
    rotates_with_joint_1: bool
    scale: float
    members: tuple[Layers, ...]

    def correct(self, q: Array) -> Array:
        """Compute the correction (n, 3) [m] of SMR positions at ``q`` (n, N) [rad], in the frame of its training."""
        correction = self._each(q).mean(axis=0) * self._fade(q)
        return rotate_about_z(correction, q[:, 0]) if self.rotates_with_joint_1 else np.asarray(correction)

    def spread(self, q: Array) -> Array:
        """Compute the standard deviation (n, 3) [m] of the members at ``q`` (n, N) [rad]."""
        each = self._each(q)
        if self.rotates_with_joint_1:
            each = np.array([rotate_about_z(member, q[:, 0]) for member in each])
        return np.asarray(each.std(axis=0, ddof=1) * self._fade(q))

    def _each(self, q: Array) -> Array:
        x = network_inputs(self.inputs, self.low, self.high, q)
        outputs = []
        for layers in self.members:
            y = x
            for weights, offsets in layers[:-1]:
                y = np.tanh(y @ weights.T + offsets)
            weights, offsets = layers[-1]
            outputs.append(y @ weights.T + offsets)
        return np.asarray(outputs) * self.scale

    def _fade(self, q: Array) -> Array:
        beyond = np.maximum(np.maximum(self.low - q, q - self.high), 0.0) / self.margin
        each = np.where(beyond < 1.0, 0.5 * (1.0 + np.cos(np.pi * np.minimum(beyond, 1.0))), 0.0)
        return np.asarray(each.prod(axis=1)[:, None])


def network_to_json(network: ResidualNetwork) -> dict[str, Any]:
    """Convert a network to a JSON object; floats are exact."""
    return {
        "inputs": network.inputs,
        "low": network.low.tolist(),
        "high": network.high.tolist(),
        "margin": network.margin.tolist(),
        "turning_with_joint_1": network.rotates_with_joint_1,
        "scale_m": network.scale,
        "activation": "tanh",
        "members": [
            [{"weights": weights.tolist(), "offsets": offsets.tolist()} for weights, offsets in layers]
            for layers in network.members
        ],
    }


def network_from_json(content: Mapping[str, Any]) -> ResidualNetwork:
    """Parse an object from ``network_to_json``; raise ``KeyError``, ``ValueError`` or ``TypeError`` for others."""
    if content["inputs"] not in get_args(Inputs) or content["activation"] != "tanh":
        raise ValueError(f"unknown inputs '{content['inputs']}' or activation '{content['activation']}' of the network")
    return ResidualNetwork(
        inputs=content["inputs"],
        low=np.array(content["low"], dtype=np.float64),
        high=np.array(content["high"], dtype=np.float64),
        margin=np.array(content["margin"], dtype=np.float64),
        rotates_with_joint_1=bool(content["turning_with_joint_1"]),
        scale=float(content["scale_m"]),
        members=tuple(
            tuple(
                (np.array(layer["weights"], dtype=np.float64), np.array(layer["offsets"], dtype=np.float64))
                for layer in layers
            )
            for layers in content["members"]
        ),
    )


def rotate_about_z(vectors: Array, angles: Array) -> Array:
    """Rotate vectors (n, 3) about z by ``angles`` (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def network_inputs(kind: Inputs, low: Array, high: Array, q: Array) -> Array:
    """Compute inputs of the first layer from ``q`` (n, N) [rad], by ``kind``: angles scaled to [-1, 1], (n, N), cosines
    and sines, (n, 2 N), or both in this order."""
    parts = []
    if kind != "sincos":
        parts.append((q - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-9))
    if kind != "angles":
        parts += [np.cos(q), np.sin(q)]
    return np.hstack(parts)
