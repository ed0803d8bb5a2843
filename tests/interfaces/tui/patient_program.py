"""The program whose links may be silent for longer than 0.3 s: ``python -m tests.interfaces.tui.patient_program ...``.

The other tests of a complete run use all processors, and on a shared computer not these alone: links that are silent
for 0.3 s then stop the arms, as they should (``tests/drivers/arms`` checks that), and a day with faults of its own
never ends.
"""

from __future__ import annotations

from collections.abc import Callable

from drivers.arms import ur_worker_process

BUSY_HOST_S = 2.0
"""Silence of a link that stops an arm here."""


def be_patient(put: Callable[[object, str, object], object] = setattr) -> None:
    """Let workers and the links that they hold be silent for that long; ``put`` may be what a test undoes."""
    put(ur_worker_process, "_SILENT_S", BUSY_HOST_S)
    put(ur_worker_process, "_WORKER", "tests.interfaces.tui.patient_worker")


if __name__ == "__main__":
    from cellapp.interfaces.cli import main  # not for the worker

    be_patient()
    main()
