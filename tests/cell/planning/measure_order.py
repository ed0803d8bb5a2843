"""Order, factors and ways of designed plans, measured: a table by profile and seed.

    python -m tests.cell.planning.measure_order [--stops N] [--seeds N] [PROFILE ...]

Stops are drawn at random, a third more than are planned. Times are of one process on this computer.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from cellapp.cell.planning.balance import correlations, travel_time
from cellapp.cell.planning.plan import draw_stops
from cellapp.cell.planning.sequence import sequenced
from cellapp.cell.planning.transit_paths import TransitPlanner
from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import cell_bodies, home_positions
from tests.cell.planning.planned_cells import refusals
from tests.twin import PROFILES

_HEAD = (
    "profile       seed stops given up  random h  planned h  saved  largest r  of                         detours"
    " refused     s"
)
_MORE = 1.35


def measure(path: Path, stops: int, seed: int) -> str:
    """One row of the table."""
    profile = load_profile(path)
    plan = profile.plan.model_copy(update={"stops": stops, "reserve": 0})
    profile = profile.model_copy(update={"plan": plan})
    cell, homes = cell_bodies(profile), home_positions(profile)
    chosen = draw_stops(cell, profile, int(_MORE * stops), np.random.default_rng(seed))
    began = time.process_time()
    rng = np.random.default_rng(seed)
    finder = TransitPlanner(profile, cell, rng)
    found = sequenced(profile, cell, chosen, rng, finder=finder)
    took_s = time.process_time() - began
    travel = travel_time(profile, found.stops, finder, np.random.default_rng(seed))
    worst = max(correlations(profile, cell, found.stops), key=lambda one: abs(one.correlation))
    refused = refusals(cell, found.stops, homes, homes)
    return (
        f"{path.stem:14}{seed:4d} {len(found.stops):5d} {len(found.given_up):8d} {travel.random_order_s / 3600:9.2f}"
        f" {travel.planned_s / 3600:10.2f} {travel.saved:6.1%} {abs(worst.correlation):10.3f}  {worst.factor:26.26}"
        f" {sum(map(bool, found.stops.legs)):6d} {len(refused):7d} {took_s:5.1f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("profiles", nargs="*", default=["twin", "twin-paper"])
    parser.add_argument("--stops", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    print(_HEAD)  # noqa: T201
    for name in given.profiles:
        for seed in range(1, given.seeds + 1):
            print(measure(PROFILES / f"{name}.yaml", given.stops, seed), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
