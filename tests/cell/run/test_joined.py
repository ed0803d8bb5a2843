"""Readings of one arm, one after the other."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.estimation.readings import Reading, Readings, joined


def reading(number: int, **more: object) -> Readings:
    values = {"q": np.full(3, 0.1 * number), "p_M": np.full(3, float(number)), **more}
    return Reading(**values).as_readings(number)  # type: ignore[arg-type]


def test_rows_stand_one_after_the_other_and_what_one_part_lacks_is_missing_there():
    parts = [
        reading(4, payload_kg=1.5, split="validate"),
        reading(2, approach=np.array([1, -1, 0], dtype=np.int8), covariance_M=np.eye(3)),
    ]
    whole = joined(parts)
    assert whole.configuration.tolist() == [4, 2]
    assert whole.p_M[:, 0].tolist() == [4.0, 2.0]
    assert whole.approach.tolist() == [[0, 0, 0], [1, -1, 0]]
    assert whole.split == ("validate", None)
    assert whole.payload_kg is not None
    assert whole.covariance_M is not None
    np.testing.assert_equal(whole.payload_kg, [1.5, np.nan])
    assert np.isnan(whole.covariance_M[0]).all()
    assert whole.step is None
    np.testing.assert_array_equal(joined([whole]).q, whole.q)


def test_arms_of_other_joints_do_not_join():
    with pytest.raises(ValueError, match="dimension"):
        joined([reading(1), Reading(q=np.zeros(4), p_M=np.zeros(3)).as_readings(2)])
