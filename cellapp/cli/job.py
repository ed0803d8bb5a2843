"""What every command shares: progress bars, cancelling, tables and JSON, errors as one sentence and an exit code."""

from __future__ import annotations

import contextlib
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellapp.control import JobControl
from cellapp.errors import CellappError, InputError
from cellapp.progress import Cancelled, Progress

if TYPE_CHECKING:
    from cellapp.reporting.table import Table
    from cellapp.results import Result
    from cellapp.run import RunFile

EXIT_INTERRUPTED = 4
_ERROR_LOG = "cellapp-error.log"


def run_program(app: Callable[[], object]) -> None:
    """Run the program; an error or a signal becomes one sentence on standard error and an exit code."""
    handlers = {number: signal.signal(number, _stop_before_job) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        app()
    except Cancelled as error:
        _complain(f"{error}; what was committed is kept; 'cellapp collect DIR --resume' continues a collection")
        sys.exit(EXIT_INTERRUPTED)
    except CellappError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of our output went away
        sys.stderr.close()
        sys.exit(0)
    except Exception as error:  # noqa: BLE001 - the last door: a user gets a sentence, the trace goes to a file
        log = Path(_ERROR_LOG)
        with contextlib.suppress(OSError):
            log.write_text(traceback.format_exc(), encoding="utf-8")
        _complain(f"unexpected {type(error).__name__}: {error}; please report it with {log} from this folder")
        sys.exit(1)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def open_run(folder: Path, *, write: bool = False) -> Iterator[RunFile]:
    """An existing run, to read or with ``write`` to add to."""
    from cellapp.run import RunFile

    with RunFile.open(folder, write=write) as opened:
        yield opened


class Job:
    """One command: progress bars, a cancel token that Ctrl-C sets, tables and sentences, and the JSON.

    Raises
    ------
    InputError
        If the JSON's folder does not exist or its path is a folder; nothing was done then.
    """

    def __init__(self, json_file: str | None) -> None:
        if json_file is not None and json_file != "-":
            if not Path(json_file).absolute().parent.is_dir():
                raise InputError(f"--json: {json_file}: folder not found; nothing was done")
            if Path(json_file).is_dir():
                raise InputError(f"--json: {json_file} is a folder; give the path of a file. Nothing was done")
        self.control = JobControl()
        self._json_file = json_file
        self._bars: Any = None
        self._tasks: dict[str, Any] = {}
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Job:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._handlers[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop_bars()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def listen(self, event: Progress) -> None:
        """Draw one bar for each job on standard error, if that is a terminal."""
        if not sys.stderr.isatty():
            return
        if self._bars is None:
            self._start_bars()
        if event.job not in self._tasks:
            self._tasks[event.job] = self._bars.add_task(event.job, total=event.total, note="")
        self._bars.update(self._tasks[event.job], completed=event.done, total=event.total, note=event.note)

    def say(self, *lines: str) -> None:
        """Print lines on standard output, or on standard error where standard output carries the JSON."""
        self._stop_bars()
        for line in lines:
            print(line, file=sys.stderr if self._json_file == "-" else sys.stdout, flush=True)

    def show(self, tables: Sequence[Table]) -> None:
        """Print tables, where ``say`` prints."""
        from rich.console import Console

        from cellapp.reporting.terminal import rich_table

        self._stop_bars()
        console = Console(stderr=self._json_file == "-")
        for table in tables:
            console.print(rich_table(table))

    def result(self, result: Result) -> None:
        """Write the result as JSON if ``--json`` was given."""
        if self._json_file is not None:
            self.write_json(result.to_json(indent=1))

    def write_json(self, text: str) -> None:
        """Write a JSON text where ``--json`` says, if it was given."""
        if self._json_file is None:
            return
        if self._json_file == "-":
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
            return
        try:
            Path(self._json_file).write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise CellappError(f"--json: {self._json_file} cannot be written ({error.strerror})") from None

    def _interrupt(self, number: int, frame: object) -> None:
        if self.control.cancelled:
            raise Cancelled("stopped at once")
        self.control.stop()
        print("stopping at the next step; once more to stop at once", file=sys.stderr)

    def _start_bars(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description:12}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}"),
            console=Console(stderr=True),
        )
        self._bars.start()

    def _stop_bars(self) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars, self._tasks = None, {}


def _stop_before_job(number: int, frame: object) -> None:
    """Stop while the command is still being loaded; ``Job`` handles signals from then on."""
    raise Cancelled("stopped on request")


def _complain(text: str) -> None:
    print(f"cellapp: {text}", file=sys.stderr)
