"""The job that another process runs in the open run: the application shows its state, and sends it a person's requests.

The state is asked for several times a second and the requests go the way of ``cellapp stop DIR``. What the job measures
is read from the run when it has ended.
"""

from __future__ import annotations

import threading
from pathlib import Path

from cellapp.ground.control import Aborted, JobControl, Request, Stopped
from cellapp.ground.errors import CellappError, HardwareError, InputError
from cellapp.ground.job_client import JOB_FILE, JobAddress, JobSeen, Verb, address_of_job, ask_running_job, look_at_job
from cellapp.ground.progress import StateChange
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.jobs import Job

LOOK_EVERY_S = 1.0
"""Interval of looking for jobs that were started in another window."""
_ASK_EVERY_S = 0.3
"""Interval of asking such a job for its state."""


class Detached(Exception):
    """Another run was opened, or a person left: the job goes on."""


class OthersControl(JobControl):
    """Control of a job of another process: its state as it was last told, or as a request that was just sent makes it.

    Each request has a thread of its own: a job that hangs holds up neither a key nor the request after it.
    """

    def __init__(self, app: Host, folder: Path, process: int, seen: JobSeen) -> None:
        super().__init__()
        self.folder, self.process, self.seen = folder, process, seen
        self._app, self._sent = app, 0
        self._over = threading.Event()
        self._take(seen, 0)

    @property
    def has_brakes(self) -> bool:
        """Whether the other process has opened arms."""
        return self.seen.has_brakes

    @property
    def can_hold(self) -> bool:
        """Whether the job could wait after a halt."""
        return self.has_brakes

    def leave(self, how: str = "") -> None:
        """Look at it no longer. The job goes on: another person attends it."""
        self._departure = how or "left"
        self._over.set()

    def follow(self) -> None:
        """Pass on the state of the job until it ends.

        Raises
        ------
        Cancelled
            If it was stopped or aborted.
        HardwareError
            If its process is gone without having ended it.
        Detached
            After ``leave``.
        """
        told: object = None
        silent = False
        while not self._over.wait(_ASK_EVERY_S):
            sent = self._sent
            try:
                seen = look_at_job(self.folder)
            except HardwareError as error:
                if not silent:
                    self._say(str(error))
                silent = True
                continue
            if seen is None:
                self._end()
                return
            silent = False
            self._take(seen, sent)
            if told != (told := (seen.state, seen.reason, seen.done, seen.total, seen.note)):
                self.tell(seen.part, seen.done, seen.total, seen.note)
                self.tell(seen.part, seen.done, seen.total, detail=StateChange(seen.state, seen.reason))
        raise Detached

    def _take(self, seen: JobSeen, sent: int) -> None:
        """Take what the job said, unless it was sent a request meanwhile."""
        self.seen, self.holds = seen, seen.holds
        if sent == self._sent:
            with self._changed:
                self._request = seen.request
                self._changed.notify_all()

    def _end(self) -> None:
        if (self.folder / JOB_FILE).exists():
            raise HardwareError(
                f"process {self.process}, which ran '{self.seen.name}' in {self.folder}, is gone without a word. If an"
                " arm moves, press its emergency stop; the run keeps what was stored"
            )
        if self.request == "abort":
            raise Aborted("aborted on request")
        if self.request == "stop":
            raise Stopped("stopped on request")

    def _set(self, request: Request, replaces: tuple[Request, ...]) -> None:
        """Send the request that pause, resume, stop or abort makes, in a thread of its own; here it stands at once."""
        self._sent += 1  # before it is sent: what is under way does not know of it
        threading.Thread(target=self._send, args=("resume" if request == "none" else request,), daemon=True).start()
        super()._set(request, replaces)

    def _send(self, verb: Verb) -> None:
        try:
            ask_running_job(self.folder, verb)
        except CellappError as error:
            self._say(f"{verb}: {error}")

    def _say(self, text: str) -> None:
        self._app.call_later(self._app.say, text, "error")


class JobsOfOthers:
    """Finds jobs of other processes in the open run, and lets the application show them."""

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
        """Look at the job in a folder, if another process of this computer runs one. Call it in a thread."""
        if folder is None or self._app.jobs.running or not self._looking.acquire(blocking=False):
            return
        try:
            address = address_of_job(folder)
            if address is None or address.is_own or not address.is_here:
                return
            seen = look_at_job(folder)
            if seen is not None:
                self._app.call_later(self._show, folder, address, seen)
            elif self._app.workspace.in_use:  # the file of a killed job
                self._app.call_later(self._app.open_run, folder, self._app.workspace.profile_path)
        except (HardwareError, InputError) as error:
            if str(error) != self._said:
                self._app.call_later(self._app.say, str(error), "error")
            self._said = str(error)
        finally:
            self._looking.release()

    def _show(self, folder: Path, address: JobAddress, seen: JobSeen) -> None:
        """Let the application show and command a job as if it were its own, unless another run is open by now."""
        app = self._app
        if app.jobs.running or folder != app.workspace.folder:
            return
        control = OthersControl(app, folder, address.process, seen)
        app.shows_result = None
        app.record.begin(seen.name)
        app.jobs.start(Job(seen.name, lambda _, ask: control.follow(), folder, process=address.process), control)
        app.say(
            f"Process {address.process} runs '{seen.name}' in {folder}: its state is shown, nothing can be changed."
            " Escape stops its arms; q leaves it running."
        )
        app.draw_all()

    def leave_unless(self, folder: Path | None) -> None:
        """Let go of a job that does not belong to this folder; the job continues."""
        job = self._app.jobs.job
        if job is not None and job.process is not None and job.folder != folder:
            self._app.jobs.control.leave("another run was opened")
