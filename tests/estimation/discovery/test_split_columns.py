"""Products of columns that keep joint offsets as functions of the reading are those of whole columns."""

from __future__ import annotations

import numpy as np

from cellapp.estimation.discovery.all_readings import SplitColumns
from cellapp.estimation.discovery.joint_fit import LinearModel
from cellapp.robot.effects import Channel, EffectColumn
from tests.arms import OFF_AXIS, UR10, at_station


def test_products_and_moments_are_those_of_whole_columns():
    rng, n = np.random.default_rng(5), 40
    geometry, q = at_station(UR10, OFF_AXIS), rng.uniform(-2.0, 2.0, (n, 6))
    white = np.linalg.cholesky(np.eye(3) + 0.2 * np.ones((3, 3)))[:, :, None] * rng.uniform(0.5, 2.0, n)
    parameters = tuple(range(12))

    def column(name, channel, index=None, **moved):
        return EffectColumn(name, "", name, -np.inf, np.inf, channel, index, **moved)

    effects = [
        column("a", Channel.JOINT, 2, offset=rng.normal(size=n)),
        column("b", Channel.BASE, shift_M=rng.normal(size=(n, 3))),
        column("c", Channel.JOINT, 0, offset=rng.normal(size=n)),
        column("d", Channel.JOINT, 2, offset=rng.normal(size=n)),
        column("e", Channel.TOOL, shift_M=rng.normal(size=(n, 3))),
    ]
    for some in (effects, effects[:1], effects[1:2], []):
        whole = LinearModel.of(geometry, q, white, parameters, some).rows
        split = SplitColumns.of(LinearModel.of(geometry, q, white, parameters), some, white)
        left = rng.normal(size=(3, n))
        np.testing.assert_allclose(split.gram(), whole @ whole.T, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(split.moment(left), whole @ left.ravel(), rtol=1e-9, atol=1e-9)
