"""Candidate laws: columns of either kind are whitened alike."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.discovery.terms import whitened_displacements
from cellapp.robot.effects import Channel, EffectColumn

pytestmark = pytest.mark.fast


def test_joint_offsets_and_smr_shifts_are_whitened_alike() -> None:
    rng = np.random.default_rng(8)
    n = 20
    white = rng.normal(size=(3, 3, n))
    by_joint = rng.normal(size=(3, 6, n))
    offset, shift = rng.normal(size=n), rng.normal(size=(n, 3))
    columns = (
        EffectColumn("shift", "m", "base", -1, 1, Channel.BASE, shift_M=shift),
        EffectColumn("offset", "rad", "joint 3", -1, 1, Channel.JOINT, 2, offset=offset),
    )
    rows = whitened_displacements(columns, np.einsum("acn,cjn->ajn", white, by_joint), white)
    np.testing.assert_allclose(rows[0].reshape(3, n), np.einsum("acn,nc->an", white, shift), atol=1e-12)
    wanted = np.einsum("acn,cn->an", white, by_joint[:, 2] * offset)
    np.testing.assert_allclose(rows[1].reshape(3, n), wanted, atol=1e-12)
