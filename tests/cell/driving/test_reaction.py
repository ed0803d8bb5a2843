"""The reaction of the whole cell: all arms brake at once, the first cause is kept, nothing is released by itself."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import stat
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from cellapp.cell.driving.cell import in_threads, one_by_one
from cellapp.cell.driving.reaction import CellStopped, StopCause, StopReaction
from cellapp.cell.driving.requests import taking_requests
from cellapp.ground.control import JobControl
from cellapp.ground.errors import HardwareError, InputError
from cellapp.ground.job_client import JOB_FILE, Verb, ask_running_job, look_at_job, who_uses
from cellapp.ground.progress import Halt
from drivers.arms.protocol import Arm, ArmError, ArmState, FaultListener, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import Tracker, TrackerLinkLost
from tests.sure import sure
from tests.waiting import WAIT_S

WITHIN_S = WAIT_S


class Braking:
    """An arm whose brake may hang."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.braked, self.may_go_on = threading.Event(), threading.Event()
        self.may_go_on.set()
        self.listener: FaultListener = lambda error: None
        self.connected = 0
        self.reason = ""
        self.unseen: ArmError | None = None
        self.refused = 0

    def watch(self, listener: FaultListener) -> None:
        self.listener = listener

    def refuse_motion(self) -> None:
        self.refused += 1

    def brake(self) -> None:
        self.braked.set()
        self.may_go_on.wait(WITHIN_S)

    def stop(self) -> None:
        if self.unseen is not None:
            raise self.unseen

    def connect(self) -> None:
        self.connected += 1
        self.braked.clear()

    def state(self) -> ArmState:
        return ArmState(np.zeros(6), 0.0, False, not self.reason, self.reason, None, None)


class Halted:
    """A tracker that counts halts and may be unreachable."""

    def __init__(self) -> None:
        self.halted = threading.Event()

    def halt(self) -> None:
        self.halted.set()
        raise TrackerLinkLost("it does not answer")


def reaction_of(arms: dict[str, Braking], tracker: Halted, together: object = in_threads) -> StopReaction:
    return StopReaction(cast(dict[str, Arm], arms), tracker, together)  # type: ignore[arg-type]


@pytest.fixture
def arms() -> dict[str, Braking]:
    return {name: Braking(name) for name in ("left", "right")}


def test_a_fault_about_one_arm_brakes_all_even_if_one_brake_hangs(arms: dict[str, Braking]) -> None:
    tracker = Halted()
    reaction = reaction_of(arms, tracker)
    arms["left"].may_go_on.clear()
    arms["left"].listener(ProtectiveStop("arm left: protective stop"))
    try:
        assert arms["right"].braked.wait(WITHIN_S)
        assert tracker.halted.wait(WITHIN_S)
        assert reaction.cause == StopCause("safety stop", "arm left: protective stop", "left", reaction.cause.error)  # type: ignore[union-attr]
        with pytest.raises(CellStopped, match="arm left: protective stop; a stop was sent to all arms"):
            reaction.check()
    finally:
        arms["left"].may_go_on.set()


def test_the_first_cause_is_kept(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    arms["right"].listener(HostStalled("arm right: silent"))
    arms["left"].listener(LinkLost("arm left: lost"))
    arms["left"].listener(LinkLost("arm left: lost again"))
    assert (sure(reaction.cause).kind, sure(reaction.cause).arm) == ("host stalled", "right")
    assert [cause.text for cause in reaction.causes] == ["arm right: silent", "arm left: lost"], "each once"


def test_a_person_brakes_again_whatever_came_before(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    reaction.trigger(StopCause("fault", "something", "left"))
    arms["left"].braked.clear()
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert arms["left"].braked.is_set()


def test_release_reconnects_all_arms_and_opens_the_latch(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    reaction.release(reaction.causes)
    reaction.check()
    assert [arm.connected for arm in arms.values()] == [1, 1]


def test_an_arm_that_is_not_ready_keeps_the_cell_stopped(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    reaction.trigger(StopCause("fault", "something", "right"))
    arms["right"].reason = "protective stop"
    with pytest.raises(HardwareError, match="arm right: not ready: protective stop"):
        reaction.release(reaction.causes)
    with pytest.raises(CellStopped):
        reaction.check()
    assert arms["left"].braked.is_set(), "the arm that was released is latched again"


def test_a_fault_during_the_release_keeps_the_cell_stopped(
    arms: dict[str, Braking], monkeypatch: pytest.MonkeyPatch
) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    connect = arms["right"].connect

    def doubtful() -> None:
        connect()
        arms["left"].listener(LinkLost("arm left: lost"))

    monkeypatch.setattr(arms["right"], "connect", doubtful)
    with pytest.raises(CellStopped, match="arm left: lost"):
        reaction.release(reaction.causes)


NOT_SEEN = LinkLost("arm right: not seen")


@pytest.mark.parametrize("error", [NOT_SEEN, ArmError("arm right: refused")])
def test_arms_that_were_not_seen_at_rest_are_named_and_end_the_wait(arms: dict[str, Braking], error: ArmError) -> None:
    arms["right"].unseen = error
    assert reaction_of(arms, Halted()).wait_at_rest() == {"right": str(error)}


def test_an_arm_is_watched_by_one_thread_and_in_simulated_time_by_none(
    arms: dict[str, Braking], monkeypatch: pytest.MonkeyPatch
) -> None:
    watched, end = threading.Semaphore(0), threading.Event()

    def stop() -> None:
        watched.release()
        end.wait(WITHIN_S)

    monkeypatch.setattr(arms["left"], "stop", stop)
    fault, person = StopCause("fault", "something", "left"), StopCause("stop", "a person stopped the arms")
    reaction_of(arms, Halted(), one_by_one).trigger(fault)
    assert not watched.acquire(blocking=False)
    reaction = reaction_of(arms, Halted(), lambda calls: [call() for call in calls])
    first = threading.Thread(target=reaction.trigger, args=(fault,))
    first.start()
    assert watched.acquire(timeout=WITHIN_S)
    reaction.trigger(person)
    end.set()
    first.join(WITHIN_S)
    assert not watched.acquire(blocking=False)


def test_the_permission_of_every_arm_is_withdrawn_before_the_trigger_returns(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), lambda calls: None)  # no thread has begun to brake yet
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert [arm.refused for arm in arms.values()] == [1, 1]
    assert {halt.state for halt in reaction.halts.values()} == {"asked"}


def test_each_arm_is_watched_until_it_rests_without_the_job(arms: dict[str, Braking]) -> None:
    ended: dict[str, str] = {}
    both = threading.Event()

    def note(name: str, halt: Halt) -> None:
        ended[name] = halt.state
        if len(ended) == len(arms):
            both.set()

    reaction = StopReaction(cast(dict[str, Arm], arms), cast(Tracker, Halted()), listener=note)
    arms["right"].unseen = NOT_SEEN
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert both.wait(WITHIN_S)
    assert ended == {"left": "at rest", "right": "not seen at rest"}
    assert reaction.wait_at_rest() == {"right": "arm right: not seen"}


def test_an_arm_of_unknown_state_stays_so_until_it_is_seen(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    arms["right"].unseen = NOT_SEEN
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    reaction.wait_at_rest()
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert reaction.halts["right"].state == "not seen at rest", "another stop tells nothing about it"
    arms["right"].unseen = None
    reaction.release(reaction.causes)
    assert reaction.halts == {}, "its controller reported that it rests when it was connected"


# -- Requests to a running job from another process: delivered and answered at once, never to a wrong job --------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "run.sqlite").write_bytes(b"")
    return tmp_path


@pytest.fixture
def braked() -> list[str]:
    """Verbs with which the arms were braked."""
    return []


@pytest.fixture
def job(folder: Path, braked: list[str]) -> Iterator[JobControl]:
    """A job with open arms that a person attends."""
    control = JobControl(holds=True)
    with taking_requests(folder, control), control.brakes(braked.append):
        yield control


def test_every_verb_is_done_before_it_is_answered(folder: Path, job: JobControl, braked: list[str]) -> None:
    steps: tuple[tuple[Verb, str, str], ...] = (
        ("pause", "after the present stop", "pause"),
        ("resume", "continues", "none"),
        ("stop", "stopped: all arms brake; the job waits", "stop"),
        ("resume", "continues", "none"),
        ("abort", "aborted: all arms brake", "abort"),
    )
    for verb, says, request in steps:
        assert says in ask_running_job(folder, verb)
        assert job.request == request
    assert braked == ["stop", "abort"]
    assert job.cancelled


def test_a_request_that_does_not_fit_the_state_is_refused_in_words(folder: Path, job: JobControl) -> None:
    cases: tuple[tuple[Verb | None, Verb, str], ...] = (
        (None, "resume", "neither paused nor stopped"),
        ("pause", "pause", "paused already"),
        ("stop", "pause", "stopped already"),
        ("abort", "resume", "was aborted"),
    )
    for first, verb, says in cases:
        if first is not None:
            job.ask(first)
        with pytest.raises(InputError, match=says) as caught:
            ask_running_job(folder, verb)
        assert caught.value.exit_code == 2


def test_a_job_that_nobody_attends_ends_after_a_stop_and_cannot_be_resumed(folder: Path) -> None:
    control = JobControl()
    with taking_requests(folder, control):
        assert ask_running_job(folder, "stop") == ("stopped: no arm is open; the job ends and can be resumed later")
        refused: tuple[Verb, ...] = ("resume", "pause")
        for verb in refused:
            with pytest.raises(InputError, match="was stopped and ends"):
                ask_running_job(folder, verb)
        assert control.request == "stop"
        assert "stopped" in ask_running_job(folder, "stop"), "a second stop does no harm"


def test_no_run_no_job_and_a_job_that_ended(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(InputError, match="no run is here"):
        ask_running_job(tmp_path / "nowhere", "stop")
    with pytest.raises(InputError, match="no job runs in"):
        ask_running_job(folder, "stop")
    with taking_requests(folder, JobControl()):
        stale = (folder / JOB_FILE).read_text()
    assert not (folder / JOB_FILE).exists()
    (folder / JOB_FILE).write_text(stale)  # as a killed job leaves it
    with pytest.raises(InputError, match="the last one has ended"):
        ask_running_job(folder, "stop")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"computer": "a", "port": "x", "token": ""}', "\x00"])
def test_a_damaged_file_is_no_job(folder: Path, text: str) -> None:
    (folder / JOB_FILE).write_text(text)
    with pytest.raises(InputError, match="no job runs in"):
        ask_running_job(folder, "stop")
    with taking_requests(folder, JobControl()):
        assert "stopped" in ask_running_job(folder, "stop")


def altered(folder: Path, **address: object) -> None:
    """Write the job's file with another address."""
    (folder / JOB_FILE).write_text(json.dumps(json.loads((folder / JOB_FILE).read_text()) | address))


def test_a_stale_token_never_acts_on_a_later_job(folder: Path, job: JobControl, braked: list[str]) -> None:
    altered(folder, token="of an earlier job")
    with pytest.raises(HardwareError, match="a job that runs holds it and does not answer; if an arm moves, press"):
        ask_running_job(folder, "stop")
    assert (job.request, braked) == ("none", [])


def test_a_second_job_in_the_folder_is_refused(folder: Path, job: JobControl) -> None:
    with pytest.raises(InputError, match="another job runs here"), taking_requests(folder, JobControl()):
        pytest.fail("two jobs in one folder")
    ask_running_job(folder, "stop")
    assert job.request == "stop", "the first job still takes requests"


@pytest.mark.skipif(os.name != "posix", reason="Windows has other rights")
def test_a_job_whose_file_says_nothing_is_no_missing_job(folder: Path, job: JobControl) -> None:
    (folder / JOB_FILE).write_text("")
    with pytest.raises(HardwareError, match="a job that runs holds it"):
        ask_running_job(folder, "stop")
    with pytest.raises(HardwareError, match="a job that runs holds it"), taking_requests(folder, JobControl()):
        pytest.fail("two jobs in one folder")
    assert who_uses(folder) == "a job that does not answer"


AS_ANOTHER = """
import os, sys
from pathlib import Path
from cellapp.cell.driving.requests import taking_requests
from cellapp.ground.job_client import ask_running_job, who_uses
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CellappError
os.setuid(65534)
folder = Path(sys.argv[1])
for act in (lambda: ask_running_job(folder, "stop"), lambda: taking_requests(folder, JobControl()).__enter__()):
    try:
        act()
    except CellappError as error:
        print(type(error).__name__, error)
print(who_uses(folder))
"""


@pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="only root can act as another account")
@pytest.mark.parametrize("mode", [0o1777, 0o777])
def test_another_account_neither_takes_a_job_for_none_nor_replaces_it(mode: int) -> None:
    """In a folder that both may write."""
    control = JobControl()
    with tempfile.TemporaryDirectory() as name, taking_requests(Path(name), control):
        job = Path(name) / JOB_FILE
        job.parent.chmod(mode)
        before = job.read_bytes()
        command = [sys.executable, "-c", AS_ANOTHER, name]
        asked, began, used = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        for words in (asked, began):
            assert words.startswith(f"UnreadableJob {job}: belongs to account 'root' and cannot be read"), words
        assert used == "a job of account 'root', if it still runs"
        assert job.read_bytes() == before
        assert "stopped" in ask_running_job(job.parent, "stop")
        assert control.request == "stop"


def test_a_job_on_another_computer_is_named(folder: Path, job: JobControl) -> None:
    altered(folder, computer="cell-pc")
    with pytest.raises(InputError, match="runs on computer 'cell-pc'"):
        ask_running_job(folder, "stop")
    assert job.request == "none"


@pytest.mark.skipif(os.name != "posix", reason="Windows has other rights")
def test_only_the_owner_may_read_the_token(folder: Path, job: JobControl) -> None:
    assert stat.S_IMODE((folder / JOB_FILE).stat().st_mode) == 0o600


def test_hostile_requests_change_nothing_and_delay_no_stop(folder: Path, job: JobControl) -> None:
    address = json.loads((folder / JOB_FILE).read_text())
    lines = (b"\n", b"x" * 10_000, b"wrong abort\n", f"{address['token']} explode\n".encode(), b"\xff\xfe \x00\n")
    with socket.create_connection(("127.0.0.1", address["port"])):  # silent until the end
        for line in lines:
            with (
                socket.create_connection(("127.0.0.1", address["port"])) as hostile,
                contextlib.suppress(ConnectionError),  # the job hangs up without reading the rest
            ):
                hostile.sendall(line)
                with hostile.makefile("rb") as reader:
                    assert reader.readline(1000).startswith(b"refused" if b"explode" in line else b"")
        assert job.request == "none"
        assert "stopped" in ask_running_job(folder, "stop")


def test_a_job_that_listens_and_is_silent_is_a_fault(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.job_client.PATIENCE_S", 0.05)
    with taking_requests(folder, JobControl()), socket.create_server(("127.0.0.1", 0)) as mute:
        altered(folder, port=mute.getsockname()[1])
        with pytest.raises(HardwareError, match="press its emergency stop"):
            ask_running_job(folder, "stop")


def test_a_job_of_another_version_is_named(folder: Path, job: JobControl, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellapp.ground.job_client.exchange", lambda *_: "done a job runs here")
    with pytest.raises(InputError, match="of another version of cellapp"):
        look_at_job(folder)
