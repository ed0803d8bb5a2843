"""The profile's section ``notify``: its command runs on the events of a job, without a shell, and holds nothing up."""

from __future__ import annotations

import json
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.profile import load_profile
from cellapp.commands.notifying import Commands, run_notified
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.profile.notify import Notify
from cellapp.ground.progress import JobState, Listener, Notice, Progress, StateChange
from cellapp.ground.results import Result
from tests.twin import PROFILES

pytestmark = pytest.mark.fast
WAIT_S = 60.0
WRITES = """import json, os, sys
with open(sys.argv[1], "a") as file:
    file.write(json.dumps([*sys.argv[2:], os.environ["CELLAPP_TEXT"]]) + chr(10))
"""


def settings(file: Path, **more: Any) -> Notify:
    """A command that writes what it gets into a file, one line for each event."""
    return Notify(command=(sys.executable, "-c", WRITES, str(file), "{event}", "{run}"), **more)


def told(file: Path) -> list[list[str]]:
    """What the command got, after all its threads have ended."""
    for thread in threading.enumerate():
        if thread.name == "notify":
            thread.join(WAIT_S)
            assert not thread.is_alive()
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []


def change(state: JobState, done: int = 215) -> Progress:
    return Progress("collect", done, 400, detail=StateChange(state, "arm right: link lost; rm -rf $HOME"))


def heard(runner: Commands, *states: JobState) -> None:
    for state in states:
        runner.listen(change(state))


def test_it_runs_on_states_in_which_somebody_is_needed_and_no_shell_reads_it(tmp_path: Path) -> None:
    events: list[Progress] = []
    runner = Commands(settings(tmp_path / "told"), "collect", "logs/a b", events.append)
    heard(runner, "running", "stopped")
    assert told(tmp_path / "told") == [
        ["stopped", "logs/a b", "collect stopped: arm right: link lost; rm -rf $HOME, 215 of 400"]
    ]
    heard(runner, "stopped", "running", "paused")
    assert [line[0] for line in told(tmp_path / "told")] == ["stopped", "waiting"], "one for each change"
    assert [event.detail.state for event in events if isinstance(event.detail, StateChange)] == [
        "running", "stopped", "stopped", "running", "paused"
    ], "who listened before hears every event"  # fmt: skip


def test_only_the_events_that_the_section_names(tmp_path: Path) -> None:
    runner = Commands(settings(tmp_path / "told", events=("waiting",)), "collect", "", lambda event: None)
    heard(runner, "stopped", "suspended")
    runner.tell("done", "done")
    assert [line[0] for line in told(tmp_path / "told")] == ["waiting"]


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("no-such-program-of-cellapp",), "cannot be run"),
        ((sys.executable, "-c", "raise SystemExit(3)"), "exit code 3"),
        ((sys.executable, "-c", "import time; time.sleep(60)"), "longer than 0.2 s"),
    ],
)
def test_what_goes_wrong_with_it_is_a_notice(command: tuple[str, ...], says: str, tmp_path: Path) -> None:
    events: list[Progress] = []
    runner = Commands(Notify(command=command, timeout=0.2), "collect", "", events.append)
    heard(runner, "stopped")
    told(tmp_path / "none")
    (notice,) = [event.detail.text for event in events if isinstance(event.detail, Notice)]
    assert says in notice
    assert "'notify'" in notice


def test_a_command_that_hangs_holds_up_nothing_and_no_more_than_a_few_run(tmp_path: Path) -> None:
    go = tmp_path / "go"
    waits = f"import os, time\nwhile not os.path.exists({str(go)!r}): time.sleep(0.01)"
    runner = Commands(Notify(command=(sys.executable, "-c", waits)), "collect", "", lambda event: None)
    for _ in range(10):
        heard(runner, "stopped", "running")  # returns at once, though no command has ended
    running = [thread for thread in threading.enumerate() if thread.name == "notify"]
    assert 1 <= len(running) <= 4
    go.touch()
    told(tmp_path / "none")


class Done(Result):
    """Nothing."""

    schema_: str = "done"
    version: int = 1


def profile_with(folder: Path, section: str) -> Path:
    for name in ("arms", "targets"):
        shutil.copytree(PROFILES / name, folder / name, dirs_exist_ok=True)
    path = folder / "twin.yaml"
    path.write_text((PROFILES / "twin.yaml").read_text("utf-8") + section, "utf-8")
    return path


def test_the_end_of_a_job_and_its_failure_are_told(tmp_path: Path) -> None:
    command = json.dumps([sys.executable, "-c", WRITES, str(tmp_path / "told"), "{event}"])
    profile = profile_with(tmp_path, f"notify: {{command: {command}}}\n")
    events: list[Progress] = []

    def ends(listener: Listener) -> Result:
        listener(Progress("check", 1, 1))
        return Done()

    def fails(listener: Listener) -> Result:
        raise HardwareError("arm left: no answer")

    run_notified("check", profile, None, events.append, ends, lambda result: ("it does not hold",))
    assert told(tmp_path / "told") == [["done", "check: it does not hold"]]
    assert len(events) == 1
    with pytest.raises(HardwareError):
        run_notified("check", profile, None, events.append, fails, lambda result: ())
    assert told(tmp_path / "told")[1:] == [["stopped", "check: arm left: no answer"]]
    for unread, folder in ((tmp_path / "none.yaml", None), (None, tmp_path / "no run"), (None, None)):
        assert isinstance(run_notified("check", unread, folder, events.append, ends, lambda result: ()), Done)
    assert len(told(tmp_path / "told")) == 2, "what cannot be read has no section; the verb says what is wrong"


def test_a_profile_without_the_section_keeps_its_text_and_a_bad_one_is_refused(tmp_path: Path) -> None:
    assert load_profile(PROFILES / "twin.yaml").notify is None
    assert "notify" not in load_profile(PROFILES / "twin.yaml").model_dump()
    for section, says in (
        ("notify: {command: []}\n", "notify.command"),
        ("notify: {command: mail}\n", "notify.command"),
        ("notify: {command: [mail], events: [often]}\n", "notify.events"),
        ("notify: {command: [mail], timeout: 1 h}\n", "notify.timeout"),
        ("notify: {commands: [mail]}\n", "commands"),
    ):
        with pytest.raises(InputError, match=says):
            load_profile(profile_with(tmp_path, section))
