"""Certificates of a run: they state what it holds, name what is missing, and show whatever was changed afterwards."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import subprocess
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from cellapp.cell.run import RunFile, write_readings_csv
from cellapp.commands.certificate.run import PAGE_FILE, SUMS_FILE
from cellapp.commands.certificate_result import CertificateResult
from cellapp.commands.run_results import read_results
from cellapp.commands.run_state import RunState
from cellapp.commands.stages import CERTIFICATE_FILE, append_stage, read_stages
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import CERTIFICATE, VERIFY
from cellapp.interfaces.page.page import certificate_page
from cellapp.robot.model import CellModel
from tests.sure import sure
from tests.twin import small_twin
from tests.verbs import certificate_run

NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)


@pytest.fixture(scope="module")
def certified(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the finished run with a certificate. No test may write to it."""
    folder = Path(shutil.copytree(finished_run, tmp_path_factory.mktemp("certified") / "run"))
    with RunFile.open(folder, write=True) as run:
        certificate_run(run, certificate_page, now=NOON)
    return folder


@pytest.fixture
def changeable(certified: Path, tmp_path: Path) -> Path:
    """A copy of the run with its certificate that a test may change."""
    return Path(shutil.copytree(certified, tmp_path / "run"))


def stored(folder: Path) -> CertificateResult:
    text = (folder / CERTIFICATE_FILE).read_text("utf-8")
    return CertificateResult.from_json(text, "certificate")


def changed_files(folder: Path) -> list[str]:
    """Files of the sums that are missing or have another content, as ``sha256sum -c`` says."""
    lines = [line.split("  ", 1) for line in (folder / SUMS_FILE).read_text("utf-8").splitlines()]
    found = [name for digest, name in lines if not (folder / name).is_file() or _sum(folder / name) != digest]
    if tool := shutil.which("sha256sum"):
        done = subprocess.run(
            [tool, "--strict", "-c", SUMS_FILE], cwd=folder, capture_output=True, text=True, timeout=20
        )
        assert (done.returncode == 0) == (not found), done.stdout + done.stderr
        assert [line.split(": FAILED")[0] for line in done.stdout.splitlines() if "FAILED" in line] == found
    return found


def _sum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def empty_run(folder: Path, profile: Profile) -> RunFile:
    return RunFile.create(folder, profile)


def test_a_certificate_states_what_the_run_holds(certified: Path) -> None:
    found = stored(certified)
    with RunFile.open(certified) as run:
        results = read_results(run)
    for name, verified in sure(results.verify).arms.items():
        errors = found.arms[name].errors
        assert (errors.found, errors.left) == (verified.nominal_mm, verified.compensated_mm)
        assert found.arms[name].controller_serial == f"SIM-{name}"
    assert {one.where for one in found.contributions} == {"left", "right"}
    assert found.issued == "2026-01-02T12:00:00+00:00"
    assert found.number.startswith("twin-20260102-")
    assert results.certificate == found
    assert CERTIFICATE not in results.out_of_date


def test_the_sums_are_of_the_certificate_and_of_all_that_it_rests_on(certified: Path, tmp_path: Path) -> None:
    listed = [line.split("  ", 1)[1] for line in (certified / SUMS_FILE).read_text("utf-8").splitlines()]
    data = [f"certified/{name}" for name in ("model.json", "profile.json", "readings.csv", "verify.json")]
    assert listed == [CERTIFICATE_FILE, PAGE_FILE, *data]
    assert changed_files(certified) == []
    found = stored(certified)
    assert found.rests_on == {name: _sum(certified / name) for name in data}
    page = (certified / PAGE_FILE).read_text("utf-8")
    assert all(name in page and digest in page for name, digest in found.rests_on.items())
    with RunFile.open(certified) as run:
        assert RunState(run).complaints == []
        stages, profile = read_stages(run), run.profile_text
        write_readings_csv(run, tmp_path / "readings.csv")
    assert (certified / "certified/profile.json").read_text("utf-8") == profile
    assert (certified / "certified/verify.json").read_text("utf-8") == stages.current[VERIFY].text
    assert CellModel.load(certified / "certified/model.json").provenance["stage"] == "discover"
    assert (certified / "certified/readings.csv").read_bytes() == (tmp_path / "readings.csv").read_bytes()


@pytest.mark.parametrize("name", [CERTIFICATE_FILE, PAGE_FILE, "certified/readings.csv", "certified/verify.json"])
def test_a_changed_file_and_a_missing_one_are_found(changeable: Path, name: str) -> None:
    path = changeable / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert changed_files(changeable) == [name]
    path.unlink()
    assert changed_files(changeable) == [name]


def test_a_changed_certificate_is_not_that_of_the_run(changeable: Path) -> None:
    path = changeable / CERTIFICATE_FILE
    path.write_text(path.read_text("utf-8").replace('"max": 0.', '"max": 0.0', 1), "utf-8")
    with RunFile.open(changeable) as run:
        assert RunState(run).complaints == [f"{CERTIFICATE_FILE} is not a certificate that the run stores"]


def test_a_verification_since_is_found(changeable: Path) -> None:
    with RunFile.open(changeable, write=True) as run:
        verify = sure(read_results(run).verify)
        again = verify.model_copy(update={"stopped": "by hand"})
        append_stage(run, VERIFY, again, read_stages(run).current[VERIFY].basis)
        assert read_stages(run).out_of_date[CERTIFICATE] == "targets were verified since"
        assert "'certificate' is out of date (targets were verified since)" in RunState(run).complaints
    assert changed_files(changeable) == []


def edit_stored(folder: Path, name: str, old: str, new: str) -> None:
    """Edit the stored result of the newest stage of a name, as somebody with a database editor would."""
    with closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        found = "SELECT number, text FROM stage WHERE name = ? ORDER BY number DESC LIMIT 1"
        row, text = database.execute(found, (name,)).fetchone()
        assert old in text
        database.execute("UPDATE stage SET text = ? WHERE number = ?", (text.replace(old, new, 1), row))


def test_a_changed_verification_is_called_changed(changeable: Path) -> None:
    edit_stored(changeable, VERIFY, '"stopped":""', '"stopped":"by hand"')
    with RunFile.open(changeable) as run:
        assert read_stages(run).out_of_date[CERTIFICATE] == "the stored verification was changed"


def test_a_certificate_names_who_how_and_where(finished_copy: Path, tmp_path: Path) -> None:
    data = tmp_path / "data.yaml"
    data.write_text(
        "traceability:\n  client: Client Ltd, Town\n  procedure: WI-17 rev. 3\n  air_pressure: 1005.5\n"
        "  relative_humidity: [40, 45]\n"
    )
    with RunFile.open(finished_copy, write=True) as run:
        made = certificate_run(run, certificate_page, data=data)
        verify = read_results(run).verify
    assert [(one.name, one.wanted_M) for one in made.targets] == [
        (one.name, None if one.wanted_M is None else tuple(one.wanted_M)) for one in sure(verify).targets
    ]
    page = (finished_copy / PAGE_FILE).read_text("utf-8")
    for words in ("Client Ltd, Town", "WI-17 rev. 3", "1005.5 hPa", "40 to 45 %", "copied as a whole", "Method:"):
        assert words in page, words
    assert not {"client", "procedure", "air pressure", "relative humidity"} & set(made.missing)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("[1010, 1000]", "the smaller value first"),
        ("1", "at least 300"),
        ("high", "expected a number"),
        ("true", "expected a number"),
    ],
)
def test_a_wrong_pressure_is_told(finished_copy: Path, tmp_path: Path, value: str, words: str) -> None:
    data = tmp_path / "data.yaml"
    data.write_text(f"traceability:\n  air_pressure: {value}\n")
    with RunFile.open(finished_copy, write=True) as run, pytest.raises(InputError, match=words):
        certificate_run(run, certificate_page, data=data)


def test_changed_readings_put_the_certificate_out_of_date(changeable: Path) -> None:
    with RunFile.open(changeable, write=True) as run:
        words = list(run.readings("left").split or ())
        run.assign_splits("left", words[::-1])
        assert "the readings or their splits were changed since" in read_stages(run).out_of_date[CERTIFICATE]


@pytest.mark.parametrize("suffix", [".minisig", ".asc"])
def test_a_signed_certificate_is_never_replaced(changeable: Path, tmp_path: Path, suffix: str) -> None:
    (changeable / f"{SUMS_FILE}{suffix}").write_text("signature")
    before = {path: path.read_bytes() for path in changeable.rglob("*") if path.is_file() and "sqlite" not in path.name}
    with RunFile.open(changeable, write=True) as run:
        count = len(run.stage_rows())
        with pytest.raises(InputError, match=rf"is signed \({SUMS_FILE}{suffix} stands beside it\).*never replaced"):
            certificate_run(run, certificate_page)
        assert len(run.stage_rows()) == count
        certificate_run(run, certificate_page, out=tmp_path / "elsewhere", number="QA 2026/17")
        assert RunState(run).complaints == []
        verify = sure(read_results(run).verify)
        again = verify.model_copy(update={"stopped": "by hand"})
        append_stage(run, VERIFY, again, read_stages(run).current[VERIFY].basis)
        certificate_run(run, certificate_page, out=tmp_path / "again")
        assert RunState(run).complaints == [f"{CERTIFICATE_FILE} is an earlier certificate, of other data"]
    assert {path: path.read_bytes() for path in before} == before
    assert stored(tmp_path / "elsewhere").number == "QA 2026/17"
    assert changed_files(tmp_path / "elsewhere") == []


def test_an_unsigned_certificate_in_the_folder_of_the_run_is_renewed_and_one_elsewhere_is_not(
    changeable: Path, tmp_path: Path
) -> None:
    with RunFile.open(changeable, write=True) as run:
        certificate_run(run, certificate_page, number="2")
        certificate_run(run, certificate_page, out=tmp_path / "out")
        with pytest.raises(InputError, match="exists already"):
            certificate_run(run, certificate_page, out=tmp_path / "out")
    assert stored(changeable).number == "2"
    assert changed_files(changeable) == changed_files(tmp_path / "out") == []


def test_no_number_is_made_twice(changeable: Path, tmp_path: Path) -> None:
    first = stored(changeable).number
    with RunFile.open(changeable, write=True) as run:
        numbers = [certificate_run(run, certificate_page, out=tmp_path / str(one), now=NOON).number for one in range(2)]
    assert numbers == [f"{first}-2", f"{first}-3"]


def test_a_file_completes_the_profile_and_its_errors_have_lines(finished_copy: Path, tmp_path: Path) -> None:
    data = tmp_path / "data.yaml"
    data.write_text(
        'traceability:\n  location: Hall 3\n  smr: {left: {serial: "L1", calibrated: 2026-01-01, due: 2027-01-01}}\n'
        'tolerances: {position: "1 um", decision: simple}\n'
    )
    with RunFile.open(finished_copy, write=True) as run:
        found = certificate_run(run, certificate_page, data=data)
        assert found.location == "Hall 3"
        assert not any("arm left" in one or "location" in one for one in found.missing)
        assert found.operator == run.profile.traceability.operator
        judged = {(one.characteristic, one.where): one.conformity for one in found.judgements}
        assert judged["position", "left"] == "does not conform"
        assert found.rests_on["certified/completed.yaml"] == _sum(data)
        count = len(run.stage_rows())
        for text, words in (
            ("traceability:\n  tracker: {serial: 7}\n", "data.yaml:2: traceability.tracker.serial: expected a text"),
            ("arms: {}\n", "unknown section"),
            ("tolerances: {position: 2.0}\n", "tolerances.position: expected at most"),
        ):
            data.write_text(text)
            with pytest.raises(InputError, match=words):
                certificate_run(run, certificate_page, data=data)
        assert len(run.stage_rows()) == count


def test_a_run_in_which_nothing_was_measured_gets_no_certificate(tmp_path: Path) -> None:
    with empty_run(tmp_path / "run", small_twin()) as run, pytest.raises(InputError, match="nothing here was measured"):
        certificate_run(run, certificate_page)
    assert not (tmp_path / "run" / CERTIFICATE_FILE).exists()


def test_a_run_that_is_open_for_reading_is_left_as_it_is(finished_copy: Path) -> None:
    with RunFile.open(finished_copy) as run, pytest.raises(InputError, match="reading only"):
        certificate_run(run, certificate_page)
    assert not (finished_copy / CERTIFICATE_FILE).exists()
