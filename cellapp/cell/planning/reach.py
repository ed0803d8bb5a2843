"""The configurations that an arm alone can reach from home, and by which paths: a probabilistic roadmap of each arm.

Source: Kavraki, Svestka, Latombe, Overmars, IEEE Transactions on Robotics and Automation 12 (1996) 566. Motions are
checked at a few samples only, with a clearance enlarged by what the samples may hide; the gate decides about every
motion. A configuration that the roadmap does not reach is, with few exceptions, shut off by joint limits, by the arm
itself or by the cell.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from cellapp.cell.planning.duration import motion_s
from cellapp.cell.safety.bodies import place
from cellapp.cell.safety.gate import CellBodies, clear_alone, with_margin_for_ways
from cellapp.ground.profile import Profile
from cellapp.robot.kinematics.transforms import Array

_NODES = 300
"""Nodes of a roadmap besides home: it is built in a quarter of a second."""
_NEIGHBOURS = 12
"""Number of nearest nodes to which a node is connected if the motion is clear."""
_PLACES = (8, 4, 12, 2, 14, 6, 10, 1, 15, 3, 13, 5, 11, 7, 9)
"""Sixteenths of a motion at which an arm is checked, the most selective first."""
_DRAWS = 40
"""Upper limit of the random configurations drawn for each node."""
_AT_ONCE = 4000
"""Number of motions that are checked at once."""


class ArmRoadmap:
    """Clear configurations of one arm and the clear motions between them; the first is home."""

    def __init__(self, profile: Profile, cell: CellBodies, name: str, rng: np.random.Generator) -> None:
        self._arm, self._bodies, self._cell = profile.arms[name], cell.arms[name], with_margin_for_ways(cell)
        self._rng = rng
        self._home = None if self._arm.home is None else np.array(self._arm.home)

    @property
    def rest(self) -> Array:
        """Home; for an arm without one, some clear configuration."""
        return self._nodes[0] if self._home is None else self._home

    def reaches(self, q: Array) -> NDArray[np.bool_]:
        """Return whether the arm can go from home to configurations ``q`` (n, N) [rad], without regard to others, (n,).

        For an arm without home: whether they connect to the largest connected part of its roadmap.
        """
        reached: NDArray[np.bool_] = np.zeros(len(q), dtype=np.bool_)
        clear = np.flatnonzero(self._clear(q))
        if self._home is not None:
            reached[clear] = self.clear_ways(np.broadcast_to(self._home, q[clear].shape), q[clear])
        left = clear[~reached[clear]]
        for rows in np.array_split(left, 1 + len(left) * _NEIGHBOURS // _AT_ONCE) if len(left) else ():
            near = self._nearest(q[rows])
            free = self.clear_ways(np.repeat(q[rows], near.shape[1], axis=0), self._nodes[near.ravel()])
            reached[rows] = np.any(free.reshape(near.shape) & (self._part[near] == self._main_part), axis=1)
        return reached

    def path(self, start: Array, end: Array) -> list[Array] | None:
        """Find configurations (N,) between two others, on a path that takes little time; None if there is none."""
        nodes = np.concatenate([self._nodes, start[None], end[None]])
        n = len(nodes)
        i = np.append(np.repeat([n - 2, n - 1], n - 2), n - 2)  # both ends to all nodes, and to each other
        k = np.append(np.tile(np.arange(n - 2), 2), n - 1)
        free = self.clear_ways(nodes[i], nodes[k])
        i, k = np.concatenate([i[free], self._edges[0]]), np.concatenate([k[free], self._edges[1]])
        graph = scipy.sparse.coo_matrix((motion_s(self._arm, nodes[k] - nodes[i]) + 1e-9, (i, k)), shape=(n, n)).tocsr()
        seconds, before = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=n - 2, return_predecessors=True)
        if not np.isfinite(seconds[n - 1]):
            return None
        found, node = [], int(before[n - 1])
        while node != n - 2:
            found.append(nodes[node])
            node = int(before[node])
        return found[::-1]

    def clear_ways(self, start: Array, end: Array) -> NDArray[np.bool_]:
        """Return whether the arm is clear at the samples of motions from ``start`` (n, N) to ``end`` (n, N), (n,)."""
        free = np.ones(len(start), dtype=bool)
        for place_on_way in _PLACES:
            left = np.flatnonzero(free)
            share = place_on_way / 16.0
            free[left] = self._clear((1.0 - share) * start[left] + share * end[left])
        return free

    def _clear(self, q: Array) -> NDArray[np.bool_]:
        return np.asarray(clear_alone(self._cell, place(self._bodies, q)))

    @cached_property
    def _nodes(self) -> Array:
        """Home and random clear configurations (m, N) [rad], at most half a turn from home where limits allow that."""
        low, high = self._bodies.limits.T
        centre = 0.5 * (low + high) if self._home is None else self._home
        found = [centre[None]] if self._home is not None else []
        middle = np.clip(centre, np.minimum(low + np.pi, high), np.maximum(high - np.pi, low))
        for _ in range(_DRAWS):
            if sum(map(len, found)) > _NODES:
                break
            low_here, high_here = np.maximum(low, middle - np.pi), np.minimum(high, middle + np.pi)
            q = self._rng.uniform(low_here, high_here, (_NODES, len(low)))
            found.append(q[self._clear(q)])
        return np.concatenate([*found, centre[None]])[: _NODES + 1]

    @cached_property
    def _edges(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pairs of nodes that clear motions connect: to the nearest ones, and to home."""
        nodes = self._nodes
        near = self._nearest(nodes)
        i = np.concatenate([np.repeat(np.arange(len(nodes)), near.shape[1]), np.arange(1, len(nodes))])
        k = np.concatenate([near.ravel(), np.zeros(len(nodes) - 1, dtype=np.intp)])
        free = self.clear_ways(nodes[i], nodes[k]) & (i != k)
        return i[free], k[free]

    @cached_property
    def _part(self) -> NDArray[np.intp]:
        """Index of the connected part of each node (m,)."""
        i, k = self._edges
        n = len(self._nodes)
        graph = scipy.sparse.coo_matrix((np.ones(len(i)), (i, k)), shape=(n, n))
        return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.intp)

    @cached_property
    def _main_part(self) -> int:
        return int(np.argmax(np.bincount(self._part)) if self._home is None else self._part[0])

    def _nearest(self, q: Array) -> NDArray[np.intp]:
        """Return the indices of the nodes nearest in time to each configuration (n, neighbours)."""
        nodes = self._nodes
        way = (nodes[None] - q[:, None]).reshape(-1, q.shape[1])
        seconds = motion_s(self._arm, way).reshape(len(q), len(nodes))
        return np.argsort(seconds, axis=1, kind="stable")[:, :_NEIGHBOURS]
