"""Execution of the program: an error or a signal becomes one sentence, an exit code and, on request, JSON."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, TextIO, cast

from cellapp.ground.errors import CellappError, HardwareError, InputError
from cellapp.ground.outputs import RENEWED
from cellapp.ground.progress import Cancelled
from cellapp.ground.signals import HANGUP, INTERRUPTS

EXIT_UNEXPECTED = 1
EXIT_INTERRUPTED = 4
_WARNINGS = "PYTHONWARNINGS"
_ERROR_LOG = "cellapp-error.log"
_REPORT = "to report this: 'cellapp doctor PROFILE --bundle FILE.zip' packs what the authors need, without secrets"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Error numbers of a disk or device that cannot store more."""


def run_program(app: Callable[[], object]) -> None:
    """Run the program; an error or a signal becomes one sentence on standard error and an exit code.

    With ``--json -``, an error is also written to standard output as an object, unless the command has written its
    result.
    """
    shown, warnings.showwarning = warnings.showwarning, _unseen  # those of libraries are for who writes programs
    before = os.environ.get(_WARNINGS)
    os.environ[_WARNINGS] = before or "ignore"  # of worker processes
    handlers = {number: signal.signal(number, _stop_before_job) for number in (*INTERRUPTS, *HANGUP)}
    try:
        try:
            with _errors_as_json(sys.argv[1:]):
                _ended(app)
        finally:
            for number, handler in handlers.items():  # a terminal's second hangup must not change the exit code
                signal.signal(number, signal.SIG_IGN if number in HANGUP else handler)
            warnings.showwarning = shown
            if before is None:
                del os.environ[_WARNINGS]
    except Cancelled:  # by a second signal, between the end of the job and the end of the program
        sys.exit(EXIT_INTERRUPTED)


def _unseen(*_: object, **__: object) -> None:
    """Show no warning of numpy or another library: what a person must know, a message says."""


def end_with(error: BaseException) -> None:
    """End the program with an error as ``run_program`` does."""

    def fail() -> None:
        raise Cancelled("stopped on request") if isinstance(error, KeyboardInterrupt) else error

    run_program(fail)


def _ended(app: Callable[[], object]) -> None:
    """Run the program; every error ends in ``SystemExit``, with the error as its ``__context__``."""
    try:
        app()
    except (CellappError, Cancelled) as error:
        _complain(error_text(error))
        if isinstance(error, HardwareError):
            _complain(_filled(_REPORT))
        sys.exit(EXIT_INTERRUPTED if isinstance(error, Cancelled) else error.exit_code)
    except BrokenPipeError:
        _reader_gone()
    except SystemExit as ended:
        if isinstance(ended.__context__, OSError) and ended.__context__.errno == errno.EPIPE:  # typer's own exit code
            _reader_gone()
        raise
    except OSError as error:
        if error.errno not in _FULL or error.filename is not None:
            _unexpected(error)
        _complain(f"standard output cannot be written ({os.strerror(error.errno or 0)}); nothing more is printed")
        _print_nowhere()
        sys.exit(InputError.exit_code)
    except Exception as error:  # noqa: BLE001 - last handler: a user gets a sentence, a file the traceback
        _unexpected(error)


def _unexpected(error: Exception) -> NoReturn:
    with contextlib.suppress(CellappError):
        RENEWED.write_text(Path(_ERROR_LOG), traceback.format_exc())
    _complain(error_text(error))
    sys.exit(EXIT_UNEXPECTED)


def _reader_gone() -> NoReturn:
    """End normally, as programs do whose reader (like ``head``) has closed the pipe. Write nothing more to it."""
    _print_nowhere()
    sys.exit(0)


def _print_nowhere() -> None:
    """Discard pending output: the reader has closed the pipe."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with contextlib.suppress(OSError, ValueError):  # a test's stream has no file descriptor
        os.dup2(nowhere, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    os.close(nowhere)


def _filled(text: str) -> str:
    """Put the files of the call that failed into the commands that a message quotes."""
    from cellapp.interfaces.cli.command_outputs import current_outputs  # late: only for a message

    return current_outputs().filled(text)


def error_text(error: BaseException) -> str:
    """Return the sentence for a person about an error."""
    return _filled(_error_text(error))


def _error_text(error: BaseException) -> str:
    if isinstance(error, Cancelled):
        return (
            f"{error}; what was stored is kept. Give the same command again; 'cellapp collect DIR --resume' continues a"
            " collection, the same command with --store a trial"
        )
    if isinstance(error, CellappError):
        return str(error)
    import typer  # late: the terminal application starts without it

    if isinstance(error, typer.TyperException):
        return error.format_message()
    return f"unexpected {type(error).__name__}: {error}; please report it with {_ERROR_LOG} from this folder"


# -- JSON on standard output ------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _errors_as_json(arguments: Sequence[str]) -> Iterator[None]:
    """Write the error that ends the program as JSON if the arguments ask for JSON on standard output.

    Standard output then carries only results, so any text written to it is the command's result.
    """
    if not ("--json=-" in arguments or ("--json", "-") in pairwise(arguments)):
        yield
        return
    watched = _Watched(sys.stdout)
    try:
        with contextlib.redirect_stdout(cast(TextIO, watched)):
            yield
    except SystemExit as ended:
        error = ended.__context__
        if error is not None and ended.code and not watched.used:
            _write_error(error, int(ended.code))
        raise


class _Watched:
    """A stream that records whether something was written to it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.used = False

    def write(self, text: str) -> int:
        self.used = self.used or bool(text)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _write_error(error: BaseException, exit_code: int) -> None:
    from cellapp.ground.results import ErrorResult

    with contextlib.suppress(OSError):  # the reader of our output has closed it
        print(ErrorResult(exit_code=exit_code, message=error_text(error)).to_json(indent=1), flush=True)


def _stop_before_job(number: int, frame: object) -> None:
    """Stop while the command is still loading, or after its job; in between, ``Job`` handles signals."""
    for hangup in HANGUP:
        signal.signal(hangup, signal.SIG_IGN)  # it may come twice
    raise Cancelled("stopped on request")


def _complain(text: str) -> None:
    with contextlib.suppress(OSError):  # the terminal was closed
        print(f"cellapp: {text}", file=sys.stderr, flush=True)
