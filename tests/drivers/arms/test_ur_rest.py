"""Nobody who asks a UR arm gets "at rest" from it while it moves or has accepted a motion, even if its client lags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.arms.protocol import ArmError
from drivers.arms.ur_guarded_link import arm_error
from drivers.arms.ur_motion import Unrest
from drivers.arms.ur_rtde_reader import UrSample
from tests.drivers.arms.delayed_client import DelayedClient, Monitor
from tests.drivers.arms.emulated_ur_cell import AWAY, HOME

Delayed = tuple[DelayedClient, Monitor]
STATE = {"do": "state"}
MOVE = {"do": "move", "q": list(AWAY), "speed": [1.0] * 6, "acceleration": [1.0] * 6}
LOOP = [list(HOME)] * 5
PATH = {"do": "path", "q": LOOP, "period_s": 0.008, "lookahead_s": 0.1, "gain": 300}


def moving(answers: list[dict[str, Any]]) -> bool:
    return bool(answers[-1]["ok"]["moving"])


def brake(client: DelayedClient, monitor: Monitor) -> None:
    monitor(0.01, {"brake": True})


def protective_stop(client: DelayedClient, monitor: Monitor) -> None:
    client.safety = 3
    monitor(0.01)


def end(client: DelayedClient, monitor: Monitor) -> None:
    client.running, client.q = False, list(AWAY)
    monitor(0.01)


@pytest.mark.parametrize("stop", [brake, protective_stop, end])
def test_an_arm_whose_motion_has_just_ended_may_still_move(
    delayed: Delayed, stop: Callable[[DelayedClient, Monitor], None]
) -> None:
    """Its states are older than what was done, and show the rest of before."""
    client, monitor = delayed
    client.running = True
    assert moving(monitor(0.1, STATE))
    stop(client, monitor)
    assert moving(monitor(0.01, STATE))
    monitor(0.2)
    assert not moving(monitor(0.01, STATE))


def test_an_arm_that_brakes_for_long_moves_until_it_rests(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running, client.speed = True, 0.5
    brake(client, monitor)
    client.speed = 0.004  # below what counts as motion, for less than the dwell
    monitor(0.03)
    client.speed = 0.5
    monitor(0.3)
    client.speed = 0.0
    assert moving(monitor(0.01, STATE))
    monitor(0.2)
    assert not moving(monitor(0.01, STATE))


def test_another_motion_is_refused_until_the_arm_was_seen_at_rest(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running = True
    assert "still moving" in monitor(0.01, MOVE)[-1]["text"]
    client.running, client.speed = False, 0.5  # its program reports the end, but it moves
    monitor(0.3)
    assert "still moving" in monitor(0.01, MOVE)[-1]["text"]
    assert "still moving" in monitor(0.01, PATH)[-1]["text"]


def test_old_positions_at_the_end_of_a_closed_path_do_not_end_it(
    delayed: Delayed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends where it began, and the states come late: those of before look like those of the end."""
    client, monitor = delayed
    end(client, monitor)
    monitor(1.0)
    client.q = list(HOME)
    monitor(0.2)
    monkeypatch.setattr(client, "tick", lambda seconds: setattr(client, "stamp", client.stamp + 1e-6))
    monitor(0.01, PATH)
    stood = client.stamp
    monitor(0.2)
    assert client.stamp - stood < 0.01
    assert moving(monitor(0.01, STATE))


def test_live_says_so_too(delayed: Delayed) -> None:
    client, monitor = delayed
    client.running = True
    monitor(0.05)
    assert client.supervisor.live.moving
    assert client.supervisor.live.age_s < 0.05
    brake(client, monitor)
    assert client.supervisor.live.moving
    monitor(0.3)
    assert not client.supervisor.live.moving


def sample(time_s: float, speed: float) -> UrSample:
    zeros = (0.0,) * 6
    return UrSample(time_s, zeros, (speed, *zeros[1:]), "RUNNING", "NORMAL", "PLAYING", 1.0, None, None, zeros)


def test_rest_counts_only_from_states_after_the_end_and_for_a_while() -> None:
    unrest = Unrest()
    assert not unrest.may_move
    unrest.begin()
    for k in range(100):  # it stands, but a motion runs
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=True)
    assert unrest.may_move
    unrest.end(1.0)
    for k in range(100, 105):  # states of these 0.05 s may be from before the end
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=False)
    assert unrest.may_move
    for k in range(105, 112):
        unrest.look(sample(0.01 * k, 0.0), 0.01 * k, 0.005, running=False)
    assert not unrest.may_move


def test_a_refusal_that_says_what_to_do_is_an_error_of_the_arm() -> None:
    error = arm_error("left", "advised", "it is still moving; wait until it rests, or stop it")
    assert type(error) is ArmError
    assert str(error) == "arm left: it is still moving; wait until it rests, or stop it"
