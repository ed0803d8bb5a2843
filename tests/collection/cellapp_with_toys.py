"""``cellapp`` with one more line in each registry. Argument: a JSON list of commands; prints their exit codes."""

from __future__ import annotations

import json
import sys

import drivers.arms.registry
import drivers.sensors.registry
import drivers.trackers.registry
from tests.collection.toys.arm import ToyArmSettings
from tests.collection.toys.station import ToyStationSettings
from tests.collection.toys.tracker import ToyTrackerSettings

drivers.arms.registry.ARMS += (ToyArmSettings,)
drivers.trackers.registry.TRACKERS += (ToyTrackerSettings,)
drivers.sensors.registry.AIR_SENSORS += (ToyStationSettings,)

from cellapp.cli import main  # noqa: E402  (the schema is built from the registries when it is imported)


def exit_code(words: list[str]) -> int | str | None:
    """Run one command."""
    sys.argv = ["cellapp", *words]
    try:
        main()
    except SystemExit as end:
        return end.code
    return 0


if __name__ == "__main__":
    codes = [exit_code(words) for words in json.loads(sys.argv[1])]
    sys.stdout.write(f"\n{json.dumps(codes)}\n")
