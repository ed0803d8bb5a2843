"""Link failures: two emulated UR controllers, the real client, random faults; how soon all arms of the cell stop.

This needs no hardware. The controllers run in their own process on two loopback addresses. The arms are wired to the
reaction of the whole cell as in collecting.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from cellapp.ground.errors import CheckFailed, HardwareError
from cellapp.ground.progress import CancelToken, Listener, Progress, ignore
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.options import JsonOption
from drivers.emulators.ur_controller import EmulatorProcess, start_in_process
from tests.trials.command import run_trial, trial_command
from tests.trials.link_arms import controllers, disconnect, driver
from tests.trials.link_bench import LinkBench
from tests.trials.link_faults import shuffled
from tests.trials.link_results import LinkLog, LinksResult
from tests.trials.link_tables import link_tables
from tests.trials.person import person_trial
from tests.trials.person_results import person_table

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


def links(
    moves: Annotated[int, typer.Option("--moves", min=2, help="Motions in all, of two arms at once.")] = 1000,
    every: Annotated[int, typer.Option("--every", min=2, help="Motions to each fault.")] = 20,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Draws targets and faults.")] = 0,
    person: Annotated[
        Path | None, typer.Option("--person", metavar="PROFILE", help="Press STOP in a terminal on this emulated cell.")
    ] = None,
    presses: Annotated[int, typer.Option("--presses", min=1, help="With --person: presses of each key.")] = 50,
    repeats: Annotated[int, typer.Option("--repeats", min=1, help="With --person: of each way to leave.")] = 10,
    busy: Annotated[int, typer.Option("--busy", min=0, help="With --person: processes that compute beside it.")] = 0,
    json_file: JsonOption = None,
) -> None:
    """Two emulated UR arms under the real client, random faults: how soon every arm of the cell stops."""
    with Job(json_file) as job:
        if person is not None:
            _person(job, person, presses, repeats, busy)
            return
        result = link_trials(moves, every, seed, job.listen, job.control)
        job.show(link_tables(result))
        job.say(f"{result.moves} moves, {result.faults} faults, {len(result.complaints)} complaints")
        if result.host_stalls:
            job.say(
                f"this computer stalled in {result.host_stalls} motions; the controllers' watchdogs stopped the arms"
            )
        job.say(*result.complaints)
        job.result(result)
        if result.complaints:
            raise CheckFailed(f"trials links: {len(result.complaints)} things were not as specified; see above")


def _person(job: Job, profile: Path, presses: int, repeats: int, busy: int) -> None:
    result = person_trial(profile, presses, repeats, busy, job.listen, job.control)
    job.show([person_table(result)])
    job.result(result)
    if result.missed():
        raise CheckFailed(f"trials links: bars were missed, or not measured: {'; '.join(result.missed())}")


app = trial_command(links)

if __name__ == "__main__":
    run_trial(app, "links")
