"""The strip and its banner: ages of all data, how far a stop is, and what counts as moving."""

from __future__ import annotations

from cellapp.ground.progress import ArmLive, CellLive, Halt, HaltState
from cellapp.interfaces.tui.live_words import banner_of, strip_of


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


def test_missing_data_are_named_where_nothing_was_stopped() -> None:
    banner = banner_of(cell(arm(5.0), arm(), tracker_age_s=None), {})
    assert banner is not None
    assert banner.words.startswith("NO DATA from arm left, tracker")
