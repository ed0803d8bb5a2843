"""Keys for requests to the job: stop, pause, resume, abort; and the question before the first motion."""

from __future__ import annotations

from contextlib import suppress

from textual import on
from textual.app import ScreenStackError
from textual.screen import ModalScreen
from textual.widgets import Input

from cellapp.interfaces.tui.dialogs.motion import MotionQuestion
from cellapp.interfaces.tui.host import Host
from cellapp.interfaces.tui.jobs import MotionAsked
from cellapp.interfaces.tui.keys import SHOWN
from cellapp.interfaces.tui.messages import StopGiven
from cellapp.interfaces.tui.screens.base import DayScreen

_RESUMES = f"{SHOWN['pause']} or {SHOWN['resume']}"
_RESUME_WHEN_CLEAR = f"{SHOWN['resume']}: resume when the cell is clear"
_AFTER_A_STOP = f"{_RESUME_WHEN_CLEAR}; {SHOWN['abort']}: abort."


class JobKeys(Host):
    """An application whose keys reach the brakes before anything is drawn."""

    @property
    def escape_closes(self) -> bool:
        """Whether Escape closes a dialog or leaves a field: there is one, and nothing can move."""
        if self.jobs.moves or not self.jobs.running:
            return False  # stop first, or nothing to stop: Escape closes by itself
        with suppress(ScreenStackError):  # called by the thread that reads keys, also while screens are removed
            return isinstance(self.screen, ModalScreen) or isinstance(self.screen.focused, Input)
        return False

    def action_stop_job(self) -> None:
        """Brake all arms now (Ctrl-C), whatever is open."""
        self.action_stop()

    def action_stop(self) -> None:
        """Brake all arms now."""
        if not self.jobs.possible("stop"):
            return
        control = self.jobs.control
        arms = control.has_brakes
        control.stop()  # before anything is drawn
        self._say_stop(arms)

    @on(StopGiven)
    def show_stop(self, event: StopGiven) -> None:
        """Say that a press of STOP has taken effect."""
        self.presses.said()
        if self.jobs.running:
            self._say_stop(event.arms)

    def _say_stop(self, arms: bool) -> None:
        self._refuse_motion()
        if isinstance(self.screen, DayScreen) and isinstance(self.screen.focused, Input):
            self.screen.leave_field()  # the next key is a command, not a letter of a text
        if self.jobs.control.cancelled:
            self.say("Stopping: the arms brake, the job ends." if arms else "Stopping at the next step.", "warning")
        else:
            self.say(f"STOP: all arms brake. {_AFTER_A_STOP}", "error")

    def action_say_how_to_quit(self) -> None:
        """Say how to quit: Ctrl-C does not, if no job runs and no text is selected."""
        self.say("Ctrl-C stops a job; none runs. q, or Ctrl-Q in a text field, quits.")

    def action_pause(self) -> None:
        """Pause the job after the current stop; the second time, resume. A stopped job is not resumed."""
        control = self.jobs.control
        if control.request == "pause":
            self.action_resume()
        elif control.request == "stop":
            self.say(f"Stopped, not paused. {_AFTER_A_STOP}", "warning")
        elif self.jobs.possible("pause"):
            control.pause()
            rests = "the arms rest after the present stop" if control.has_brakes else "the job waits where it can"
            self.say(f"Pausing: {rests}. {_RESUMES}: resume; {SHOWN['stop']}: stop.", "warning")

    def action_resume(self) -> None:
        """Let a paused or stopped job continue."""
        if not self.jobs.possible("resume"):
            return
        if self.presses.just_given:
            self.say(f"Stopped; resume was asked for in the same moment. {_RESUME_WHEN_CLEAR}.", "warning")
            return
        self.jobs.control.resume()
        self.say("Resuming.")

    def action_abort(self) -> None:
        """Brake all arms now and end the job."""
        if self.jobs.possible("abort"):
            arms = self.jobs.control.has_brakes
            self.jobs.control.abort()
            self._refuse_motion()
            self.say("Aborting: all arms brake, the job ends." if arms else "Aborting at the next step.", "error")

    @on(MotionAsked)
    def ask_before_motion(self, message: MotionAsked) -> None:
        """Show the first motion and ask for the profile's name."""
        if self.jobs.control.request not in ("none", "pause"):
            return  # a person stopped the job before the question was shown: that is the answer
        profile = self.workspace.profile
        name = "move" if profile is None else profile.name
        self.push_screen(MotionQuestion(message.words, name), lambda allowed: message.answer(bool(allowed)))

    def _refuse_motion(self) -> None:
        """Close the question before the first motion: a stop answers it."""
        if isinstance(self.screen, MotionQuestion):
            self.screen.dismiss(False)
