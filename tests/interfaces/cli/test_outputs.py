"""No option of any command replaces what is there, unless that is said; some files never. The options are derived."""

from __future__ import annotations

import errno
import inspect
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import numpy as np
import pytest
import typer

from cellapp.cell.run import RunFile
from cellapp.commands.registry import records
from cellapp.estimation.readings import Readings
from cellapp.ground import outputs
from cellapp.ground.errors import InputError
from cellapp.ground.outputs import NEW_ONLY, RENEWED, Outputs, Writes, write_new
from cellapp.interfaces import cli
from tests.cell.run.small_runs import two_arms
from tests.interfaces.cli.conftest import exit_code
from tests.program import app
from tests.sure import sure
from tests.twin import write_profile

ROOT = Path(__file__).parents[3]
OLD = b"what a person wrote\n"
REQUESTS = (("stop",), ("job", "pause"), ("job", "resume"), ("job", "abort"))
"""They look at the file after the request was sent, which may be a stop."""
READ = {
    *(
        "--run",
        "--from",
        "--against",
        "--prior",
        "--answers",
        "--readings",
        "--data",
        "--key",
        "--public-key",
        "--person",
        "--reference-nests",
        "--joints",  # of import; those of export are written, and say so
        "--points",
    ),
    *("--token-file", "--profile", "--profiles", "--simulated-plant"),
}
"""Options that name files or folders which are read, or runs that are made, never over others."""
PLACES = ("FILE", "CSV", "DIR", "FOLDER", "KEYFILE", "PUB", "EARLIER")
"""How options say in the help that they name a file or folder."""


class Command(NamedTuple):
    words: tuple[str, ...]
    function: Callable[..., Any]


def commands(group: typer.Typer = app, words: tuple[str, ...] = ()) -> Iterator[Command]:
    """Every command that there is."""
    for one in group.registered_commands:
        function = inspect.unwrap(sure(one.callback))
        yield Command((*words, one.name or function.__name__.replace("_", "-")), function)
    for below in group.registered_groups:
        yield from commands(sure(below.typer_instance), (*words, sure(below.name)))


ALL = tuple(commands())
WRITTEN = {
    verb.name: {verb.request.option_of(name): words.writes for name, words in verb.request.asked() if words.writes}
    for verb in records()
}


def written_by(command: Command) -> dict[str, Writes]:
    """The options of a command that write, and how."""
    first, own = command.words[0], " ".join(command.words)
    return {**(WRITTEN.get(own) or WRITTEN.get(first, {})), "--json": Writes.FILE}


FILES = [(one, option) for one in ALL for option, how in written_by(one).items() if how is Writes.FILE]
IDS = [" ".join((*one.words, option)) for one, option in FILES]


@pytest.fixture
def run_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a run in the folder R below the working folder, closed, and what else is never replaced."""
    monkeypatch.chdir(tmp_path)
    with RunFile.create(Path("R"), two_arms()) as run:
        run.add_stop(0, {"left": Readings.one(q=np.zeros(2), p_M=np.zeros(3))})
    Path("there.txt").write_bytes(OLD)
    Path("cell.yaml").write_text("# a cell\nschema: cellapp-profile\nversion: 1\n")
    Path("draft.txt").write_text("name: draft\narms:\n  left: {}\ntracker: {}\n")
    Path("k.key").write_text("-----BEGIN ENCRYPTED PRIVATE KEY-----\nMIG\n-----END ENCRYPTED PRIVATE KEY-----\n")
    Path("k.pub").write_text("untrusted comment: minisign public key 1\nRWQ\n")
    Path("signed.json").write_text("{}\n")
    Path("signed.json.minisig").write_text("untrusted comment: signature\n")
    Path("SHA256SUMS").write_text("0  certificate.json\n")
    Path("SHA256SUMS.asc").write_text("-----BEGIN PGP SIGNATURE-----\n")
    Path("link.csv").symlink_to("R/run.sqlite")
    Path("hard.csv").hardlink_to("R/run.sqlite")
    return Path("R/run.sqlite")


PROTECTED = (
    *("R/run.sqlite", "link.csv", "hard.csv", "cell.yaml", "draft.txt", "k.key", "k.pub"),
    *("signed.json", "signed.json.minisig", "SHA256SUMS"),
)


def files_here() -> dict[str, bytes]:
    """Name -> content; the journals that SQLite makes for readers of a run are its own."""
    found = (path for path in Path().rglob("*") if path.is_file() and not path.name.endswith(("-shm", "-wal")))
    return {str(path): path.read_bytes() for path in found}


def usage(command: Command, given: str, but: str) -> list[str]:
    """The words that a command must have, each a path that is there, but one option."""
    words = [*command.words]
    for one in inspect.signature(command.function, eval_str=True).parameters.values():
        info = next((it for it in get_args(one.annotation)[1:] if hasattr(it, "param_decls")), None)
        if one.default is not inspect.Parameter.empty or info is None:
            continue
        if not isinstance(info, typer.models.OptionInfo):
            words.append(given)
        elif info.default != but:
            words += [str(info.default), "elsewhere"]
    return words


# -- the declarations -------------------------------------------------------------------------------------------------


def test_every_option_that_names_a_place_says_whether_it_writes() -> None:
    open_ones = []
    for command in ALL:
        written = written_by(command)
        for one in inspect.signature(command.function, eval_str=True).parameters.values():
            if get_origin(one.annotation) is not Annotated:
                continue
            kind, *rest = get_args(one.annotation)
            info = next(it for it in rest if hasattr(it, "param_decls"))
            is_place = "Path" in str(kind) or info.metavar in PLACES
            if isinstance(info, typer.models.OptionInfo) and is_place and info.default not in {*written, *READ}:
                open_ones.append((command.words, info.default))
    assert open_ones == [], "say in the annotation how it writes (Writes), or name it above if it is read"


def test_every_command_has_its_outputs() -> None:
    assert len(ALL) > 25
    assert [one.words for one in ALL if "json_file" not in inspect.signature(one.function).parameters] == []
    by_option = {option for one in ALL for option in written_by(one)}
    assert by_option == {
        "--json",
        "--csv",
        "--plan",
        "--out",
        "--results",
        "--joints",
        "--points",
        "--controllers",
        "--bundle",
    }


# -- every option of every command ------------------------------------------------------------------------------------


def protected_from(command: Command, option: str) -> tuple[str, ...]:
    """The run file and one other for each option, all for one that a person uses most: one door decides for all."""
    if (command.words, option) == (("export",), "--csv"):
        return PROTECTED
    return "R/run.sqlite", PROTECTED[FILES.index((command, option)) % len(PROTECTED)]


@pytest.mark.parametrize(("command", "option"), FILES, ids=IDS)
def test_what_is_there_stays(
    command: Command, option: str, run_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files_here()
    words = usage(command, "R", option)
    for name in ("there.txt", *protected_from(command, option)):
        assert exit_code(monkeypatch, *words, option, name) == 2, name
        said = capsys.readouterr().err
        if command.words not in REQUESTS:
            assert f"{option}: {name} " in said, said
            assert "othing was" in said, said
    for name in protected_from(command, option):
        assert exit_code(monkeypatch, *words, option, name, "--force") == 2, name
        said = capsys.readouterr().err
        if command.words not in REQUESTS:
            assert "never replaced" in said, said
    if len(words) > len(command.words) and command.words not in REQUESTS:
        given = usage(command, "there.txt", option)
        if "there.txt" in given:
            assert exit_code(monkeypatch, *given, option, "there.txt", "--force") == 2
            assert "input" in capsys.readouterr().err
    assert files_here() == before


WRITERS = [
    (("export", "R"), "--csv", b"configuration,arm"),
    (("show", "R"), "--json", b"{"),
    (("docs", "--schema", "cellapp-check"), "--json", b"{"),
    (("runs", "."), "--json", b"{"),
    (("docs", "backlash"), "--json", b"{"),
]


@pytest.mark.parametrize(("words", "option", "begins"), WRITERS, ids=[f"{one[0][0]} {one[1]}" for one in WRITERS])
def test_force_replaces_whole_or_not_at_all(
    words: tuple[str, ...], option: str, begins: bytes, run_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("empty.txt").touch()
    for name in ("new.txt", "empty.txt"):
        assert exit_code(monkeypatch, *words, option, name) == 0
        assert Path(name).read_bytes().lower().startswith(begins.lower())
    before = files_here()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        for name, force in (("there.txt", ["--force"]), ("other.txt", [])):
            assert exit_code(patch, *words, option, name, *force) == 2
    assert files_here() == before, "neither a part of the new one nor a gap where the old one was"
    Path("to.txt").symlink_to("there.txt")
    assert exit_code(monkeypatch, *words, option, "to.txt", "--force") == 0
    assert Path("to.txt").is_symlink()
    assert Path("there.txt").read_bytes().lower().startswith(begins.lower())


def full(handle: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_two_options_with_one_file(run_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for force in ([], ["--force"]):
        assert exit_code(monkeypatch, "export", "R", "--csv", "a.csv", "--json", "a.csv", *force) == 2
    assert not Path("a.csv").exists()


def test_a_journal_of_a_run_is_neither_a_store_nor_a_file(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("trials", "power", str(write_profile(tmp_path / "small")))
    for suffix in ("-wal", "-journal", "-shm"):
        name = f"R/run.sqlite{suffix}"
        assert exit_code(monkeypatch, "show", "R", "--json", name, "--force") == 2
        assert exit_code(monkeypatch, *words, "--results", name) == 2
    assert exit_code(monkeypatch, *words, "--results", "R/run.sqlite") == 2


# -- the door itself --------------------------------------------------------------------------------------------------


def test_files_that_are_named_after_an_option(run_file: Path) -> None:
    files = {Path("new/a.txt"): "a", Path("there.txt"): "b"}
    with pytest.raises(InputError, match=r"there\.txt exists already"):
        write_new(files)
    assert not Path("new").exists()
    write_new(files, Outputs(force=True))
    assert Path("there.txt").read_text() == "b"
    write_new(files)  # the same content: nothing to lose
    for name in PROTECTED:
        with pytest.raises(InputError, match="never replaced"):
            write_new({Path(name): "x"}, RENEWED)


def test_a_file_that_another_program_makes_meanwhile_stays(run_file: Path) -> None:
    def write() -> None:
        with NEW_ONLY.open(Path("late.txt")) as file:
            file.write(b"mine")
            Path("late.txt").write_bytes(OLD)

    with pytest.raises(InputError, match="made by another program"):
        write()
    assert Path("late.txt").read_bytes() == OLD
    assert not list(Path().glob(".cellapp-*"))


@pytest.mark.skipif(sys.platform == "win32", reason="no such devices")
def test_devices_pipes_and_standard_output_are_written_to_as_they_are(run_file: Path) -> None:
    RENEWED.write(Path("/dev/null"), b"x")
    with pytest.raises(InputError, match=r"/dev/full: cannot be written \(No space left on device\)"):
        NEW_ONLY.write(Path("/dev/full"), b"x")
    with Path("grown.txt").open("wb") as out:
        out.write(OLD)
        out.flush()
        assert program("docs", "--schema", "cellapp-check", "--json", "/dev/stdout", stdout=out).returncode == 0
    assert Path("grown.txt").read_bytes().startswith(OLD), "what was redirected is added, nothing is cut off"
    with Path("/dev/full").open("wb") as out:
        done = program("show", "R", "--json", "-", stdout=out)
    assert done.returncode == 2
    assert b"cellapp: --json: standard output cannot be written (No space left on device)" in done.stderr
    for words in (("docs", "effects"), ("show", "R")):
        with Path("/dev/full").open("wb") as out:
            done = program(*words, stdout=out)
        assert done.returncode == 2, words
        told = b"cellapp: standard output cannot be written (No space left on device); nothing more is printed"
        assert done.stderr.splitlines() == [told], words


@pytest.mark.skipif(sys.platform == "win32", reason="a shell with pipes")
@pytest.mark.parametrize("words", ["docs --schema --json -", "docs effects"])
def test_who_reads_one_line_ends_it_well(words: str, run_file: Path) -> None:
    line = f"set -o pipefail; {sys.executable} -m cellapp {words} | head -1"
    done = subprocess.run(["bash", "-c", line], capture_output=True, env=surroundings(), timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def surroundings() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def program(*words: str, stdout: Any = subprocess.PIPE) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "cellapp", *words],
        stdout=stdout,
        stderr=subprocess.PIPE,
        env=surroundings(),
        timeout=60,
        check=False,
    )


def test_no_other_room_opens_a_file_to_replace_it() -> None:
    """Whoever writes what a person named goes through the door; these write files that cellapp itself names."""
    own = {
        "cellapp/ground/outputs.py",
        "cellapp/robot/model/model.py",
        "cellapp/cell/run/file.py",
        "cellapp/commands/trials/sealed.py",
    }
    words = (".write_text(", ".write_bytes(", "os.replace(", '.open("w', '"wb")', "copyfile(")
    doors = ("outputs.write_text(", "RENEWED.write_text(", "REMEDY).write_text(")
    found = set()
    for path in (ROOT / "cellapp").rglob("*.py"):
        text = path.read_text("utf-8")
        for door in doors:
            text = text.replace(door, "")
        if any(word in text for word in words):
            found.add(path.relative_to(ROOT).as_posix())
    assert found == own
    assert outputs.__doc__ is not None


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("calibrate.run.calibrate_run", "calibrate run"),
        ("discover.run.discover_run", "discover run"),
        ("compensate.run.compensate_run", "compensate run targets.yaml"),
        ("push.run.push_targets", "push run targets.yaml"),
        ("check.run.check_run", "check run"),
        ("report.run.read_results", "report run"),
        ("compensate.run.correct", "compensate run a.script --out b.script --json made.json"),
    ],
)
def test_whether_results_can_be_stored_is_asked_before_they_are_computed(
    module: str, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def full(dir: Path) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(dir / "tried"))

    monkeypatch.chdir(tmp_path)
    RunFile.create(Path("run"), two_arms()).close()
    Path("targets.yaml").write_text("schema: cellapp-targets\nversion: 1\ntargets: []\n", "utf-8")
    monkeypatch.setattr(f"cellapp.commands.{module}", lambda *asked, **more: pytest.fail("it was begun"))
    monkeypatch.setattr("cellapp.ground.outputs.tempfile.TemporaryFile", full)
    monkeypatch.setattr(sys, "argv", ["cellapp", *words.split()])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "Read-only file system" in said
    assert "tried" not in said
