"""Interface of every kind of tracker: settings, how it is opened and probed, and what generic code may ask about it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from drivers.findings import DeviceReport, Finding
from drivers.settings import Section

if TYPE_CHECKING:
    from drivers.plant import Plant
    from drivers.trackers.protocol import Preparation, Tracker


@dataclass(frozen=True, eq=False)
class TrackerContext:
    """What a cell specifies for its tracker, independent of its kind.

    Attributes
    ----------
    transverse, range : tuple of two float
        Maximum permissible errors across the beam and along it: constant [m] and proportional to the distance [m/m].
    plant : Plant or None
        The simulated cell; None if no device of the cell is simulated.
    """

    transverse: tuple[float, float]
    range: tuple[float, float]
    plant: Plant | None = None


@dataclass(frozen=True)
class EmulatedBridge:
    """Loopback address at which an emulated bridge may replace the tracker's own."""

    host: str
    port: int


class TrackerSettings(Section):
    """Base of the settings of every kind of tracker. Defaults are those of a real tracker wired to this computer."""

    kind: str
    needs_plant: ClassVar[bool] = False
    """Whether the tracker belongs to the simulated cell."""
    has_device: ClassVar[bool] = True
    """Whether there is a tracker; if not, readings come from a file."""
    can_be_served: ClassVar[bool] = True
    """Whether this computer reaches the tracker directly, so that ``cellapp tracker-bridge`` can serve it to others."""

    def preparation(self) -> Preparation | None:
        """Return what must be prepared when a job starts; None if ``connect`` prepares it."""
        return None

    def emulated_bridge(self) -> EmulatedBridge | None:
        """Return the address at which ``cellapp emulate`` can replace the tracker; None if it must not."""
        return None

    def token(self) -> str | None:
        """Return the secret shared with the tracker's bridge; None if there is none. Raises ``SettingError``."""
        return None

    @abstractmethod
    def open(self, tracker: TrackerContext) -> Tracker:
        """Create the driver, not connected yet. Raises ``SettingError``."""

    @abstractmethod
    def probe(self, tracker: TrackerContext, patience_s: float) -> Sequence[Finding]:
        """Check the tracker without moving its head; a link that is silent for ``patience_s`` [s] counts as dead."""


def probed(device: Tracker, where: str = "", notices: Callable[[], Sequence[str]] = tuple) -> list[Finding]:
    """Connect a tracker, ask it who it is, what it lacks and what it has to say, and disconnect. Raises as it does."""
    try:
        device.connect()
        identity, unmet, said = device.identify(), device.unmet(), notices()
    finally:
        device.disconnect()
    who = f"{identity.model}, serial {identity.serial}, {identity.software}{where}"
    lacks = "before it measures: " if unmet else ""
    state = lacks + "; ".join([*unmet, *said]) or "ready"
    return [Finding("", "warning" if unmet or said else "ok", f"{who}; {state}", DeviceReport(**vars(identity)))]
