"""Which stops identify, train and validate: drawn once by the profile's seed, stored in the run, never leaking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SplitPlan:
    """How many stops each use gets, and what had to be changed to fit.

    ``notes`` says where fewer stops than asked for were there.
    """

    identify: int
    train: int
    validate: int
    notes: tuple[str, ...]


def plan_splits(n: int, identify: int, train: int, validate: int | None) -> SplitPlan:
    """Sizes for ``n`` stops; ``validate`` None takes the rest. Scaled down together where there are too few."""
    wanted = max(1, n // 5) if validate is None else validate
    if identify + train + (1 if validate is None else validate) <= n:
        return SplitPlan(identify, train, n - identify - train if validate is None else validate, ())
    share = n / (identify + train + wanted)
    fewer_identify = max(1, int(identify * share))
    fewer_train = min(int(train * share), n - fewer_identify - 1)
    fewer_validate = n - fewer_identify - fewer_train
    note = (
        f"{n} stops are too few for identify {identify}, train {train}, validate {validate or 'rest'}:"
        f" used {fewer_identify}, {fewer_train}, {fewer_validate} instead"
    )
    return SplitPlan(fewer_identify, fewer_train, fewer_validate, (note,))


def draw_splits(
    configurations: NDArray[np.int64], identify: int, train: int, validate: int | None, seed: int
) -> tuple[dict[int, str | None], tuple[str, ...]]:
    """Draw a split for each configuration number; stops beyond the asked ones get None.

    The draw depends on the set of numbers and the seed alone, not on order.
    """
    numbers = np.unique(configurations)
    plan = plan_splits(len(numbers), identify, train, validate)
    order = np.random.default_rng([seed, 0x5EED]).permutation(numbers)
    words = ["identify"] * plan.identify + ["train"] * plan.train + ["validate"] * plan.validate
    drawn: dict[int, str | None] = {int(number): None for number in numbers}
    drawn.update({int(number): word for number, word in zip(order, words)})
    return drawn, plan.notes
