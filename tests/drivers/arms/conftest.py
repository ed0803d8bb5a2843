"""A stall of this computer, which the driver names, proves nothing about the driver: the test is repeated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import pytest

from drivers.arms.protocol import HostStalled
from drivers.arms.ur import UrArm
from drivers.emulators.ur_controller import EmulatorProcess
from tests.drivers.arms.emulated_ur_cell import repair
from tests.latency import ATTEMPTS


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool:
    """Call a test again, with its arms repaired and connected, while it ends with a stall of this computer."""
    given = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    for left in reversed(range(ATTEMPTS)):
        try:
            pyfuncitem.obj(**given)
            break
        except HostStalled:
            if not left:
                raise
            connect_again(pyfuncitem.funcargs.values())
    return True


def connect_again(fixtures: Iterable[object]) -> None:
    """Repair and connect the arms among the values of fixtures that were connected."""
    values = list(fixtures)
    values += [one for group in values if isinstance(group, Mapping) for one in group.values()]
    emulators = [one for one in values if isinstance(one, EmulatorProcess)]
    for arm in {one.name: one for one in values if isinstance(one, UrArm)}.values():
        if arm.worker_pid is not None:
            repair(emulators[0], arm.name)
            arm.connect()
