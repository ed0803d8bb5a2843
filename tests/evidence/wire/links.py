"""Link failures: two emulated UR controllers, the real client, random faults; how soon all arms of the cell stop.

This needs no hardware. The controllers run in their own process on two loopback addresses. The arms are wired to the
reaction of the whole cell as in collecting.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack

import numpy as np

from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from drivers.emulators.ur_controller import EmulatorProcess, start_in_process
from tests.evidence.wire.link_arms import controllers, disconnect, driver
from tests.evidence.wire.link_bench import LinkBench
from tests.evidence.wire.link_faults import shuffled
from tests.evidence.wire.link_results import LinkLog, LinksResult

HOSTS = {"left": "127.0.0.2", "right": "127.0.0.3"}
"""Loopback addresses of the two arms: two, as the client uses the standard ports only."""
_STEP_WITHIN_S = 60.0
"""No step takes longer, with fault, repair and connecting."""


def link_trials(
    moves: int = 1000,
    every: int = 20,
    seed: int = 0,
    listener: Listener = ignore,
    cancel: CancelToken | None = None,
    hosts: Mapping[str, str] = HOSTS,
) -> LinksResult:
    """Move two arms at once, ``moves`` motions in all; one in ``every`` meets a random fault at a random moment.

    ``hosts`` has an address for ``left`` and one for ``right``. After a fault both arms are stopped and watched; then
    the fault is repaired as an operator would, and the cell is released.

    Raises
    ------
    HardwareError
        If the emulated controllers cannot be started.
    Cancelled
    """
    cancel = cancel or CancelToken()
    random = np.random.default_rng(seed)
    log = LinkLog()
    steps = max(1, moves // len(hosts))
    between = max(1, every // len(hosts))
    faults = shuffled(random)
    with ExitStack() as stack:
        emulator = stack.enter_context(_emulated(hosts))
        arms = {name: driver(name, host) for name, host in hosts.items()}
        for arm in arms.values():
            stack.callback(disconnect, arm)
            began = time.monotonic()
            arm.connect()
            log.connect_s.append(time.monotonic() - began)
        bench = LinkBench(log, emulator, arms, hosts, random)
        for step in range(steps):
            cancel.check()
            listener(Progress("links", step * len(hosts), steps * len(hosts), f"{len(log.struck)} faults"))
            began = time.monotonic()
            if step % between == between - 1:
                fault, moment = faults()
                bench.cause_fault(fault, moment, str(random.choice(list(hosts))))
            else:
                bench.step()
            took = time.monotonic() - began
            log.longest_step_s = max(log.longest_step_s, took)
            if took > _STEP_WITHIN_S:
                log.complain(f"step {step + 1} took {took:.0f} s")
            log.moves += len(hosts)
        listener(Progress("links", steps * len(hosts), steps * len(hosts), "done"))
    return log.result()


def _emulated(hosts: Mapping[str, str]) -> EmulatorProcess:
    try:
        return start_in_process(controllers(hosts))
    except (OSError, TimeoutError) as error:
        raise HardwareError(f"the emulated controllers do not start: {error}") from error
