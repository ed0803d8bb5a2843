"""The program whose links may be silent for longer than 0.3 s: ``python -m tests.interfaces.tui.patient_program ...``.

The other tests of a complete run use all processors, and on a shared computer not these alone: links that are silent
for 0.3 s then stop the arms, as they should (``tests/drivers/arms`` checks that), and a day with faults of its own
never ends.
"""

from __future__ import annotations

from collections.abc import Callable

from cellapp.interfaces.cli import main
from drivers.arms import ur_states, ur_worker_process

BUSY_HOST_S = 2.0
"""Silence of a link that stops an arm here."""


def be_patient(put: Callable[[object, str, object], object] = setattr) -> None:
    """Let links be silent for that long; ``put`` may be what a test undoes."""
    put(ur_worker_process, "_SILENT_S", BUSY_HOST_S)
    put(ur_states, "SILENT_S", BUSY_HOST_S)


if __name__ == "__main__":
    be_patient()
    main()
