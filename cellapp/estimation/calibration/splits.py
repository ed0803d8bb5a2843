"""Random assignment of stops to identification, training and validation, reproducible by the profile's seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellapp.ground.counting import counted


@dataclass(frozen=True)
class SplitSizes:
    """Number of stops in each split; ``notes`` report if there are fewer stops than the profile requires."""

    identify: int
    train: int
    validate: int
    notes: tuple[str, ...]


def split_sizes(n: int, identify: int, train: int, validate: int | None) -> SplitSizes:
    """Compute split sizes of ``n`` stops; ``validate`` None takes the rest. Too few stops reduce all in proportion."""
    wanted = max(1, n // 5) if validate is None else validate
    if identify + train + (1 if validate is None else validate) <= n:
        return SplitSizes(identify, train, n - identify - train if validate is None else validate, ())
    share = n / (identify + train + wanted)
    less_identify = max(1, int(identify * share))
    less_train = min(int(train * share), n - less_identify - 1)
    less_validate = n - less_identify - less_train
    note = (
        f"{counted(n, 'stop is', 'stops are')} too few for identify {identify}, train {train}, validate"
        f" {validate or 'rest'}: used {less_identify}, {less_train}, {less_validate} instead"
    )
    return SplitSizes(less_identify, less_train, less_validate, (note,))


def draw_splits(
    configurations: NDArray[np.int64], identify: int, train: int, validate: int | None, seed: int
) -> tuple[dict[int, str | None], tuple[str, ...]]:
    """Draw a split for each configuration number; stops beyond the required ones get None. Return splits and notes.

    The draw depends on the set of numbers and the seed, not on the order of ``configurations``.
    """
    numbers = np.unique(configurations)
    sizes = split_sizes(len(numbers), identify, train, validate)
    order = np.random.default_rng([seed, 0x5EED]).permutation(numbers)
    words = ["identify"] * sizes.identify + ["train"] * sizes.train + ["validate"] * sizes.validate
    drawn: dict[int, str | None] = {int(number): None for number in numbers}
    drawn.update({int(number): word for number, word in zip(order, words)})
    return drawn, sizes.notes
