"""Real arms move only after a green doctor and a person's permission; simulated ones never ask."""

from __future__ import annotations

import numpy as np
import pytest

from cellapp.cell.profile import load_profile
from cellapp.cell.safety.cell_bodies import home_positions
from cellapp.commands.confirm import MotionNotConfirmed, asked_once, confirmation, first_path_words, require_permission
from cellapp.ground.errors import CheckFailed
from cellapp.ground.profile import Profile
from drivers.findings import Finding
from tests.twin import PROFILES


@pytest.fixture
def real() -> Profile:
    return load_profile(PROFILES / "ur10-ur5.yaml")


@pytest.fixture
def findings(monkeypatch: pytest.MonkeyPatch) -> list[Finding]:
    """What the doctor finds."""
    found: list[Finding] = [Finding("python", "ok", "Python 3.11"), Finding("arm left: tool", "warning", "unusual")]
    monkeypatch.setattr("cellapp.commands.confirm.examine", lambda profile: found)
    return found


@pytest.mark.parametrize("name", ["twin", "twin-wire", "twin-rtde", "twin-paper"])
def test_simulated_and_emulated_cells_never_ask(name: str, findings: list[Finding]) -> None:
    profile = load_profile(PROFILES / f"{name}.yaml")
    findings.append(Finding("arm left", "failed", "nobody looks"))
    assert not profile.moves_hardware
    assert confirmation(profile, None) is None
    assert confirmation(profile, lambda words: pytest.fail(words)) is None


def test_without_anybody_to_ask_nothing_moves(real: Profile, findings: list[Finding]) -> None:
    for refuse in (require_permission, confirmation):
        with pytest.raises(MotionNotConfirmed, match="--allow-motion") as caught:
            refuse(real, None)
        assert caught.value.exit_code == 2
    require_permission(real, lambda words: False)


def test_a_doctor_that_is_not_green_now_refuses(real: Profile, findings: list[Finding]) -> None:
    findings.append(Finding("arm left: link", "failed", "192.168.0.10 does not answer"))
    with pytest.raises(CheckFailed, match=r"arm left: link: 192\.168\.0\.10 does not answer") as caught:
        confirmation(real, lambda words: True)
    assert caught.value.exit_code == 1


def test_the_person_is_shown_the_first_path_and_decides(real: Profile, findings: list[Finding]) -> None:
    shown: list[str] = []
    answers = [False, True]

    def ask(words: str) -> bool:
        shown.append(words)
        return answers.pop(0)

    start = home_positions(real)
    confirm = confirmation(real, asked_once(ask))
    assert confirm is not None
    assert [confirm(start, start) for _ in range(4)] == [False, True, True, True]
    assert len(shown) == 2, "once allowed, nobody is asked again"


def test_the_first_path_in_words(real: Profile) -> None:
    start = home_positions(real)
    target = start["left"] + np.radians([10.0, 0.0, -45.0, 0.0, 0.0, 0.0])
    title, left, right, speed = first_path_words(real, start, {"left": target}).splitlines()
    assert title.startswith("First motion")
    assert "arm left: from (" in left
    assert "joint 3 turns farthest, by 45.0 deg" in left
    assert "m in the cell" in left
    assert "arm right: stays at (" in right
    assert "20% of the profile's speed" in speed
