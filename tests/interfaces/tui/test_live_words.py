"""The strip and its banner: ages of all data, how far a stop is, and what counts as moving."""

from __future__ import annotations

import pytest

from cellapp.ground.progress import ArmLive, CellLive, Halt, HaltState
from cellapp.interfaces.tui.job_record import banner_of, strip_of

pytestmark = pytest.mark.fast


def arm(age_s: float | None = 0.05, *, moving: bool = False, halt: HaltState | None = None) -> ArmLive:
    return ArmLive(age_s, moving, None if halt is None else Halt(halt, "why"))


def cell(left: ArmLive, right: ArmLive, tracker_age_s: float | None = 0.1, causes: tuple[str, ...] = ()) -> CellLive:
    return CellLive({"left": left, "right": right}, tracker_age_s, 0.2, causes)


def test_ages_are_amber_above_three_tenths_and_red_above_one_second() -> None:
    parts = strip_of(cell(arm(0.3, moving=True), arm(0.31), tracker_age_s=1.01))
    assert [(part.text, part.look) for part in parts] == [
        ("left moves 0.3 s", "fresh"),
        ("right rests 0.3 s", "late"),
        ("tracker 1.0 s", "lost"),
        ("job 0.2 s", "fresh"),
    ]


def test_an_arm_without_data_neither_rests_nor_moves() -> None:
    assert strip_of(cell(arm(None), arm(2.0, moving=True)))[0].text == "left no state no data"
    assert strip_of(cell(arm(None), arm(2.0, moving=True)))[1].text == "right no state 2.0 s"


@pytest.mark.parametrize(
    ("left", "right", "begins"),
    [
        ("asked", "at rest", "STOP ASKED"),
        ("at rest", "braking", "ARMS BRAKE"),
        ("at rest", "at rest", "AT REST"),
        ("asked", "not seen at rest", "NOT SEEN AT REST: arm right"),
    ],
)
def test_the_banner_begins_with_the_worst_state(left: HaltState, right: HaltState, begins: str) -> None:
    banner = banner_of(cell(arm(halt=left), arm(halt=right), causes=("a person stopped the arms",)), {})
    assert banner is not None
    assert banner.words.startswith(begins)
    assert banner.causes == ("a person stopped the arms",)


def test_a_stop_of_which_no_data_tell_is_not_seen_whatever_was_commanded() -> None:
    banner = banner_of(cell(arm(1.2, halt="braking"), arm(halt="at rest")), {})
    assert banner is not None
    assert banner.alarm
    assert banner.words.startswith("NOT SEEN AT REST: arm left; treat it as moving")


def test_arms_that_the_run_counts_as_moving_stay_on_the_screen_without_a_job() -> None:
    assert banner_of(None, {}) is None
    banner = banner_of(None, {"left": "its link broke"})
    assert banner is not None
    assert (banner.alarm, banner.causes) == (True, ("its link broke",))
    assert "NOT SEEN AT REST: arm left" in banner.words


def test_missing_data_are_named_where_nothing_was_stopped() -> None:
    banner = banner_of(cell(arm(5.0), arm(), tracker_age_s=None), {})
    assert banner is not None
    assert banner.words.startswith("NO DATA from arm left, tracker")
