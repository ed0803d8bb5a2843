"""False alarms and delays of the suspicions over many simulated series: python -m tests.cell.driving.suspicion_rates"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

from tests.cell.driving.test_suspicions import BEGIN, Fault, bump, other_smr, play, raised, slip

CLEAN_STOPS = 400
FAULTS: dict[str, Fault | None] = {
    "slip of 0.3 mm": None,
    "tilt of 0.2 mrad": bump,
    "wrong SMR": other_smr,
    "play": play,
}


def random_slip(seed: int) -> Fault:
    """A slip of 0.3 mm in a random direction, of the left or the right SMR."""
    direction = np.random.default_rng([seed, 3]).normal(size=3)
    return slip(("left", "right")[seed % 2], 0.3e-3 * direction / np.linalg.norm(direction))


def main(runs: int) -> None:
    """Print false alarms of clean series, and delays and names by fault."""
    for short, order in ((False, "in random order"), (True, "on short ways")):
        clean = [raised(seed, stops=CLEAN_STOPS, short_ways=short) for seed in range(2 * runs)]
        raising = f"{sum(map(bool, clean))} of {2 * runs} series raise anything"
        sys.stdout.write(f"clean, {CLEAN_STOPS} stops {order}: {raising}\n")
    for name, fault in FAULTS.items():
        delays, kinds, early, more = [], Counter[str](), 0, 0
        for seed in range(runs):
            found = raised(seed, fault or random_slip(seed))
            after = [(stop, one) for stop, one in found if stop >= BEGIN]
            early, more = early + (len(found) > len(after)), more + (len(after) > 1)
            if after:
                delays.append(after[0][0] - BEGIN + 1)
                kinds[after[0][1].kind] += 1
        stops = "/".join(f"{value:g}" for value in np.percentile(delays, [50, 90, 100]))
        sys.stdout.write(
            f"{name}: {len(delays)} of {runs} found, after {stops} stops (median/90 %/most), named {dict(kinds)};"
            f" before the fault {early}, more than once {more}\n"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
