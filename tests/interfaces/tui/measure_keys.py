"""Measure the first paint, screens, and the time from a key to its answer in a real terminal.

``python -m tests.interfaces.tui.measure_keys``, with two cores and nothing else running. The keys are letters that are
typed into the search field of the screen Collect while an emulated cell collects over real sockets, and while discovery
searches 300 readings of a real UR10.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from textual.events import Key
from textual.widgets import Input

from cellapp.cell.profile import load_profile
from cellapp.cell.run import RunFile
from cellapp.commands.calibrate.run import calibrate_run
from cellapp.commands.discover.request import VERB as DISCOVER
from cellapp.commands.import_ import import_new_run
from cellapp.commands.plan.run import new_planned_run
from cellapp.interfaces.tui.app import CellApp
from cellapp.interfaces.tui.work import job_of
from tests.evidence.wire.storm_cell import emulated_cell
from tests.interfaces.tui.pilot import until
from tests.interfaces.tui.terminal import ROOT, Terminal, cellapp

LETTERS = "zvkjuzvkju"
STOPS = 40
STARTS = 7
REAL = ROOT / "tests" / "fixtures" / "ur10-real" / "readings.csv"


def letters_s(terminal: Terminal, count: int, pause_s: float, running: str) -> list[float]:
    """Time from a letter to its echo [s]; ends early when the header no longer says what is ``running``."""
    terminal.send("3")
    terminal.until(lambda text: running in text.split("\n")[0], f"the job on the screen Collect: {running}")
    terminal.quiet(pause_s)
    terminal.send("/")
    terminal.quiet(0.5)  # a letter that came before the field would be a key of the screen
    typed, took = "", []
    for number in range(count):
        if f"{running} " not in terminal.text().split("\n")[0]:
            break
        typed += LETTERS[number % len(LETTERS)]
        sent_s = terminal.send(typed[-1])
        wanted = typed
        took.append(terminal.until(lambda text: wanted in text, f"the echo of {wanted}") - sent_s)  # noqa: B023
        terminal.quiet(pause_s)
    return took


def screens_s(terminal: Terminal, count: int, pause_s: float) -> list[float]:
    """Time from the key of a screen until its keys are shown [s], the first visits left out."""
    took = []
    for number in range(-2, count):
        for key, words in (("4", "Calibrate"), ("5", "Discover")):
            sent_s = terminal.send(key)
            shown_s = terminal.until(lambda text: f"b\N{NO-BREAK SPACE}{words}" in text or f"b {words}" in text, words)  # noqa: B023
            took += [shown_s - sent_s] if number >= 0 else []
            terminal.quiet(pause_s)
    return took


def visits_ms(terminal: Terminal) -> list[float]:
    """Processor time of showing each of the eight screens [ms], from the second to the first."""
    took = []
    for key in "23456781":
        before_s = processor_s(terminal)
        terminal.send(key)
        terminal.quiet(0.4)
        took.append(1e3 * (processor_s(terminal) - before_s))
    return took


def processor_s(terminal: Terminal) -> float:
    """Processor time that the threads of a program have used so far [s]. Linux only."""
    threads = Path(f"/proc/{terminal.process.pid}/task").iterdir()
    return sum(int((thread / "schedstat").read_text("ascii").split()[0]) for thread in threads) * 1e-9


def _libraries_s() -> float:
    """Processor time of a program that only loads Textual and rich [s]."""
    process = subprocess.Popen([sys.executable, "-c", "import textual; import rich"])
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    return usage.ru_utime + usage.ru_stime


def figures(took_s: list[float]) -> str:
    """Number, median, 95th percentile and maximum in milliseconds."""
    ordered = sorted(took_s)
    p95 = ordered[min(int(0.95 * len(ordered)), len(ordered) - 1)]
    median = statistics.median(ordered)
    return f"{len(ordered)} keys: median {median * 1e3:.0f} ms, 95 % {p95 * 1e3:.0f} ms, max {ordered[-1] * 1e3:.0f} ms"


def wire_profile(folder: Path) -> Path:
    """The emulated twin with few stops and a free port for its tracker."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
    path = folder / "profiles" / "twin-rtde.yaml"
    text = (
        path.read_text("utf-8").replace("127.0.0.1:50960", f"127.0.0.1:{port}").replace("stops: 80", f"stops: {STOPS}")
    )
    path.write_text(text, "utf-8")
    return path


def open_newest_run(terminal: Terminal) -> None:
    """Open the first run of the screen Runs."""
    terminal.send("8")
    terminal.until(lambda text: "began (UTC)" in text, "the runs")
    terminal.quiet(1.0)
    terminal.send("\r")
    terminal.until(lambda text: "is open; next" in text, "the run")


def measure_start(folder: Path) -> None:
    """First paint, and the change of screens while nothing runs."""
    painted_s, used_s, libraries_s = [], [], []
    for _ in range(STARTS):
        libraries_s.append(_libraries_s())
        with cellapp(folder) as terminal:
            painted_s.append(terminal.until(lambda text: "STOP" in text, "the first screen") - terminal.began_s)
            used_s.append(processor_s(terminal))
    print(f"first paint, {STARTS} starts: median {statistics.median(painted_s):.2f} s, max {max(painted_s):.2f} s")
    used, libraries = statistics.median(used_s), statistics.median(libraries_s)
    print(f"    processor time {used:.2f} s; importing Textual and rich takes {libraries:.2f} s")
    with cellapp(folder) as terminal:
        terminal.until(lambda text: "SIMULATED" in text, "the profile")
        terminal.quiet(3.0)
        for visit in ("first", "second", "third"):
            took = ", ".join(f"{ms:.0f} ms" for ms in visits_ms(terminal))
            print(f"processor time of a screen, {visit} visit: {took}")
        print("another screen,", figures(screens_s(terminal, 20, 0.2)))


def measure_collection(folder: Path) -> None:
    """Letters while an emulated cell collects in real time."""
    profile = load_profile(wire_profile(folder))
    new_planned_run(profile, folder / "logs" / "wire").close()
    with emulated_cell(profile, 1.0), cellapp(folder) as terminal:
        terminal.until(lambda text: "SIMULATED" in text, "a profile")
        open_newest_run(terminal)
        terminal.send("3")
        terminal.until(lambda text: "READY" in text, "the screen Collect")
        terminal.quiet(0.5)
        terminal.send("b")
        terminal.until(lambda text: "Begin to collect?" in text, "the question")
        terminal.send("b")
        terminal.until(lambda text: f"collect 2/{STOPS}" in text.split("\n")[0], "collecting")
        print("collecting,", figures(letters_s(terminal, 100, 0.1, "collect")))


def measure_discovery(folder: Path) -> None:
    """Letters while discovery searches readings of a real arm; in this process, from the key to the changed field."""
    csv, run_folder = folder / "rows.csv", folder / "logs" / "real"
    csv.write_text("\n".join(REAL.read_text("utf-8").splitlines()[:301]) + "\n", "utf-8")
    import_new_run(load_profile(folder / "profiles" / "ur10-real.yaml"), csv, run_folder, in_order=True)
    with RunFile.open(run_folder, write=True) as run:
        calibrate_run(run)
    print("discovering,", figures(asyncio.run(fields_s(folder / "profiles", run_folder))))


async def fields_s(profiles: Path, run_folder: Path) -> list[float]:
    """Time from a key event to the new value of the search field [s] while the run is searched."""
    app, took = CellApp(profiles), []
    async with app.run_test(size=(120, 40)) as pilot:
        app.open_run(run_folder)
        await until(pilot, lambda: app.workspace.folder is not None, "the run")
        await pilot.press("3", "slash")
        await until(pilot, lambda: isinstance(app.screen.focused, Input), "the search field")
        field = app.screen.query_one("#" + str(app.screen.focused.id), Input) if app.screen.focused else Input()
        app.start_job(job_of(DISCOVER, folder=run_folder))
        while app.jobs.running:
            before, sent_s = field.value, time.perf_counter()
            app.post_message(Key("z", "z"))
            while field.value == before:
                await asyncio.sleep(0.0)
            took.append(time.perf_counter() - sent_s)
            await asyncio.sleep(0.05)
    return took


def main() -> None:
    """Print what the handbook states, chapter "figures"."""
    for measure in (measure_start, measure_collection, measure_discovery):
        with tempfile.TemporaryDirectory() as name:
            shutil.copytree(ROOT / "profiles", Path(name) / "profiles")
            measure(Path(name))


if __name__ == "__main__":
    main()
