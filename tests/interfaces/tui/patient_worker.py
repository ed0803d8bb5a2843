"""The worker of an arm that waits as long for a state as ``patient_program`` does for its worker."""

from __future__ import annotations

from drivers.arms import ur_supervisor
from tests.interfaces.tui.patient_program import BUSY_HOST_S

if __name__ == "__main__":
    ur_supervisor.SILENT_S = BUSY_HOST_S
    from drivers.arms.ur_worker import main  # it takes what was set

    main()
