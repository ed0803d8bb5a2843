"""Doubts about a UR arm: none is lost before somebody listens, and a later one of another kind is reported too."""

from __future__ import annotations

from drivers.arms.protocol import ArmError, HostStalled, LinkLost, ProtectiveStop
from drivers.arms.ur_guarded_link import FirstDoubt


def test_a_doubt_that_came_before_anybody_listened_is_delivered() -> None:
    doubt, heard = FirstDoubt(), list[ArmError]()
    doubt.report()
    doubt.note(LinkLost("silent"), "silent")
    doubt.watch(heard.append)
    assert [str(error) for error in heard] == ["silent"]
    doubt.note(ProtectiveStop("stopped"), "stopped")
    assert [str(error) for error in heard] == ["silent", "stopped"]


def test_doubts_while_connecting_are_reported_when_connected() -> None:
    doubt, heard = FirstDoubt(), list[ArmError]()
    doubt.watch(heard.append)
    doubt.note(HostStalled("stalled"), "stalled")
    doubt.note(ProtectiveStop("stopped"), "stopped")
    assert heard == []
    doubt.report()
    doubt.report()
    assert [str(error) for error in heard] == ["stalled", "stopped"]
    assert isinstance(doubt.error, HostStalled)


def test_one_of_each_kind_until_it_is_cleared() -> None:
    doubt, heard = FirstDoubt(), list[ArmError]()
    doubt.report()
    doubt.watch(heard.append)
    for _ in range(3):
        doubt.note(LinkLost("silent"), "silent")
    assert len(heard) == 1
    doubt.clear()
    assert doubt.error is None
    doubt.note(LinkLost("silent again"), "silent again")
    assert [str(error) for error in heard] == ["silent", "silent again"]
    doubt.mute()
    doubt.note(ProtectiveStop("stopped"), "stopped")
    assert len(heard) == 2
