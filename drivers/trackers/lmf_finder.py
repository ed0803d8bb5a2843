"""Search for Leica trackers in this computer's networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.trackers.lmf_calls import CallThread
from drivers.trackers.lmf_objects import Lmf, describe, load_lmf
from drivers.trackers.lmf_options import DEFAULT_LIBRARY
from drivers.trackers.protocol import TrackerError

FINDING_S = 30.0


@dataclass(frozen=True)
class FoundTracker:
    """A tracker that answers in the network."""

    address: str
    model: str
    serial: str


def find_trackers(library: str = DEFAULT_LIBRARY, load: Callable[[str], Lmf] = load_lmf) -> list[FoundTracker]:
    """Return the trackers in this computer's networks. Raises ``LmfMissing``, ``TrackerTimeout``, ``TrackerError``."""

    def find() -> list[FoundTracker]:
        lmf = load(library)
        try:
            finder = lmf.TrackerFinder()
            finder.Refresh()
            return [FoundTracker(str(t.IPAddress), str(t.Type), str(t.SerialNumber)) for t in finder.Trackers]
        except lmf.exceptions as error:
            raise TrackerError(f"tracker: LMF could not search for trackers: {describe(error)}") from error

    calls = CallThread()
    try:
        return calls.call("searching for trackers", find, FINDING_S)
    finally:
        calls.close()


def visible_trackers(library: str, load: Callable[[str], Lmf] = load_lmf) -> str:
    """Return the trackers that LMF finds in this computer's networks, as a sentence for a person."""
    try:
        found = find_trackers(library, load)
    except TrackerError as error:
        return str(error)
    names = ", ".join(f"{t.model} {t.serial} at {t.address}" for t in found)
    return f"LMF sees {names}" if names else "LMF sees no tracker in the networks of this computer"
