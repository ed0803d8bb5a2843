"""A client in a process of its own, which says how many results it keeps, or in a thread of the test."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from cellapp.ground.scale.executor import Resources
from cellapp.ground.scale.gather import Gathered, gather
from cellapp.interfaces.cli.job import Job
from cellapp.interfaces.cli.program import run_program
from tests.ground.scale.kinds import LONGEST_S, Number, Shared, Square, squares

ROOT = Path(__file__).parents[3]


def started_client(resources: Resources, shared: Shared, *numbers: Number) -> subprocess.Popen[str]:
    """Start a client."""
    arguments = [
        json.dumps([resources.jobs, resources.scheduler, str(resources.store)]),
        shared.model_dump_json(),
        *(number.model_dump_json() for number in numbers),
    ]
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "tests.ground.scale.client", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        start_new_session=True,  # its Ctrl-C reaches its workers and not this process
    )


def has_kept(client: subprocess.Popen[str], done: int) -> None:
    """Wait until the client has stored so many results."""
    assert client.stdout is not None
    for line in client.stdout:
        if line == f"{done} kept\n":
            return
    raise AssertionError(f"the client ended before it kept {done} results")


def last_words(client: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Wait for the end of a client: its exit code, the last line it printed, and its standard error."""
    out, err = client.communicate(timeout=LONGEST_S)
    return client.returncode, out.splitlines()[-1] if out else "", err


@contextmanager
def client_here(resources: Resources, shared: Shared, *numbers: Number) -> Iterator[Future[Gathered[Square]]]:
    """The same in a thread of this process, where nobody kills it: it starts sooner."""
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(gather, squares(shared, *numbers), "squares", resources)


def main() -> None:
    """Gather the numbers that the arguments name."""
    jobs, scheduler, store = json.loads(sys.argv[1])
    shared = Shared.model_validate_json(sys.argv[2])
    numbers = [Number.model_validate_json(text) for text in sys.argv[3:]]
    with Job(None) as job:
        resources = Resources(jobs, scheduler, Path(store))
        gathered = gather(
            squares(shared, *numbers), "squares", resources, lambda event: job.say(f"{event.done} kept"), job.control
        )
        job.say(json.dumps([one.square for one in gathered.found]))


if __name__ == "__main__":
    run_program(main)
