"""Jobs that another process runs in the open run: the application attaches to them automatically."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from cellapp.ground.asking import JOB_FILE, NoJob, address_of_job
from cellapp.ground.control import JobControl
from cellapp.ground.errors import CellappError
from cellapp.ground.progress import Listener
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.jobs import Ask, Job

if TYPE_CHECKING:
    from cellapp.cell.driving.requests.attaching import RemoteControl

LOOK_EVERY_S = 1.0
"""Interval of looking for jobs that were started in another window."""


class JobsOfOthers:
    """Finds jobs of other processes, and attaches the application to them."""

    def __init__(self, app: Host) -> None:
        self._app = app
        self._looking = threading.Lock()
        self._said = ""

    def look(self) -> None:
        """Check, in a thread, whether a job has started or ended in the open run; do nothing while a job runs here."""
        folder = self._app.workspace.folder
        if folder is None or self._app.jobs.running or self._looking.locked():
            return
        if (folder / JOB_FILE).exists():
            threading.Thread(target=self.find, args=(folder,), name="look", daemon=True).start()
        elif self._app.workspace.in_use:
            self._app.open_run(folder, self._app.workspace.profile_path)

    def find(self, folder: Path | None) -> None:
        """Connect to the job in a folder, if another process of this computer runs one. Call it in a thread."""
        address = None if folder is None or self._app.jobs.running else address_of_job(folder)
        if folder is None or address is None or address.is_own or not address.is_here:
            return
        if not self._looking.acquire(blocking=False):
            return
        from cellapp.cell.driving.requests.attaching import attach

        try:
            self._app.call_later(self.attach, attach(folder))
        except NoJob:  # the file of a killed job
            if self._app.workspace.in_use:
                self._app.call_later(self._app.open_run, folder, self._app.workspace.profile_path)
        except CellappError as error:
            if str(error) != self._said:
                self._say(str(error))
            self._said = str(error)
        finally:
            self._looking.release()

    def attach(self, remote: RemoteControl) -> None:
        """Let the application show and command a job as if it were its own, unless another run is open by now."""
        app = self._app
        if app.jobs.running or remote.folder != app.workspace.folder:
            remote.close()
            return

        def work(listener: Listener, control: JobControl, ask: Ask) -> None:
            remote.follow(listener, self._say)

        app.asked_by = None
        app.record.begin(remote.name, attached=True)
        app.jobs.start(Job(remote.name, work, remote.folder, process=remote.process), remote)
        app.say(
            f"Attached to '{remote.name}', which process {remote.process} runs in {remote.folder}. Escape stops its"
            " arms; q leaves it running."
        )
        app.draw_all()

    def leave_unless(self, folder: Path | None) -> None:
        """Detach from a job that does not belong to this folder; the job continues."""
        job = self._app.jobs.job
        if job is not None and job.process is not None and job.folder != folder:
            self._app.jobs.control.leave("another run was opened")

    def _say(self, text: str) -> None:
        """Show a sentence; from any thread."""
        self._app.call_later(self._app.say, text, "error")
