"""From ``brake`` to the stop at the controllers: ``python -m tests.benchmarks.measure_brakes [BRAKES] [BUSY]``.

Brakes two moving arms at emulated controllers at once, ``BRAKES`` times (100), beside ``BUSY`` (0) processes that
compute without a pause. Prints how long after the call the first stop reached the controller, in all and by its way:
``stopj`` the control program, ``program`` the dashboard.
"""

from __future__ import annotations

import statistics
import sys
import threading
import time
from collections import defaultdict
from contextlib import ExitStack, suppress

import numpy as np

from drivers.arms.protocol import ArmError, LinkLost
from drivers.arms.ur import UrArm
from drivers.arms.ur_settings import UrSettings
from drivers.emulators.ur_controller import EmulatorProcess
from tests.benchmarks.measure_starts import busy
from tests.drivers.arms.emulated_ur_cell import (
    ACCELERATION,
    FAR,
    HOME,
    HOSTS,
    UNHURRIED,
    driven,
    emulated_cell,
)
from tests.waiting import until


class Brakes:
    """Latencies [s] by way."""

    def __init__(self, emulator: EmulatorProcess) -> None:
        self._emulator = emulator
        self.took_s: dict[str, list[float]] = defaultdict(list)
        self.failures = 0

    def start(self, arm: UrArm) -> None:
        """Let an arm move."""
        arm.connect()
        here = arm.state().q
        goal = FAR if np.abs(here - FAR).max() > np.abs(here - HOME).max() else HOME
        arm.start_move(goal, UNHURRIED, ACCELERATION)
        until(lambda: float(np.abs(arm.state().q - here).max()) > 0.1, "the arm moves")

    def brake(self, arm: UrArm, at_once: threading.Barrier) -> None:
        """Brake an arm when all are ready, and note when its controller received which stop."""
        at_once.wait()
        asked_s = time.monotonic()
        with suppress(LinkLost):
            arm.brake()
        arm.stop()
        stops = self._emulator.control(arm.name, "stops", asked_s)
        if not stops:  # something else has stopped the arm before
            self.failures += 1
            return
        first = min(stops, key=lambda stop: float(stop["received_s"]))
        for kind in ("first", str(first["kind"])):
            self.took_s[kind].append(float(first["received_s"]) - asked_s)

    def once(self, arms: list[UrArm]) -> None:
        """Move all arms and brake them."""
        try:
            for arm in arms:
                self.start(arm)
        except ArmError as error:
            self.failures += 1
            sys.stdout.write(f"not braked: {error}\n")
            for arm in arms:
                with suppress(ArmError):
                    arm.stop()
            return
        barrier = threading.Barrier(len(arms))
        threads = [threading.Thread(target=self.brake, args=(arm, barrier)) for arm in arms]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def main(brakes: int = 100, beside: int = 0) -> int:
    """Brake ``brakes`` times and print; return the exit code."""
    with ExitStack() as stack:
        seen = Brakes(stack.enter_context(emulated_cell(HOSTS)))
        arms = [stack.enter_context(driven(name, UrSettings(host=host))) for name, host in HOSTS.items()]
        stack.enter_context(busy(beside))
        for _ in range(brakes):
            seen.once(arms)
    sys.stdout.write(f"{brakes} brakes of {len(arms)} arms beside {beside} busy processes, {seen.failures} not begun\n")
    for kind, took_s in sorted(seen.took_s.items()):
        ms = sorted(1e3 * one for one in took_s)
        sys.stdout.write(f"{kind:8} n {len(ms):4}  median {statistics.median(ms):6.1f} ms  worst {ms[-1]:6.1f} ms\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:3])))
