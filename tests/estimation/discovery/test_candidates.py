"""Candidate laws: columns of either kind are whitened alike; a law keeps its best score."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.discovery.candidates import (
    CandidateLaw,
    LawScore,
    best_law_of_each_effect,
    whitened_displacements,
)
from cellapp.robot.effects import Channel, EffectColumn
from tests.estimation.discovery.linear_problem import PLAIN

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


def test_the_best_law_of_each_effect_comes_first() -> None:
    def score(slug: str, value: float) -> LawScore:
        return LawScore(CandidateLaw(slug, PLAIN.law(), (), np.zeros((0, 3))), value, (), 0.0)

    found = best_law_of_each_effect([score("one", 9.0), score("two", 8.0), score("one", 7.0)])
    assert [(one.slug, one.value) for one in found] == [("one", 9.0), ("two", 8.0)]
