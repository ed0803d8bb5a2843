"""The application: the open profile and run, one job at a time, STOP on every screen, the screens of the day.

Stop keys call the brakes in the thread that reads the terminal (``terminal``), or without that thread in the event
loop. Events of the job wait in a queue and are drawn a few at a time, so that a key is handled at once, however many
events there are.

Keys for requests to the job: stop, pause, resume, abort; and the question before the first motion.

Mitigation of slow garbage collections, which would delay a stop.

Once a run is loaded, a full collection holds the interpreter for 0.1 to 0.4 s, in which no thread can read a key or
stop arms. Objects that survived a slow collection are frozen, so that later ones skip them; after the end of a job they
are collected once more.

Colours for people who need strong contrast; Textual itself has light and dark themes.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from rich.console import RenderableType
from rich.text import Text
from textual import on, work
from textual.app import SystemCommand
from textual.binding import Binding, BindingType
from textual.css.query import NoMatches
from textual.driver import Driver
from textual.screen import Screen
from textual.theme import Theme

from cellapp.commands.docs.keys import KEYS, SHOWN, Step
from cellapp.commands.record import View
from cellapp.commands.registry import ALL
from cellapp.interfaces.tui import terminal
from cellapp.interfaces.tui import verb_jobs as jobs_of_verbs
from cellapp.interfaces.tui.confirmations import QuitQuestion, offer_at_rest, offer_to_quit, offer_whole_day
from cellapp.interfaces.tui.day_state import next_step
from cellapp.interfaces.tui.dialogs.program import MotionQuestion, Palette, possible_commands
from cellapp.interfaces.tui.dialogs.question import Reading
from cellapp.interfaces.tui.host import Host, Severity, StopGiven
from cellapp.interfaces.tui.job_outcome import UNEXPECTED, ending_of, left_behind
from cellapp.interfaces.tui.jobs import Job, JobRunner
from cellapp.interfaces.tui.keys import bind, key_table, with_keys
from cellapp.interfaces.tui.leaving import ENDED, LEFT, Leaving
from cellapp.interfaces.tui.live_run import LOOK_EVERY_S, Detached, JobsOfOthers
from cellapp.interfaces.tui.screens import SCREENS
from cellapp.interfaces.tui.screens.base import DayScreen
from cellapp.interfaces.tui.terminal import driver_that_stops
from cellapp.interfaces.tui.widgets.arm_panel import LiveStrip
from cellapp.interfaces.tui.widgets.controls import Line
from cellapp.interfaces.tui.workspace import Workspace, holds_run, last_run, load_workspace

if TYPE_CHECKING:
    from cellapp.ground.results import Result

_RESUMES = f"{SHOWN['pause']} or {SHOWN['resume']}"
_RESUME_WHEN_CLEAR = f"{SHOWN['resume']}: resume when the cell is clear"
_AFTER_A_STOP = f"{_RESUME_WHEN_CLEAR}; {SHOWN['abort']}: abort."


class JobKeys(Host):
    """An application whose keys reach the brakes before anything is drawn."""

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
        if self.jobs.control.cancelled:
            self.say("Stopping: the arms brake, the job ends." if arms else "Stopping at the next step.", "warning")
        else:
            self.say(f"STOP: all arms brake. {_AFTER_A_STOP}", "error")

    def action_say_how_to_quit(self) -> None:
        """Say how to quit: Ctrl-C does not, if no job runs and no text is selected."""
        self.say("Ctrl-C stops a job; none runs. q, or Ctrl-Q in a dialog, quits.")

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

    def ask_before_motion(self, words: str, answer: Callable[[bool], None]) -> None:
        """Show the first motion and ask for the profile's name."""
        if self.jobs.control.request not in ("none", "pause"):
            return  # a person stopped the job before the question was shown: that is the answer
        profile = self.workspace.profile
        name = "move" if profile is None else profile.name
        self.push_screen(MotionQuestion(words, name), lambda allowed: answer(bool(allowed)))

    def _refuse_motion(self) -> None:
        """Close the question before the first motion: a stop answers it."""
        if isinstance(self.screen, MotionQuestion):
            self.screen.dismiss(False)


_SLOW_S = 0.02
_MOST = 100
"""Limit of freezes per job: frozen objects that become garbage, like a closed dialog, keep their memory."""
_FULL = 2
"""The oldest generation of the garbage collector."""
_SELDOM = 200
"""Middle collections before a full one; at Python's 10 every other first visit of a screen waits 0.1 s for one."""


class SlowCollections:
    """Freezes objects (``gc.freeze``) after a slow full garbage collection; called in any thread."""

    def __init__(self) -> None:
        self._began_s = 0.0
        self._set_aside = 0

    def watch(self) -> None:
        """Start watching, for the rest of the process."""
        gc.callbacks.append(self._passed)
        young, middle, _ = gc.get_threshold()
        gc.set_threshold(young, middle, _SELDOM)

    def _passed(self, phase: str, info: Mapping[str, int]) -> None:
        if info["generation"] < _FULL:
            return
        if phase == "start":
            self._began_s = time.monotonic()
        elif self._set_aside < _MOST and time.monotonic() - self._began_s > _SLOW_S:
            gc.freeze()
            self._set_aside += 1

    def look_again(self) -> None:
        """Collect frozen objects that have become garbage. It holds the interpreter: call it while nothing moves."""
        if self._set_aside:
            self._set_aside = 0
            gc.unfreeze()
            gc.collect()
            gc.freeze()


HIGH_CONTRAST = Theme(
    name="cellapp-contrast",
    primary="#56B4E9",
    secondary="#0072B2",
    accent="#CC79A7",
    warning="#E69F00",
    error="#D55E00",
    success="#009E73",
    foreground="#FFFFFF",
    background="#000000",
    surface="#000000",
    panel="#101010",
    dark=True,
)
"""Colours of Okabe and Ito (2008) on black, distinguishable with any colour vision."""


_REQUESTS = ("stop", "stop_job", "pause", "resume", "abort")
_OWN = ("show", "last_run", "runs", "next_step", "whole_day", "explain", "handbook", "quit", *_REQUESTS)
_ALWAYS = ("stop", "stop_job", "abort", "leave")
"""Actions that stay available over an open dialog."""
_DRAWING_S = 0.1
"""Interval of drawing a running job: people read no faster, and keys are handled in between."""
_WAITING = ("paused", "suspended", "stopped", "aborted")
"""States in which a job waits for a person or for the cell."""
_TICK_S = 1.0
"""Interval of updates that no event triggers: the remaining time."""
_PRELOAD_AFTER_S = 0.3
"""Delay of the preload, so that the first screen is drawn before it."""
_LATER = (
    *(f"cellapp.interfaces.tui.screens.{entry.step}" for entry in SCREENS),
    *(f"cellapp.commands.{verb}" for verb in ALL),
    *(f"cellapp.commands.{verb}.run" for verb in ("run", "report")),
    "cellapp.interfaces.page.page",
    "cellapp.commands.docs.handbook",
    "cellapp.interfaces.tui.dialogs.handbook",
)
_ONWARD = f"{SHOWN['next']} goes to the next step, {SHOWN['help']} explains"
_MOST_TAKEN = 300
"""Events that are processed in one batch: each takes some microseconds."""


class CellApp(JobKeys):
    """The application.

    Parameters
    ----------
    profiles : Path
        Folder whose ``*.yaml`` are offered.
    logs : Path
        Folder of the runs.
    patience_s : float
        How long quitting waits for a job to stop before the program ends without it.
    ends_process : bool
        Whether a signal that ends the program ends the process even if the screen cannot be left.
    """

    TITLE = "cellapp"
    CSS_PATH = "app.tcss"
    COMMAND_PALETTE_BINDING = "ctrl+p"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "stop", "STOP", priority=True),
        Binding("ctrl+c", "stop_job", show=False, priority=True),
        Binding("ctrl+c", "say_how_to_quit", show=False),
        bind("pause", "pause", "Pause"),
        bind("resume", "resume", "Resume"),
        bind("abort", "abort", "Abort"),
        Binding("ctrl+x", "abort", show=False, priority=True),
        *(Binding(entry.key, f"show('{entry.step}')", entry.title, show=False) for entry in SCREENS),
        bind("last", "last_run", "Last run", show=False),
        bind("runs", "runs", "All runs", show=False),
        bind("day", "whole_day", "Day", "plan, collect, calibrate, discover, push and verify; asks first"),
        bind("next", "next_step", "Next", "show the step that comes next; there, begin it"),
        bind("help", "explain", "Help", "explain this screen"),
        bind("handbook", "handbook", "Handbook", KEYS["handbook"].meaning, show=False),
        bind("quit", "quit", "Quit"),
        Binding("ctrl+q", "leave", show=False, priority=True),
    ]

    def __init__(
        self, profiles: Path, logs: Path = Path("logs"), patience_s: float = 60.0, *, ends_process: bool = False
    ) -> None:
        # the job's thread and that of signals call by the queue of messages
        jobs = JobRunner(partial(self.call_later, self.ask_before_motion), partial(self.call_later, self.show_end))
        leaving = Leaving(jobs, partial(self.call_later, self._leave, True), patience_s, ends_process=ends_process)
        super().__init__(profiles, logs, jobs, leaving)
        self.passes = SlowCollections()
        self.others = JobsOfOthers(self)
        self.message = ""
        self._severity: Severity = "information"
        self._screens: dict[Step, DayScreen] = {}
        self._commands: list[SystemCommand] = []
        self._drawn = -1
        self._loads = 0
        self._leaving = False
        self._ended = False

    def exit(self, result: None = None, return_code: int = 0, message: RenderableType | None = None) -> None:
        """Leave the screen, or end the process if the terminal does not let go of it."""
        self.leaving.end_if_stalled(LEFT, until_ended=True)
        super().exit(result, return_code, message)

    def get_driver_class(self) -> type[Driver]:
        """Return the driver that stops before the event loop gets a key, if this system has one."""
        return driver_that_stops(super().get_driver_class())

    # -- begin and end -------------------------------------------------------------------------------------------------

    def on_mount(self) -> None:
        """Show the first screen of the day, and start the timers."""
        self.register_theme(HIGH_CONTRAST)
        self.last_run = last_run(self.logs)
        self.waits = "" if self.last_run is None else str(self.last_run)
        self.push_screen(self._screen_of("cell"))
        self.call_after_refresh(self._welcome)
        self.set_interval(_DRAWING_S, self._draw_events)
        self.set_interval(LOOK_EVERY_S, self.others.look)
        self.set_interval(_TICK_S, self._tick)
        self.set_timer(_PRELOAD_AFTER_S, self._preload)
        self.leaving.watch()
        self.say(f"Choose a profile on the screen Cell (key 1); {_ONWARD}.")

    def _welcome(self) -> None:
        """Ask how to begin if there is no profile."""
        if not any(self.profiles.glob("*.yaml")):
            from cellapp.interfaces.tui.dialogs.first_run import offer_first_run  # 0.7 s, only at the first start

            offer_first_run(self)

    @work(thread=True)
    def _preload(self) -> None:
        """Import what screens and jobs will need, so that no key waits for it: scipy alone takes half a second."""
        for module in _LATER:
            importlib.import_module(module)
        gc.collect()
        gc.freeze()  # exempt loaded objects from collection: scanning them held up keys for up to 0.3 s
        if self.last_run is not None:
            self.call_later(self.say_last_run, jobs_of_verbs.words_of_run(self.last_run))

    def on_unmount(self) -> None:
        """Brake all arms and end the job, however the screen closes: no job continues unseen."""
        self.jobs.control.leave(ENDED)
        self.leaving.close()

    async def action_leave(self) -> None:
        """Quit, also over a dialog."""
        await self.action_quit()

    async def action_quit(self) -> None:
        """Quit; with a running job, ask first; stop the job and wait for its end."""
        if self.jobs.running:
            if not self._leaving and not isinstance(self.screen, QuitQuestion):
                offer_to_quit(self, self._leave)
        else:
            self.exit(return_code=self.jobs.code)

    def _leave(self, leave: bool) -> None:
        self.refresh_bindings()
        if not leave:
            return
        if not self.jobs.running:
            self.exit(return_code=self.jobs.code)
            return
        self._leaving = True
        self.jobs.control.leave(LEFT)
        self._refuse_motion()
        if not self.jobs.watched:
            self.say(f"Stopping, then quitting (waiting at most {self.leaving.patience_s:.0f} s).", "warning")
        self.set_timer(self.leaving.patience_s, self._quit_without_job)

    def _quit_without_job(self) -> None:
        if self.jobs.running:
            self.exit(return_code=UNEXPECTED, message=Text(left_behind(self.record.name, self.leaving.patience_s)))

    # -- screens -------------------------------------------------------------------------------------------------------

    @property
    def day_screen(self) -> DayScreen:
        """The shown screen of the day, below any dialog."""
        return next(screen for screen in reversed(self.screen_stack) if isinstance(screen, DayScreen))

    def _screen_of(self, step: Step) -> DayScreen:
        if step not in self._screens:
            screen = next(entry for entry in SCREENS if entry.step == step).make()
            assert isinstance(screen, DayScreen)
            screen.fit(self.size)
            self._screens[step] = screen
            self.install_screen(self._screens[step], step)
        return self._screens[step]

    def action_show(self, step: Step) -> None:
        """Show the screen of a step."""
        if step != self.day_screen.STEP:
            self._drawn = -1
            self.switch_screen(self._screen_of(step))

    def action_next_step(self) -> None:
        """Show the screen of the next step; if it is shown, begin that step."""
        step, screen, overview = next_step(self.workspace), self.day_screen, self.workspace.overview
        if step != screen.STEP:
            self.action_show(step)
        elif self.jobs.running:
            self.say(f"{self.state.job.words if self.state.job else ''}; the next step follows when it has ended.")
        elif not screen.begin_next("cellapp plan" if overview is None else overview.next_step):
            self.say(f"{self.state.next_words}.")

    def action_last_run(self) -> None:
        """Open the run that was changed last when the application began."""
        if self.last_run is None:
            self.say("There is no run yet.", "warning")
        else:
            self.open_run(self.last_run, self.workspace.profile_path)

    def action_runs(self) -> None:
        """List all runs."""
        self.action_show("cell")
        self.call_later(self._screen_of("cell").show_runs)

    def action_explain(self) -> None:
        """Explain the current screen, with all its keys."""
        from cellapp.commands.docs.handbook import sections

        screen = self.day_screen
        title = next(entry.title for entry in SCREENS if entry.step == screen.STEP)
        said = next(one.terminal_text for one in sections("terminal") if one.heading == f"Screen {title}")
        keys = f"{key_table(screen.BINDINGS)}\n\n## Keys of every screen\n\n{key_table(self.BINDINGS)}"
        self.push_screen(Reading(f"{said}\n## Keys of this screen\n\n{keys}\n"))

    def action_handbook(self) -> None:
        """Open the handbook."""
        from cellapp.interfaces.tui.dialogs.handbook import Handbook

        self.push_screen(Handbook())

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Disable actions that are not possible now; over a dialog only stop and abort remain."""
        if action in _REQUESTS and not self.jobs.possible(action.removesuffix("_job")):
            return False
        if action == "stop" and self.escape_closes:
            return False
        if action in _OWN and action not in _ALWAYS and not isinstance(self.screen, DayScreen):
            return False
        return None if action == "whole_day" and self.jobs.running else True

    def get_system_commands(self, screen: Screen[object]) -> Iterable[SystemCommand]:
        """Yield every action for the command palette: those of the application and of the screen below it."""
        yield from self._commands
        for arm in self.workspace.unseen:
            seen = partial(offer_at_rest, self, arm)
            yield SystemCommand(f"Arm {arm} is at rest", "a person has seen it: it no longer counts as moving", seen)
        yield SystemCommand("Theme", "light, dark, high contrast and others", self.action_change_theme)

    def action_command_palette(self) -> None:
        """Open the command palette with all actions that are possible now."""
        if isinstance(self.screen, DayScreen):
            self._commands = list(possible_commands(self, self.screen))
            self.push_screen(Palette(id="--command-palette"))

    # -- profile and run -----------------------------------------------------------------------------------------------

    def say_last_run(self, words: str) -> None:
        """Say more of the last run, in the line that names it."""
        self.waits = words
        self.draw_all()

    def open_run(self, folder: Path | None, profile_path: Path | None = None) -> None:
        """Open a run; its own profile is used. Without one open a profile."""
        if self._hides_moving_arms(folder):
            text = f"'{self.record.name}' moves arms; stop it or wait for its end before something else is opened."
            self.say(text, "warning")
            return
        self.others.leave_unless(folder)
        self._loads += 1
        if self.workspace.profile is None:
            self.reading = f"{folder or profile_path} is being read."
        self._read(profile_path, folder, self._loads)

    def _hides_moving_arms(self, folder: Path | None) -> bool:
        """Return whether a job moves arms of another run: the header must keep saying whether those are real."""
        job = self.jobs.job
        return job is not None and job.moves and folder != job.folder

    @work(thread=True)
    def _read(self, profile_path: Path | None, folder: Path | None, number: int) -> None:
        loaded = load_workspace(profile_path, folder)
        if number == self._loads:  # else something else was opened meanwhile
            self.call_later(self.show_loaded, loaded)
            self.others.find(folder)

    def show_loaded(self, now: Workspace) -> None:
        """Draw the workspace that was read."""
        before = self.workspace
        if self._hides_moving_arms(now.folder):
            return  # it was requested before the job began, whose run is read at its end
        self.workspace, self.reading = now, ""
        ended, self._ended = self._ended, False
        opened = now.profile_path if now.folder is None and now.profile_path != before.profile_path else None
        if now.problem:
            self.say(now.problem, "error")
        elif now.edited and not (before.edited and before.folder == now.folder):
            self.say("The profile was edited after this run was planned; the run keeps its own copy.", "warning")
        elif not ended and now.folder not in (None, before.folder):
            self.say(f"{now.folder} is open" + (f"; in use by {now.in_use}." if now.in_use else "."))
        elif not ended and opened is not None and str(opened) not in self.message:  # a message names what was written
            self.message, self._severity = f"{opened} is open; {_ONWARD}.", "information"  # not logged
        self.draw_all()

    # -- the job -------------------------------------------------------------------------------------------------------

    def action_whole_day(self) -> None:
        """After a question: plan, collect, calibrate, discover, push and verify in a new run."""
        offer_whole_day(self)

    def show_end(self, job: Job, ending: Result | BaseException | None, view: View) -> None:
        """Say how the job ended, and read the run again."""
        for event in self.jobs.events():
            self.record.add(event)
        self.jobs.ended()
        self.record.end()
        text, severity, self.jobs.code = ending_of(job, ending, view, self.record.latest)
        self._ended = True
        self.say(text, severity)
        self.bell()  # for somebody who does not look
        if self._leaving:  # the shell keeps the text that the screen can no longer show
            self.exit(return_code=self.jobs.code, message=Text(text))
            return
        if not isinstance(ending, BaseException | None):
            shown = self.day_screen.show_result
            for show in dict.fromkeys((self.shows_result or shown, shown)):
                show(ending, view)
        if isinstance(ending, Detached):
            return  # something else is open now
        folder = job.folder or self.workspace.folder
        self.reading = f"What '{job.name}' has stored is being read."
        self.open_run(folder if holds_run(folder) else self.workspace.folder, self.workspace.profile_path)
        self.refresh_bindings()
        self.passes.look_again()  # nothing moves now

    # -- drawing -------------------------------------------------------------------------------------------------------

    def say(self, text: str, severity: Severity = "information") -> None:
        """Show a sentence in the message line of every screen and keep it in the log."""
        text = with_keys(text)
        self.message, self._severity = text, severity
        self.record.note(text, "info" if severity == "information" else severity)
        self._draw_message()
        self.refresh_bindings()

    def refresh_bindings(self) -> None:
        """Offer the keys anew, while there is a screen: what was read as the application ended has none any more."""
        if self.screen_stack:
            super().refresh_bindings()

    def draw_all(self) -> None:
        """Redraw the current screen completely."""
        self._draw_message()
        self._draw(lambda screen: screen.show_workspace(self.workspace))
        self._draw_job()
        self.refresh_bindings()

    def _draw(self, draw: Callable[[DayScreen], object]) -> None:
        """Draw on the current screen, unless it is being mounted and will be drawn then."""
        with contextlib.suppress(NoMatches, StopIteration):  # no screen is mounted yet, or screens are being removed
            if self.day_screen.is_mounted:
                draw(self.day_screen)

    def _draw_message(self) -> None:
        said = self.message, f"message {self._severity}"
        self._draw(lambda screen: screen.query_one(".message", Line).say(*said))

    def _draw_events(self) -> None:
        """Process the oldest events of the job, and draw if anything changed.

        One timer for whichever screen is shown: with one for each screen that was ever shown there was no 0.02 s left
        in which nothing was due.
        """
        state = self.record.state
        for event in self.jobs.events(_MOST_TAKEN):
            self.record.add(event)
        live = self.jobs.control.live() if self.jobs.running else None
        self.record.look(live)
        self._draw(lambda screen: screen.query_one(LiveStrip).show(live, self.workspace.unseen))
        if self.record.changes == self._drawn:
            return
        self._drawn = self.record.changes
        self._draw_job()
        if self.record.state != state:
            self._say_state()

    def _tick(self) -> None:
        """Update the remaining time, and what is drawn more seldom than events come."""
        if self.jobs.running:
            self._draw_job()

    def _draw_job(self) -> None:
        """Draw the state and the job on the current screen."""

        def draw(screen: DayScreen) -> None:
            screen.draw_state()
            screen.show_job(self.record)

        self._draw(draw)

    def _say_state(self) -> None:
        """Show a new state of the job in the message line."""
        state, reason = self.record.state, self.record.reason
        if state is not None and reason:
            since = "" if state == "running" else f" {terminal.since_words(self.record)}"
            self.message = f"{state.upper()}{since or f': {reason}'}"
            self._severity = "information" if state == "running" else "warning"
            self._draw_message()
        self.refresh_bindings()
        if state in _WAITING:
            self.bell()
