"""A stall of this computer, which the driver names, proves nothing about the driver: the test is repeated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

import pytest

from drivers.arms.protocol import ArmError
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.delayed_client import DelayedClient, Monitor, delayed_worker
from tests.drivers.arms.emulated_ur_cell import FOUR_HOSTS, drivers_of, emulated_cell, is_stall, repair
from tests.latency import patiently


@pytest.fixture(scope="module")
def emulator() -> Iterator[EmulatorProcess]:
    with emulated_cell(FOUR_HOSTS) as started:
        yield started


@pytest.fixture(scope="module")
def drivers(emulator: EmulatorProcess) -> Iterator[dict[str, UrArm]]:
    with drivers_of(FOUR_HOSTS) as drivers:
        yield drivers


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool:
    """Call a test again, with its arms repaired and connected, while it ends with a stall of this computer."""
    given = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    arms = connected_arms(pyfuncitem.funcargs)

    def act(attempt: int) -> None:
        for arm in arms if attempt else []:
            repair(cast(EmulatorProcess, pyfuncitem.funcargs["emulator"]), arm.name)
            arm.connect()
        pyfuncitem.obj(**given)

    patiently(act, ArmError, is_stall)
    return True


def connected_arms(fixtures: Mapping[str, object]) -> list[UrArm]:
    """Return the arms among the values of fixtures that are connected to emulated controllers."""
    if not isinstance(fixtures.get("emulator"), EmulatorProcess):
        return []
    values = list(fixtures.values())
    values += [one for group in values if isinstance(group, Mapping) for one in group.values()]
    arms = {one.name: one for one in values if isinstance(one, UrArm)}
    return [arm for arm in arms.values() if arm.worker_pid is not None]


@pytest.fixture
def delayed(monkeypatch: pytest.MonkeyPatch) -> tuple[DelayedClient, Monitor]:
    """A client in a motion from HOME to AWAY, and what runs its worker."""
    return delayed_worker(monkeypatch)
