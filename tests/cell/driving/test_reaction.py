"""The reaction of the whole cell: all arms brake at once, the first cause is kept, nothing is released by itself."""

from __future__ import annotations

import threading
from typing import cast

import numpy as np
import pytest

from cellapp.cell.driving.cell import in_threads, one_by_one
from cellapp.cell.driving.reaction import CellStopped, StopCause, StopReaction
from cellapp.ground.errors import HardwareError
from cellapp.ground.progress import Halt
from drivers.arms.protocol import Arm, ArmError, ArmState, DoubtListener, HostStalled, LinkLost, ProtectiveStop
from drivers.trackers.protocol import TrackerLinkLost
from tests.waiting import WAIT_S

pytestmark = pytest.mark.fast
WITHIN_S = WAIT_S


class Braking:
    """An arm whose brake may hang."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.braked, self.may_go_on = threading.Event(), threading.Event()
        self.may_go_on.set()
        self.listener: DoubtListener = lambda error: None
        self.connected = 0
        self.reason = ""
        self.unseen = False
        self.refused = 0

    def watch(self, listener: DoubtListener) -> None:
        self.listener = listener

    def refuse_motion(self) -> None:
        self.refused += 1

    def brake(self) -> None:
        self.braked.set()
        self.may_go_on.wait(WITHIN_S)

    def stop(self) -> None:
        if self.unseen:
            raise LinkLost(f"arm {self.name}: not seen")

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


def test_a_doubt_about_one_arm_brakes_all_even_if_one_brake_hangs(arms: dict[str, Braking]) -> None:
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
    assert reaction.cause is not None
    assert (reaction.cause.kind, reaction.cause.arm) == ("host stalled", "right")


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


def test_a_doubt_during_the_release_keeps_the_cell_stopped(
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


def test_arms_that_were_not_seen_at_rest_are_named(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted())
    arms["right"].unseen = True
    assert reaction.wait_at_rest() == {"right": "arm right: not seen"}


def test_a_driver_that_fails_unexpectedly_does_not_end_the_wait(
    arms: dict[str, Braking], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise ArmError("arm left: refused")

    monkeypatch.setattr(arms["left"], "stop", refuse)
    assert reaction_of(arms, Halted()).wait_at_rest() == {"left": "arm left: refused"}


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

    reaction = StopReaction(cast(dict[str, Arm], arms), Halted(), listener=note)
    arms["right"].unseen = True
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert both.wait(WITHIN_S)
    assert ended == {"left": "at rest", "right": "not seen at rest"}
    assert reaction.wait_at_rest() == {"right": "arm right: not seen"}


def test_an_arm_in_doubt_stays_so_until_it_is_seen(arms: dict[str, Braking]) -> None:
    reaction = reaction_of(arms, Halted(), one_by_one)
    arms["right"].unseen = True
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    reaction.wait_at_rest()
    reaction.trigger(StopCause("stop", "a person stopped the arms"))
    assert reaction.halts["right"].state == "not seen at rest", "another stop tells nothing about it"
    arms["right"].unseen = False
    reaction.release(reaction.causes)
    assert reaction.halts == {}, "its controller reported that it rests when it was connected"
