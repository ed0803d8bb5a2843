"""The command line: every command once, its JSON, its exit code, and one sentence for every bad input."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from cellapp.cell.planning.planned_stops import straight_stops, write_planned_stops
from cellapp.cell.run import RunFile
from drivers.findings import Finding
from tests.approved import assert_approved, commands_of, without_digits
from tests.cell.run.small_runs import alter_file, files
from tests.interfaces.cli.conftest import Ended, exit_code, one_sentence
from tests.loopback import own_address
from tests.sure import sure
from tests.twin import PROFILES, write_profile
from tests.waiting import WAIT_S, process_of, until, within

ROOT = Path(__file__).parents[3]
RUN_S = 240.0
"""What a whole command may compute."""
DRAWN = "  stops: 30\n  method: random"
"""To design stops takes seconds; what loads for it and what it prints is tested with a few."""
FAR = "  - {name: far, arm: left, position: [9.0, 0.0, 0.0], rpy: [0, 0, 0]}"


def few_targets() -> str:
    """The first targets of each arm, and one that is out of reach."""
    head, _, listed = (PROFILES / "targets" / "twin.yaml").read_text("utf-8").partition("targets:\n")
    rows = listed.splitlines()
    chosen = [row for arm in ("left", "right") for row in [row for row in rows if f"arm: {arm}" in row][:4]]
    return "\n".join([f"{head}targets:", *chosen, FAR, ""])


def python(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run Python as a process of its own, which shows its warnings."""
    env = {**os.environ, "PYTHONWARNINGS": "default", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=RUN_S, check=False)


def shell(*arguments: object, cwd: Path) -> Ended:
    """Run the program as a process of its own."""
    done = python("-m", "cellapp", *map(str, arguments), cwd=cwd)
    assert "Traceback" not in done.stdout + done.stderr
    return Ended(done.returncode, done.stdout, done.stderr)


def test_no_warning_of_a_library_reaches_a_user() -> None:
    """Neither of this process nor of one that it starts; a warning of numpy says nothing to a person at a robot."""
    warn = "import numpy; numpy.log(numpy.zeros(1))"
    code = (
        "import subprocess, sys; from cellapp.interfaces.cli.program import run_program;"
        f"run_program(lambda: (exec({warn!r}), subprocess.run([sys.executable, '-c', {warn!r}])))"
    )
    env = {key: value for key, value in os.environ.items() if key != "PYTHONWARNINGS"} | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert ended.stderr == ""


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the profile, targets, and runs: planned, collected, calibrated, pushed. Never written by a test."""
    folder = tmp_path_factory.mktemp("made")
    edit(write_profile(folder), "  stops: 30", DRAWN)
    (folder / "targets.yaml").write_text(few_targets())
    steps: dict[str, Sequence[Sequence[object]]] = {
        "planned": [("plan", "twin.yaml", "--run", "planned")],
        "collected": [("collect", "collected")],
        "calibrated": [("calibrate", "calibrated")],
        "done": [("discover", "done"), ("push", "done", "targets.yaml", "--verify")],
    }
    before = None
    for name, commands in steps.items():
        if before is not None:
            shutil.copytree(folder / before, folder / name)
        for command in commands:
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(folder)
                assert exit_code(patch, *command, "--json", f"{name}-{command[0]}.json") == 0
        before = name
    return folder


@pytest.fixture
def work(made: Path, tmp_path: Path) -> Path:
    """A copy of all that."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


# -- every command once -----------------------------------------------------------------------------------------------


def test_the_steps_one_by_one(made: Path) -> None:
    results = {path.stem.partition("-")[2]: json.loads(path.read_text()) for path in made.glob("*.json")}
    assert {step: (result["schema"], result["version"]) for step, result in results.items()} == {
        "plan": ("cellapp-plan", 1),
        "collect": ("cellapp-collect", 1),
        "calibrate": ("cellapp-calibrate", 1),
        "discover": ("cellapp-discover", 1),
        "push": ("cellapp-verify", 1),
    }
    assert results["plan"]["stops"] == {"left": 30, "right": 30}
    assert results["collect"]["stops"] == 30
    for name in ("left", "right"):
        arm = results["calibrate"]["arms"][name]
        nominal, geometry = (arm["validate"][stage]["position_mm"] for stage in ("nominal", "geometry"))
        assert geometry["mean"] < nominal["mean"]
        assert nominal["n"] == geometry["n"] == 10
        assert {"value", "standard_error", "unit"} <= set(next(iter(arm["identified"].values())))
        assert results["discover"]["arms"][name]["verdict"] in (
            "explained", "nothing missing", "unknown effect", "ambiguous",
        )  # fmt: skip
        verified = results["push"]["arms"][name]
        assert verified["compensated_mm"]["mean"] < 0.2 * verified["nominal_mm"]["mean"]
    assert results["calibrate"]["pair"]["method_1"]["cooperative_mm"]["n"] == 10
    notes = [target["note"] for target in results["push"]["targets"]]
    assert notes[-1].startswith("out of reach: ")
    assert notes.count("") >= 6


def test_doctor(work: Path, call: Any) -> None:
    assert call("doctor", "twin.yaml", "--json", "-").json["schema"] == "cellapp-doctor"
    text = (work / "ur10-ur5.yaml").read_text("utf-8")  # a port that nobody serves, on this machine
    (work / "ur10-ur5.yaml").write_text(re.sub(r"host: 192\.168\.0\.1", "host: 127.0.0.1", text), "utf-8")
    ended = call("doctor", "ur10-ur5.yaml")
    assert ended.code == 1
    assert "checks failed" in ended.err


def test_the_whole_run_in_one_command(work: Path, call: Any) -> None:
    (work / "targets" / "twin.yaml").write_text(few_targets())
    ended = call("run", "twin.yaml", "--run", "all/of/it", "--json", "-")
    assert ended.code == 0, ended.err
    found = ended.json
    assert set(found) >= {"calibrate", "discover", "compensate", "verify"}
    assert {path.name for path in (work / "all/of/it").iterdir()} >= {"run.sqlite", "calibration.json", "report.html"}
    assert not [path for path in (work / "all/of/it").iterdir() if path.name.startswith("run.sqlite-")]


SHOWN = (
    "overview",
    "calibration",
    "parameters",
    "discovery",
    "plan",
    "collection",
    "targets",
    "verification",
    "history",
)


def test_results_are_valid_by_the_exported_schemas(made: Path, work: Path, call: Any) -> None:
    schemas = call("docs", "--schema", "--json", "-").out
    schemas = json.loads(schemas)
    results = [json.loads(path.read_text("utf-8")) for path in made.glob("*-*.json")]
    results += [call("show", "done", part, "--json", "-").json for part in SHOWN]
    results += [
        call("runs", ".", "--json", "-").json,
        call("show", "collected", "--against", "done", "--json", "-").json,
    ]
    results += [call("report", "done", "--json", "-").json, call("doctor", "twin.yaml", "--json", "-").json]
    assert len({result["schema"] for result in results}) >= 10
    for result in results:
        jsonschema.validate(result, schemas[result["schema"]])
    assert json.loads(call("docs", "cellapp-calibrate", "--schema").out) == schemas["cellapp-calibrate"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**results[0], "unknown": 1}, schemas[results[0]["schema"]])


def test_a_verification_that_does_not_hold_exits_with_one(
    work: Path, call: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "cellapp.cell.driving.target_visit.with_approach", lambda arm, command, here, conditions: command + 0.02
    )
    ended = call("push", "done", "targets.yaml", "--verify", "--json", "-")
    assert ended.code == 1
    assert "verification: arm left: the mean error at compensated targets is" in ended.err
    assert ended.json["arms"]["left"]["compensated_mm"]["mean"] > 5.0, "the numbers are reported all the same"


# -- readings out and in ----------------------------------------------------------------------------------------------


def test_an_import_in_order_says_what_it_derived(work: Path, call: Any) -> None:
    readings = PROFILES.parent / "tests" / "fixtures" / "ur5-real" / "readings.csv"
    made = call(
        "import", str(PROFILES / "ur5-real.yaml"), str(readings), "--run", "ordered", "--in-order", "--json", "-"
    )
    assert made.json["in_order"] == {"left": {"by": "rows", "approach": 6114, "step": 6114, "contradicted": 0}}
    assert "6114 approach signs" in made.err
    assert "6114 approach signs" in call("show", "ordered").out


# -- bad input --------------------------------------------------------------------------------------------------------


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")


def misspelt_key(work: Path) -> None:
    edit(work / "twin.yaml", "payload:", "payloud:")


def truncated(work: Path) -> None:
    file = work / "collected" / "run.sqlite"
    file.write_bytes(file.read_bytes()[:5000])


def newer(work: Path) -> None:
    alter_file(work / "collected", "PRAGMA user_version=99")


def damaged_basis(work: Path) -> None:
    alter_file(work / "done", "UPDATE stage SET basis = 'x' WHERE name = 'discover'")


def damaged_model(work: Path) -> None:
    alter_file(work / "done", "UPDATE stage SET model = '[1]' WHERE name = 'calibrate'")


def other_splits(work: Path) -> None:
    with RunFile.open(work / "done", write=True) as run:
        for name in run.profile.arms:
            words = list(run.readings(name).split or ())
            run.assign_splits(name, [*words[1:], words[0]])


SPOILS = {one.__name__: one for one in (other_splits, misspelt_key, truncated, newer, damaged_basis, damaged_model)}
TRANSCRIPTS = sorted((Path(__file__).parent / "transcripts").glob("*.txt"))


def keys_of(value: Any, depth: int = 0) -> list[str]:
    """The keys of JSON, one a line; of lists the length."""
    if isinstance(value, dict):
        return [line for key, one in value.items() for line in ("  " * depth + key, *keys_of(one, depth + 1))]
    return ["  " * depth + f"{len(value)} values"] if isinstance(value, list) else []


def bare(text: str) -> str:
    """Without digits and the widths of columns."""
    return re.sub(r"[ ─]+", " ", without_digits(text))


@pytest.mark.parametrize("path", TRANSCRIPTS, ids=lambda path: path.stem)
def test_a_transcript_says_what_was_approved(
    path: Path, work: Path, call: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``cellapp WORDS``; ``does WORDS``, of which only the exit code is kept; ``refused WORDS`` and ``looks WORDS``,
    which fail or not, and change no byte; ``spoil WHAT``; ``log``; ``write FILE TEXT``; ``edit FILE OLD NEW``;
    ``keys FILE``; ``page HEADING``; ``same FILE FILE``. Below stands what is printed, marked if on standard error, and
    an exit code that is not 0. Digits are compared where commands are refused.
    """
    monkeypatch.setenv("COLUMNS", "100")
    shown = []
    for command in commands_of(path):
        shown.append(f"$ {command}")
        what, *words = shlex.split(command)
        before = files(work)
        match what:
            case "spoil":
                SPOILS[words[0]](work)
            case "log":
                with RunFile.open(work / "done", write=True) as run:
                    run.log("warning", "the first line")
                    run.log("info", "the last line")
            case "write":
                (work / words[0]).write_text(words[1].replace("\\n", "\n"), "utf-8")
            case "edit":
                edit(work / words[0], words[1].replace("\\n", "\n"), words[2])
            case "keys":
                shown += keys_of(json.loads((work / words[0]).read_text("utf-8")))
            case "page":
                assert f"<h2>{words[0]}</h2>" in (work / "done" / "report.html").read_text("utf-8")
            case "same":
                assert (work / words[0]).read_bytes() == (work / words[1]).read_bytes()
            case _:
                ended = call(*words)
                if what != "does":
                    shown += [*ended.out.splitlines(), *(f"! {line}" for line in ended.err.splitlines() if line)]
                shown += [f"exit code {ended.code}"] if ended.code else []
                assert what in ("cellapp", "does") or (ended.code > 0) == (what == "refused"), command
                assert what in ("cellapp", "does") or files(work) == before, command
    exact = path.stem.startswith("refused")
    text = re.sub(r"/\S+/made\d+/", "MADE/", "\n".join(shown).replace(str(work), "HERE"))
    assert_approved(path, text, str if exact else bare)


def test_fewer_readings_than_parameters(work: Path, call: Any) -> None:
    """Priors complete what the readings do not determine: 18 coordinates improve the nominal geometry, pairs wait."""
    assert call("export", "collected", "--csv", "good.csv").code == 0
    with (work / "good.csv").open(newline="") as good, (work / "bad.csv").open("w", newline="") as bad:
        rows = list(csv.DictReader(good))[:20]
        writer = csv.DictWriter(bad, [*rows[0], "split"])
        writer.writeheader()
        for row in rows:
            writer.writerow({**row, "split": "identify" if int(row["configuration"]) < 6 else "validate"})
    assert call("import", "twin.yaml", "bad.csv", "--run", "few").code == 0
    ended = call("calibrate", "few", "--json", "-")
    assert ended.code == 0
    for arm in ended.json["arms"].values():
        shown = {stage: errors["position_mm"]["rms"] for stage, errors in arm["validate"].items()}
        assert shown["geometry"] < 0.9 * shown["nominal"]
    assert "pair: skipped, 10 common stops leave 6 to identify and 4 to validate" in " ".join(ended.json["notes"])


def test_a_controller_that_is_not_there_is_named_and_nothing_is_stored(work: Path, call: Any) -> None:
    edit(work / "ur10-ur5.yaml", "stops: 400", "stops: 3\n  method: random")
    edit(work / "ur10-ur5.yaml", "192.168.0.10", own_address(49))
    edit(work / "ur10-ur5.yaml", "192.168.0.11", own_address(50))
    assert call("plan", "ur10-ur5.yaml", "--run", "real").code == 0
    before = files(work)
    one_sentence(call("collect", "real"), f"arm left: {own_address(49)}:29999: no connection", code=3)
    assert files(work) == before


def test_real_arms_move_only_where_it_is_allowed_and_the_doctor_is_green_now(
    work: Path, call: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = [Finding("arm left: link", "failed", "no answer")]
    monkeypatch.setattr("cellapp.commands.confirm.examine", lambda profile: failed)
    edit(work / "ur10-ur5.yaml", "stops: 400", "stops: 3\n  method: random")
    assert call("plan", "ur10-ur5.yaml", "--run", "real").code == 0
    before = files(work)
    one_sentence(call("collect", "real"), "this moves real arms (left, right)", "--allow-motion")
    one_sentence(call("collect", "real", "--allow-motion"), "arm left: link: no answer", "nothing was moved", code=1)
    assert files(work) == before


# -- processes --------------------------------------------------------------------------------------------------------

LIGHT = (
    "--help",
    "plan twin.yaml --run new",
    "collect planned",
    "doctor twin.yaml",
    "docs backlash",
    "runs .",
    "show done --against calibrated",
    *(f"show done {part}" for part in ("overview", "calibration", "discovery", "verification", "plan")),
    "calibrate collected",
    "discover calibrated",
    "compensate done targets.yaml",
    "report done",
)
"""Commands that neither open the terminal application nor need several computers."""
WATCH = """
import sys
from cellapp.interfaces import cli
HEAVY = {"torch", "matplotlib", "pandas", "dask", "plotly", "playwright", "textual", "scipy.stats"}
for command in sys.argv[1:]:
    sys.argv = ["cellapp", *command.split()]
    try:
        cli.main()
    except SystemExit as ended:
        assert not ended.code, command
    heavy = HEAVY & sys.modules.keys()
    assert not heavy, f"{command}: {heavy}"
"""


def test_what_takes_long_to_load_is_loaded_by_no_command_that_needs_it_not(work: Path) -> None:
    edit(work / "twin.yaml", DRAWN, "  stops: 12")
    done = python("-c", WATCH, *LIGHT, cwd=work)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def long_run(work: Path) -> Path:
    """A run of many stops between two that were planned, long enough to be interrupted."""
    with RunFile.open(work / "planned", write=True) as run:
        plan = run.read_plan()
        write_planned_stops(run, straight_stops({name: np.tile(q[:2], (60, 1)) for name, q in plan.items()}))
    return work / "planned"


def wait_for_stops(run: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a collecting process has stored some stops."""

    def some() -> bool:
        if process.poll() is not None:
            pytest.fail(f"it ended by itself: {process.stderr.read() if process.stderr else ''}")
        with RunFile.open(run) as seen:
            return len(seen.stops_done()) >= 5

    until(some, "the first stops")


def interrupted(run: Path, number: int) -> tuple[int, str]:
    """Collect as a process, and send it a signal when some stops are stored; exit code and standard error."""
    with process_of("cellapp", "collect", run.name, cwd=run.parent) as process:
        wait_for_stops(run, process)
        process.send_signal(number)
        _, err = process.communicate(timeout=WAIT_S)
    with RunFile.open(run) as seen:
        stored = seen.stops_done()
        assert 5 <= len(stored) < 120
        assert stored == set(range(len(stored)))
        for name in ("left", "right"):
            np.testing.assert_array_equal(seen.readings(name).configuration, np.arange(len(stored)))
    return process.returncode, err


def check_resumes(run: Path, collect: Callable[..., Ended]) -> None:
    ended = collect("collect", run.name, "--resume", "--json", "-")
    assert ended.code == 0, ended.err
    assert ended.json["stops"] == 120
    with RunFile.open(run) as seen:
        plan = seen.read_plan()
        for name in ("left", "right"):
            np.testing.assert_array_equal(seen.readings(name).configuration, np.arange(120))
            np.testing.assert_allclose(seen.readings(name).q, plan[name], atol=1e-12)
            assert np.all(np.diff(seen.readings(name).time_s) > 0.0)


def test_killed_in_the_middle_it_is_resumed(long_run: Path, call: Any) -> None:
    assert interrupted(long_run, signal.SIGKILL)[0] == -signal.SIGKILL
    check_resumes(long_run, call)


def test_requests_from_another_process_reach_the_job_and_its_log(long_run: Path, call: Any) -> None:
    with process_of("cellapp", "collect", long_run.name, cwd=long_run.parent) as process:
        assert "takes about" in within(sure(process.stderr).readline, "the time")
        wait_for_stops(long_run, process)
        paused = shell("job", "pause", long_run.name, cwd=long_run.parent)
        assert (paused.code, paused.out[:6]) == (0, "pause:"), paused.err
        assert "collect: paused" in within(sure(process.stderr).readline, "the pause")
        one_sentence(call("collect", long_run.name, "--resume"), "another job runs here")
        one_sentence(call("job", "pause", long_run.name), "paused already")
        step = "next: collect is paused: 'cellapp job resume planned' continues"
        assert any(step in call("show", long_run.name).out for _ in range(5)), "a job is slow on a busy computer"
        stopped = call("stop", long_run.name, "--json", "-")
        assert stopped.json["answer"].startswith("stopped: all arms brake")
        process.communicate(timeout=WAIT_S)
        assert process.returncode == 4
    one_sentence(call("stop", long_run.name), "no job runs in planned")
    with RunFile.open(long_run) as run:
        (session,) = run.sessions()
        assert session.requests[0].kind == "pause"
        assert session.outcome == "stopped"
    check_resumes(long_run, call)


@pytest.mark.parametrize(
    ("number", "cause"),
    [
        (signal.SIGINT, "a person stopped the arms"),
        (signal.SIGTERM, "the program was asked to end (SIGTERM)"),
        pytest.param(signal.SIGHUP, "the terminal was closed", marks=pytest.mark.slow),
    ],
    ids=["Ctrl-C", "SIGTERM", "closed terminal"],
)
def test_interrupted_it_exits_with_four_says_by_what(long_run: Path, number: int, cause: str) -> None:
    code, err = interrupted(long_run, number)
    assert code == 4, err
    assert "Traceback" not in err
    assert "'cellapp collect planned --resume'" in err
    assert not (long_run / "run.sqlite-wal").exists(), "the file is whole"
    with RunFile.open(long_run) as run:
        assert cause in run.sessions()[-1].requests[-1].reason


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_before_the_command_begins_it_exits_with_four(
    call: Any, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def interrupt(profile: object) -> None:
        signal.raise_signal(number)

    monkeypatch.setattr("cellapp.interfaces.cli.verb_commands.CommandJob", interrupt)
    before = signal.getsignal(number)
    one_sentence(call("plan", "twin.yaml", "--run", "new"), "stopped on request", code=4)
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(
    ("command", "begins"),
    [
        (["emulate", "twin.yaml", "--pace", "5"], "arm left: UR10 (CB3)"),
        (["tracker-bridge", "twin.yaml", "--port", "0"], "tracker (simulated) at 127.0.0.1 port "),
    ],
    ids=["emulate", "tracker-bridge"],
)
def test_what_serves_does_so_until_it_is_interrupted(tmp_path: Path, command: list[str], begins: str) -> None:
    write_profile(tmp_path)
    with process_of("cellapp", *command, cwd=tmp_path) as process:
        first = within(sure(process.stdout).readline, "the first line")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=WAIT_S)
    if process.returncode == 3 and "in use" in err:
        pytest.skip("another emulator listens here")
    assert process.returncode == 0, err
    assert first.startswith(begins)
    assert "Traceback" not in out + err
