"""What befalls a campaign, drawn from its seed: which fault, when, where, for how long."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tests.evidence.campaigning.monitor import STALL

if TYPE_CHECKING:
    from tests.evidence.campaigning.world import World

_STOP_S = 6.0
"""Time of an undisturbed stop: motion, settling, two measurements."""
_BURST = 0.3
"""Share of faults that strike while the one before is being dealt with."""
_BURST_S = 2.0
_LONGEST_S = 60.0


@dataclass(frozen=True)
class Fault:
    """One fault or deed of the person.

    Attributes
    ----------
    kind : str
        A key of ``KINDS``.
    at_s : float
        When it strikes, on the simulated clock [s].
    arm : str
        The arm that it strikes, if it strikes one.
    lasts_s : float
        How long it lasts, if it passes by itself [s].
    size : float
        From 0 to 1: how large it is.
    """

    kind: str
    at_s: float
    arm: str
    lasts_s: float
    size: float


def sample_faults(rng: np.random.Generator, arms: Sequence[str], stops: int, count: int) -> tuple[Fault, ...]:
    """Return ``count`` faults over the time that ``stops`` stops take, in the order of their times."""
    at_s = 0.0
    kinds = tuple(KINDS)
    faults = []
    for _ in range(count):
        burst = rng.random() < _BURST
        at_s += rng.uniform(0.0, _BURST_S) if burst else rng.exponential(stops * _STOP_S / count)
        lasts_s = min(float(rng.exponential(0.2 * _LONGEST_S)), _LONGEST_S)
        kind, arm = kinds[int(rng.integers(len(kinds)))], arms[int(rng.integers(len(arms)))]
        faults.append(Fault(kind, float(at_s), arm, lasts_s, float(rng.random())))
    return tuple(faults)


Strike = Callable[["World", Fault], None]


def _passing(device: str, name: str, value: object, after: object, times: float = 1.0) -> Strike:
    """Set an attribute of a device, and set it back when ``times`` the fault's time has passed."""

    def strike(world: World, fault: Fault) -> None:
        its = getattr(world, device)
        setattr(its, name, value)
        world.later(times * fault.lasts_s, lambda: setattr(its, name, after))

    return strike


# -- arms -------------------------------------------------------------------------------------------------------------


def _protective_stop(world: World, fault: Fault) -> None:
    world.monitor.stop("a protective stop")
    world.arms[fault.arm].protective_stop()


def _emergency_stop(world: World, fault: Fault) -> None:
    world.monitor.stop("an emergency stop")
    for arm in world.arms.values():  # one button for the whole cell
        arm.emergency_stop()


def _arm_link_cut(world: World, fault: Fault) -> None:
    world.monitor.stop("a lost link", unreachable=True)
    world.arms[fault.arm].cut_link()
    world.later(fault.lasts_s, world.arms[fault.arm].restore_link)


def _controller_restart(world: World, fault: Fault) -> None:
    world.monitor.stop("a controller's restart", unreachable=True)
    world.arms[fault.arm].power_off()
    world.later(fault.lasts_s, world.arms[fault.arm].restore_link)


def _host_stall(world: World, fault: Fault) -> None:
    world.monitor.stop(STALL)
    world.arms[fault.arm].host_stall()


def _doubt_as_it_begins(world: World, fault: Fault) -> None:
    """Another arm is in doubt at the last instant before a motion of this one begins."""

    def doubt() -> None:
        other = next(arm for name, arm in world.arms.items() if name != fault.arm)
        world.monitor.stop("a protective stop")
        other.protective_stop()

    world.arms[fault.arm].as_it_begins = doubt


def _arm_mute(world: World, fault: Fault) -> None:
    world.monitor.doubt(f"a silent link of arm {fault.arm}")
    world.arms[fault.arm].mute = True


def _wrong_state(world: World, fault: Fault) -> None:
    if not world.plant.moving(fault.arm):  # brakes are locked at rest
        world.arms[fault.arm].unready = f"arm {fault.arm}: brakes are locked; release them at the pendant"


def _refused_motion(world: World, fault: Fault) -> None:
    world.arms[fault.arm].refuses = True


def _slow_motion(world: World, fault: Fault) -> None:
    world.arms[fault.arm].sluggish = 0.02 + 0.5 * fault.size


def _slider(world: World, fault: Fault) -> None:
    world.arms[fault.arm].slider = 0.1 + 0.9 * fault.size
    world.later(10.0 * fault.lasts_s, lambda: setattr(world.arms[fault.arm], "slider", 1.0))


# -- tracker ---------------------------------------------------------------------------------------------------------


def _beam_broken(world: World, fault: Fault) -> None:
    world.tracker.covered.add(fault.arm)
    world.later(fault.lasts_s, lambda: world.tracker.covered.discard(fault.arm))


def _smr_lost(world: World, fault: Fault) -> None:
    world.tracker.covered.update(world.arms)
    world.later(10.0 * fault.lasts_s, world.tracker.covered.clear)


def _not_ready(world: World, fault: Fault) -> None:
    world.tracker.obstacles.append("it warms up")
    world.later(5.0 * fault.lasts_s, lambda: world.tracker.obstacles.remove("it warms up"))


def _wrong_smr(world: World, fault: Fault) -> None:
    world.tracker.astray_m = 0.05 + 0.3 * fault.size
    world.later(fault.lasts_s, lambda: setattr(world.tracker, "astray_m", 0.0))


def _tracker_link_cut(world: World, fault: Fault) -> None:
    world.tracker.cut_link()
    world.tracker_dies()
    world.later(fault.lasts_s, world.tracker.release)


def _tracker_mute(world: World, fault: Fault) -> None:
    world.monitor.doubt("a silent tracker")
    world.tracker.mute = True


def _tracker_reboot(world: World, fault: Fault) -> None:
    world.tracker.reboot(0.0 if fault.kind == "tracker restarts at once" else fault.lasts_s)
    world.tracker_dies()


# -- disk and program -------------------------------------------------------------------------------------------------


def _disk_slow(world: World, fault: Fault) -> None:
    world.disk.state, world.disk.slow_s = "slow", 5.0 * fault.size
    world.later(fault.lasts_s, lambda: setattr(world.disk, "state", "healthy"))


def _killed_while_storing(world: World, fault: Fault) -> None:
    world.disk.dies = ("before the transaction", "before its commit", "after its commit")[int(2.999 * fault.size)]


# -- person -----------------------------------------------------------------------------------------------------------


def _hasty_resume(world: World, fault: Fault) -> None:
    world.person.stop()
    world.later(0.3 * fault.size, world.person.resume)


def _stop_after_resume(world: World, fault: Fault) -> None:
    world.person.stop()
    world.later(fault.lasts_s, world.person.resume)
    world.later(fault.lasts_s + 0.4 * fault.size, world.person.stop)


def _stop_while_connecting(world: World, fault: Fault) -> None:
    world.person.stop()
    world.arms[fault.arm].as_it_connects = world.person.stop


def _stop_as_it_begins(world: World, fault: Fault) -> None:
    world.arms[fault.arm].as_it_begins = world.person.stop


KINDS: Mapping[str, Strike] = {
    "protective stop": _protective_stop,
    "emergency stop": _emergency_stop,
    "arm's link cut": _arm_link_cut,
    "controller restarts": _controller_restart,
    "computer stalls": _host_stall,
    "doubt as a motion begins": _doubt_as_it_begins,
    "arm's dashboard silent": _arm_mute,
    "arm not ready": _wrong_state,
    "motion refused": _refused_motion,
    "motion too slow": _slow_motion,
    "slider changed": _slider,
    "beam broken": _beam_broken,
    "SMR not found": _smr_lost,
    "tracker not ready": _not_ready,
    "SMR shakes": _passing("tracker", "shaking", True, False),
    "wrong SMR": _wrong_smr,
    "tracker's link cut": _tracker_link_cut,
    "tracker silent": _tracker_mute,
    "tracker restarts": _tracker_reboot,
    "measurement halted": lambda world, fault: world.tracker.halt(),
    "tracker restarts at once": _tracker_reboot,
    "air sensor silent": _passing("air", "silent", True, False),
    "air out of limits": _passing("air", "warmer_k", 20.0, 0.0, times=20.0),
    "disk full": _passing("disk", "state", "full", "healthy"),
    "disk read-only": _passing("disk", "state", "read-only", "healthy"),
    "disk slow": _disk_slow,
    "program killed": lambda world, fault: world.kill(),
    "killed while storing": _killed_while_storing,
    "person pauses": lambda world, fault: world.person.pause(fault.lasts_s),
    "person stops": lambda world, fault: world.person.stop(),
    "person stops and resumes at once": _hasty_resume,
    "person stops just after resuming": _stop_after_resume,
    "person stops while arms are connected": _stop_while_connecting,
    "person stops as a motion begins": _stop_as_it_begins,
    "stop from another process": lambda world, fault: world.person.ask_from_outside("stop"),
    "person aborts": lambda world, fault: world.person.abort(),
}
"""Fault -> what it does to the world."""
