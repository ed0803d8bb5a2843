"""Sets of sealed runs in blocks: in turn, gone on with, with a time to keep, shares with intervals."""

from __future__ import annotations

from collections import Counter
from itertools import count
from pathlib import Path

import pytest
from scipy.stats import binom

from cellapp.commands.trials.truth import SETS, Share, sizes_of, truth_table, truth_trials
from cellapp.ground.errors import InputError
from cellapp.ground.time_limit import TimeLimit
from tests.commands.trials.test_sealed import small

NONE_OF_THEM = dict.fromkeys(SETS, 0)


@pytest.mark.fast
def test_intervals_are_those_of_the_binomial() -> None:
    share = Share.of([True] * 3 + [False] * 97)
    assert share is not None
    assert binom.sf(2, 100, share.low) == pytest.approx(0.025)
    assert binom.cdf(3, 100, share.high) == pytest.approx(0.025)
    none, every = Share.of([False] * 600), Share.of([True] * 10)
    assert none is not None
    assert none.low == 0.0
    assert none.high == pytest.approx(0.0061, abs=1e-4)
    assert every is not None
    assert every.high == 1.0
    assert Share.of([]) is None


@pytest.mark.fast
def test_sizes_are_read_by_set() -> None:
    assert sizes_of("") == {name: one.runs for name, one in SETS.items()}
    assert sum(sizes_of("").values()) == 1300
    assert sizes_of("clean=50, few=0")["clean"] == 50
    for wrong in ("clear=5", "clean", "clean=-1", "clean=many"):
        with pytest.raises(InputError, match="--runs"):
            sizes_of(wrong)


def test_blocks_take_turns_and_are_gone_on_with(tmp_path: Path) -> None:
    sizes = {**NONE_OF_THEM, "clean": 1, "few": 1}
    ticks = count(50.0, 50.0)
    first = truth_trials(small(), tmp_path, sizes, 3, limit=TimeLimit(1.0, 0.0, lambda: next(ticks)))
    assert (first.total.runs, first.total.wanted) == (1, 2)
    whole = truth_trials(small(), tmp_path, sizes, 3)
    assert {name: score.runs for name, score in whole.sets.items()} == {"clean": 1, "few": 1}
    assert whole.failed == ()
    clean = whole.sets["clean"].false_names
    assert clean is not None
    assert clean.n == 2
    assert Counter(row[0] for row in truth_table(whole).rows) == {"clean": 1, "few": 1, "total": 1}
    with pytest.raises(InputError, match="another seed"):
        truth_trials(small(), tmp_path, sizes, 4)
