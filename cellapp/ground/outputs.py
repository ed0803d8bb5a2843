"""The one door through which files are written that a person named: nothing is lost by a slip.

A file that is there is replaced only where that was said. A run file, a database, a profile, a key, a signed
file and an input are never replaced. A file is written beside the old one and renamed, so that a full disk
leaves the old one.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import count
from pathlib import Path
from typing import BinaryIO

from cellapp.ground.errors import InputError
from cellapp.ground.shell import shell_word

_HEAD = 256 * 1024
"""Bytes of an existing file that are read to see what it is."""
_DATABASE = b"SQLite format 3\0"
_COMPANION = re.compile(r"(.+)-(?:wal|shm|journal)")
"""Names of the files beside a database that hold what is not in it yet."""
_PROTECTED: Sequence[tuple[str, Sequence[bytes]]] = (
    ("is the file of a run, or a store of results", [rb"\A" + _DATABASE]),
    ("is a profile", [rb'^\s?"?schema"?\s*:\s*["\']?cellapp-profile\b|^extends\s*:']),
    ("is a profile", [rb"^arms\s*:", rb"^tracker\s*:"]),
    ("is an arm type, which profiles read", [rb"^model\s*:", rb"^joints\s*:"]),
    ("is a key", [rb"^-----BEGIN [A-Z ]*KEY-----"]),
    ("is a key or a signature", [rb"\Auntrusted comment:"]),
)
"""What an existing file is that is never replaced, and patterns that its beginning has then."""
_SIGNATURE_SUFFIXES = (".minisig", ".asc", ".sig")
_STREAMS = {"/dev/stdin": 0, "/dev/stdout": 1, "/dev/stderr": 2}
_OPEN_FILE = re.compile(r"/(?:dev|proc/self)/fd/([0-9]{1,6})")
CORRECTED = "corrected by cellapp for one arm: never correct this copy again"
"""Mark of what holds corrected joint positions or poses; corrected twice, they would be off by the correction."""
_TRIED = 64 * 1024
"""Bytes that a folder must take before anything is computed that goes there."""
_numbers = count()


class Writes(Enum):
    """How a path that a field names is written."""

    FILE = "the file itself; looked at before the command begins"
    FILES = "a file, or several that are named after it; looked at when they are written"
    FOLDER = "files in a folder; looked at when they are written"
    STORE = "a store of results, to which is added; never replaced"
    OWN_FOLDER = "a folder that is new, or is continued; never replaced"


@dataclass(frozen=True)
class Outputs:
    """What a caller may write to.

    Attributes
    ----------
    force : bool
        A file that is there is replaced, unless it is one that never is.
    inputs : tuple of Path
        Files that the caller reads: never replaced.
    remedy : str
        What a person can do to have a file replaced, for messages; empty where there is nothing.
    """

    force: bool = False
    inputs: tuple[Path, ...] = ()
    remedy: str = ""

    def check(self, path: Path, label: str = "") -> None:
        """Find before hours of work what would be found when writing; ``label`` stands first in messages.

        Raises
        ------
        InputError
            If there is no such folder or it takes no file, ``path`` is a folder, or a file that may not be replaced.
        """
        where = f"{label}: {path}" if label else str(path)
        if _stream(path) is None and not path.absolute().parent.is_dir():
            raise InputError(f"{where}: folder not found; nothing was done")
        if self._place(path, label) is not None and _stream(path) is None:
            with _sentence(where):
                try_folder(path.absolute().parent)

    def check_file(self, path: Path, label: str = "") -> None:
        """As ``check``, where folders that are not there are made."""
        self._place(path, label)

    def check_added_to(self, path: Path, label: str = "") -> None:
        """Find a store of results that a person named by the name of a journal. Raises ``InputError``."""
        if _beside_database(Path(os.path.realpath(path))):
            raise InputError(_never(f"{label}: {path}", "belongs to the database beside it"))

    def write_text(self, path: Path, text: str, label: str = "") -> None:
        """Write UTF-8 text as ``write`` does."""
        self.write(path, text.encode("utf-8"), label)

    def write(self, path: Path, data: bytes, label: str = "") -> None:
        """Write a file whole or not at all. Raises ``InputError`` as ``open`` does."""
        with self.open(path, label) as file:
            file.write(data)

    @contextlib.contextmanager
    def open(self, path: Path, label: str = "") -> Iterator[BinaryIO]:
        """A file to write to; it has its name when the block ends well, else what was there is still there.

        A device, a pipe and standard output are written to as they are.

        Raises
        ------
        InputError
            If ``path`` is a folder, a file that may not be replaced, or cannot be written.
        """
        where = f"{label}: {path}" if label else str(path)
        place = self._place(path, label)
        number = _stream(path)
        if number is not None:
            with _opened(number, where) as file:
                yield file
            return
        with _sentence(where):
            if place is None:
                with open(path, "wb") as file:
                    yield file
                return
            with written_beside(place, replace=self.force or _is_empty(place)) as file:
                yield file

    def _place(self, path: Path, label: str) -> Path | None:
        """The file that a path leads to, links followed; None for what is no file on a disk. Raises ``InputError``."""
        where = f"{label}: {path}" if label else str(path)
        with _sentence(where):
            found = _status(path)
            place = Path(os.path.realpath(path))
        if found is None:
            if _beside_database(place):
                raise InputError(_never(where, "belongs to the database beside it"))
            return place
        if stat.S_ISDIR(found.st_mode):
            raise InputError(f"{where} is a folder; give the path of a file. Nothing was done")
        if stat.S_ISBLK(found.st_mode):
            raise InputError(f"{where} is a disk; give the path of a file. Nothing was done")
        if not stat.S_ISREG(found.st_mode):
            return None
        if what := self._protected(path, place):
            raise InputError(_never(where, what))
        if _stream(path) is not None:
            return None
        if not self.force and found.st_size:
            how = f"move it away, or {self.remedy}" if self.remedy else "or move it away"
            raise InputError(f"{where} exists already; nothing was written. Give another name, {how}")
        if not os.access(place, os.W_OK):
            raise InputError(f"{where} is write-protected; make it writable, or move it away. Nothing was done")
        return place

    def _protected(self, path: Path, place: Path) -> str:
        """What an existing file is that is never replaced; empty for any other. Raises ``InputError``."""
        if what := _kind(place):
            return what
        for one in self.inputs:
            with contextlib.suppress(OSError, ValueError):
                if os.path.samefile(one, path):
                    return f"is an input of this command ({one})" if str(one) != str(path) else "is also an input"
        return ""


NEW_ONLY = Outputs()
"""Replaces nothing."""
RENEWED = Outputs(force=True)
"""For files that cellapp itself names in a folder of its own, as a run's page, and for what a person agreed to."""


def write_new(files: dict[Path, str], outputs: Outputs = NEW_ONLY) -> tuple[Path, ...]:
    """Write files of UTF-8 text as ``write_new_bytes`` does."""
    return write_new_bytes({path: text.encode("utf-8") for path, text in files.items()}, outputs)


def write_new_bytes(files: dict[Path, bytes], outputs: Outputs = NEW_ONLY) -> tuple[Path, ...]:
    """Write files and their missing folders; return their paths. A file with the same content is left as it is.

    Raises
    ------
    InputError
        If a file must not be written, as one with other content exists (nothing was written then), or cannot be.
    """
    changed = {path: data for path, data in files.items() if not path_exists(path) or _content_of(path) != data}
    for path in changed:
        outputs.check_file(path)
    for path, data in changed.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); give a folder that you may write to"
            ) from None
        outputs.write(path, data)
    return tuple(files)


def path_exists(path: Path) -> bool:
    """Return whether something is at ``path``. Raise ``InputError`` if the system cannot tell."""
    try:
        return path.exists()
    except OSError as error:
        raise InputError(f"{path}: cannot be reached ({error.strerror}); give another folder") from None


def _content_of(path: Path) -> bytes | None:
    """Return the content of a file; None if it cannot be read, or is not a regular file."""
    try:
        if not path.is_file():
            return None
        return path.read_bytes()
    except OSError:
        return None


def require_suffix(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Raise ``InputError`` for a file of ``what`` whose name ends otherwise than in one of ``suffixes``."""
    if path.suffix.lower() not in suffixes:
        so = f", not as {path.suffix}" if path.suffix else ""
        name = shell_word(path.with_suffix(suffixes[0]))
        raise InputError(f"{what} is written as {' or '.join(suffixes)}{so}: give --out {name}. Nothing was written")


def try_folder(folder: Path) -> None:
    """Write a file without a name in a folder, before hours of work; raise ``OSError`` if that cannot be done."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_TRIED))
    except OSError as error:
        if error.filename is not None:
            error.filename = str(folder)  # not the name that was tried
        raise


@contextlib.contextmanager
def written_beside(place: Path, *, replace: bool) -> Iterator[BinaryIO]:
    """A file in the same folder that takes the name ``place`` when the block ends well, and is removed otherwise.

    Raises
    ------
    OSError
        If it cannot be written, or without ``replace`` a file of that name is there by then.
    """
    part = place.with_name(f".cellapp-{os.getpid()}-{next(_numbers)}.part")
    try:
        with open(part, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if replace:
            if place.exists():
                shutil.copymode(place, part)
            os.replace(part, place)
        else:
            _name_new(part, place)
    except BaseException:  # Ctrl-C too leaves nothing behind
        with contextlib.suppress(OSError):
            part.unlink()
        raise


def _name_new(part: Path, place: Path) -> None:
    """Give a file its name, which no other file may have got meanwhile."""
    try:
        os.link(part, place)
    except FileExistsError:
        raise
    except OSError:  # a disk without links
        if os.path.lexists(place):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(place)) from None
        os.rename(part, place)
        return
    part.unlink()


@contextlib.contextmanager
def _sentence(where: str) -> Iterator[None]:
    """Turn what the system refuses into a sentence."""
    try:
        yield
    except FileExistsError:
        raise InputError(f"{where} was made by another program meanwhile; nothing was written. Repeat this") from None
    except OSError as error:
        raise InputError(
            f"{where}: cannot be written ({error.strerror or error}); give a file in a folder that you may write to and"
            " that has space"
        ) from None


def _never(where: str, what: str) -> str:
    return f"{where} {what}; such a file is never replaced. Nothing was written; give another name"


def _status(path: Path) -> os.stat_result | None:
    """What is at a path, links followed; None for nothing. Raises ``OSError`` if that cannot be told."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None
    except ValueError as error:  # a zero byte in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None


def _is_empty(place: Path) -> bool:
    """Whether there is a file without content, as ``mktemp`` makes: it holds nothing to lose."""
    found = _status(place)
    return found is not None and found.st_size == 0


def _beside_database(place: Path) -> bool:
    """Whether a name is that of a journal of a database that is there."""
    match = _COMPANION.fullmatch(place.name)
    return match is not None and _head(place.with_name(match[1])).startswith(_DATABASE)


def _kind(place: Path) -> str:
    """What an existing file is that is never replaced, by its content and its neighbours; empty for any other."""
    if not os.access(place, os.R_OK):
        return "cannot be read, so that nobody knows what it is"
    head = _head(place)
    for what, patterns in _PROTECTED:
        if all(re.search(pattern, head, re.MULTILINE) for pattern in patterns):
            return what
    if _beside_database(place):
        return "belongs to the database beside it"
    for suffix in _SIGNATURE_SUFFIXES:
        if os.path.lexists(place.with_name(place.name + suffix)):
            return f"is signed ({place.name}{suffix} stands beside it)"
    return ""


def _head(path: Path) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(_HEAD)
    except OSError:
        return b""


def _stream(path: Path) -> int | None:
    """The number of the open file that a path as /dev/stdout means; None for any other path."""
    text = str(path)
    match = _OPEN_FILE.fullmatch(text)
    return int(match[1]) if match else _STREAMS.get(text)


@contextlib.contextmanager
def _opened(number: int, where: str) -> Iterator[BinaryIO]:
    """An open file of this program, as standard output, written to where it stands: nothing in it is cut off.

    That its reader went away is left to the caller: it is no fault of the file.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    try:
        with open(os.dup(number), "wb") as file:
            yield file
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{where}: cannot be written ({error.strerror or error})") from None
