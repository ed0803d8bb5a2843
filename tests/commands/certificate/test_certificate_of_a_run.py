"""Certificates of a run: they state what it holds, name what is missing, and show whatever was changed afterwards."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, date, datetime
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from cellapp.cell.run import RunFile
from cellapp.commands.basis import basis_of
from cellapp.commands.certificate.result import CertificateResult
from cellapp.commands.certificate.run import PAGE_FILE, PRINT_FILE, SIGNATURE_FILE, certificate_run
from cellapp.commands.check_certificate.run import check_certificate
from cellapp.commands.out_of_date import CERTIFICATE_FILE, complaints_of
from cellapp.commands.report.result import read_results
from cellapp.commands.sign_key.minisign import PublicKey
from cellapp.commands.stages import append_stage, read_stages
from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.profile.acceptance import Instrument, Tolerances, Traceability
from cellapp.ground.results import CERTIFICATE, VERIFY
from cellapp.interfaces.page.certificate_page import certificate_page
from tests.twin import small_twin

NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)
KEY, OTHER = (Ed25519PrivateKey.from_private_bytes(bytes([number]) * 32) for number in (1, 2))
PUBLIC = PublicKey.of(KEY)


@pytest.fixture(scope="module")
def certified(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the finished run with a signed certificate. No test may write to it."""
    folder = Path(shutil.copytree(finished_run, tmp_path_factory.mktemp("certified") / "run"))
    with RunFile.open(folder, write=True) as run:
        certificate_run(run, certificate_page, key=KEY, now=NOON)
    return folder


@pytest.fixture
def changeable(certified: Path, tmp_path: Path) -> Path:
    """A copy of the run with its certificate that a test may change."""
    return Path(shutil.copytree(certified, tmp_path / "run"))


def stored(folder: Path) -> CertificateResult:
    text = (folder / CERTIFICATE_FILE).read_text("utf-8")
    return CertificateResult.from_json(text, "certificate")


def problems(folder: Path, *, against: Path | None = None) -> tuple[str, ...]:
    """What the check finds with the signer's key and the run."""
    with RunFile.open(against or folder) as run:
        return check_certificate(folder / CERTIFICATE_FILE, PUBLIC, run).problems


def empty_run(folder: Path, profile: Profile) -> RunFile:
    return RunFile.create(folder, profile)


def test_a_certificate_states_what_the_run_holds(certified: Path) -> None:
    found = stored(certified)
    with RunFile.open(certified) as run:
        results, stages, basis = read_results(run), read_stages(run), basis_of(run)
    assert results.verify is not None
    assert found.data is not None
    assert found.data.profile == basis.profile
    assert found.data.readings == {name: one.sha256 for name, one in basis.readings.items()}
    assert found.data.stages == {
        "discover": stages.current["discover"].digest,
        "verify": stages.current["verify"].digest,
        "iso9283": "",
    }
    for name, verified in results.verify.arms.items():
        errors = found.arms[name].errors
        assert (errors.found, errors.left) == (verified.nominal_mm, verified.compensated_mm)
        assert found.arms[name].controller_serial == f"SIM-{name}"
    assert {one.where for one in found.contributions} == {"left", "right"}
    assert found.issued == "2026-01-02T12:00:00+00:00"
    assert found.number.startswith("twin-20260102-")
    assert results.certificate == found
    assert CERTIFICATE not in results.out_of_date


def test_what_is_not_given_is_named_and_a_simulation_is_marked(certified: Path) -> None:
    found = stored(certified)
    assert found.warnings[0].startswith("simulated cell")
    assert "arm right: not verified" in found.warnings
    assert "location" in found.missing
    assert "SMR of arm left: serial number, date of calibration, date when its calibration is due" in found.missing
    page = (certified / PAGE_FILE).read_text("utf-8")
    assert "Simulated cell" in page
    assert "not given" in page


def test_a_signed_certificate_of_an_unchanged_run_holds(certified: Path) -> None:
    with RunFile.open(certified) as run:
        found = check_certificate(certified / CERTIFICATE_FILE, PUBLIC, run)
        assert complaints_of(run) == []
    assert (found.signature, found.problems, found.key_id) == ("valid", (), PUBLIC.id_text)
    assert found.comment == f"timestamp:{int(NOON.timestamp())}\tfile:certificate.json\tnumber:{found.number}"


@pytest.mark.parametrize(
    ("old", "new"), [('"max": 0.', '"max": 0.0'), ('"number"', '"nummer"'), ("}", "")], ids=["figure", "key", "end"]
)
def test_a_tampered_certificate_is_found_with_and_without_its_signature(changeable: Path, old: str, new: str) -> None:
    path = changeable / CERTIFICATE_FILE
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    found = check_certificate(path, PUBLIC)
    assert found.signature == "wrong"
    assert "was changed" in found.problems[0]
    (changeable / SIGNATURE_FILE).unlink()
    assert check_certificate(path, PUBLIC).signature == "missing"
    assert len(problems(changeable)) == 2
    with RunFile.open(changeable) as run:
        assert complaints_of(run) == [f"{CERTIFICATE_FILE} is not a certificate that the run stores"]


@pytest.mark.parametrize(
    ("old", "new", "state"),
    [
        ("\tnumber:", "\tnumber:1", "wrong"),
        ("\ntrusted comment: ", "\ncomment: ", "wrong"),
        ("untrusted comment: signature", "untrusted comment: anything", "valid"),
    ],
    ids=["signed comment", "form", "free comment"],
)
def test_a_tampered_signature(changeable: Path, old: str, new: str, state: str) -> None:
    path = changeable / SIGNATURE_FILE
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new), "utf-8")
    assert check_certificate(changeable / CERTIFICATE_FILE, PUBLIC).signature == state


def test_another_key_and_no_key_are_no_confirmation(certified: Path) -> None:
    other = check_certificate(certified / CERTIFICATE_FILE, PublicKey.of(OTHER))
    assert other.signature == "other key"
    assert PUBLIC.id_text in other.problems[0]
    unchecked = check_certificate(certified / CERTIFICATE_FILE)
    assert unchecked.signature == "not checked"
    assert unchecked.problems


def test_a_signature_with_a_copied_key_id_is_wrong(certified: Path) -> None:
    disguised = PublicKey(PUBLIC.key_id, PublicKey.of(OTHER).key)
    assert check_certificate(certified / CERTIFICATE_FILE, disguised).signature == "wrong"


def test_a_verification_since_is_found(changeable: Path) -> None:
    with RunFile.open(changeable, write=True) as run:
        verify = read_results(run).verify
        assert verify is not None
        again = verify.model_copy(update={"stopped": "by hand"})
        append_stage(run, VERIFY, again, read_stages(run).current[VERIFY].basis)
        assert read_stages(run).out_of_date[CERTIFICATE] == "targets were verified since"
        assert "'certificate' is out of date (targets were verified since)" in complaints_of(run)
    assert problems(changeable) == ("targets were verified since",)


def edit_stored(folder: Path, name: str, old: str, new: str) -> None:
    """Edit the stored result of the newest stage of a name, as somebody with a database editor would."""
    with closing(sqlite3.connect(folder / "run.sqlite")) as database, database:
        found = "SELECT number, text FROM stage WHERE name = ? ORDER BY number DESC LIMIT 1"
        row, text = database.execute(found, (name,)).fetchone()
        assert old in text
        database.execute("UPDATE stage SET text = ? WHERE number = ?", (text.replace(old, new, 1), row))


def test_a_changed_verification_is_called_changed(changeable: Path) -> None:
    edit_stored(changeable, VERIFY, '"stopped":""', '"stopped":"by hand"')
    assert problems(changeable) == ("the stored verification was changed",)


@pytest.mark.parametrize("kept", [True, False], ids=["signed", "without its signature"])
def test_an_edited_page_is_found(changeable: Path, kept: bool) -> None:
    page = changeable / PAGE_FILE
    text = page.read_text("utf-8")
    assert "simulated cell" in text.lower()
    page.write_text(text.replace("Simulated cell", "Real cell"), "utf-8")
    if not kept:
        (changeable / SIGNATURE_FILE).unlink()
    words = f"{PAGE_FILE} was changed: it is not the file that was certified"
    found = check_certificate(changeable / CERTIFICATE_FILE, PUBLIC)
    assert found.documents == {PAGE_FILE: "changed"}
    assert words in found.problems
    assert words in problems(changeable)
    assert check_certificate(page, PUBLIC).problems == found.problems


def test_a_page_is_checked_by_its_own_path_and_may_be_elsewhere(changeable: Path) -> None:
    with RunFile.open(changeable) as run:
        found = check_certificate(changeable / PAGE_FILE, PUBLIC, run)
    assert (found.problems, found.documents) == ((), {PAGE_FILE: "as certified"})
    (changeable / PAGE_FILE).rename(changeable / "page.html")
    moved = check_certificate(changeable / CERTIFICATE_FILE, PUBLIC)
    assert (moved.problems, moved.documents) == ((), {PAGE_FILE: "not here"})
    (strange,) = check_certificate(changeable / "page.html", PUBLIC).problems
    assert strange.startswith("page.html is not covered")


def test_a_print_that_nobody_certified_is_named(changeable: Path) -> None:
    (changeable / PRINT_FILE).write_bytes(b"%PDF-1.7 it conforms")
    (problem,) = problems(changeable)
    assert problem.startswith(f"{PRINT_FILE} is not covered by the certificate")


def test_the_print_is_certified_with_the_page(
    finished_copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    browser = tmp_path / "chromium"
    browser.write_text(
        '#!/bin/sh\nfor one in "$@"; do case $one in --print-to-pdf=*) echo \'%PDF\' > "${one#*=}";; esac; done\n'
    )
    browser.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with RunFile.open(finished_copy, write=True) as run:
        made = certificate_run(run, certificate_page, key=KEY, pdf=True)
    assert set(made.documents) == {PAGE_FILE, PRINT_FILE}
    assert PRINT_FILE in made.files
    (finished_copy / PRINT_FILE).write_bytes(b"%PDF-1.7 it conforms")
    assert check_certificate(finished_copy / PRINT_FILE, PUBLIC).documents[PRINT_FILE] == "changed"


def test_a_certificate_names_who_how_and_where(finished_copy: Path, tmp_path: Path) -> None:
    data = tmp_path / "data.yaml"
    data.write_text(
        "traceability:\n  client: Client Ltd, Town\n  procedure: WI-17 rev. 3\n  air_pressure: 1005.5\n"
        "  relative_humidity: [40, 45]\n"
    )
    with RunFile.open(finished_copy, write=True) as run:
        made = certificate_run(run, certificate_page, data=data)
        verify = read_results(run).verify
    assert verify is not None
    assert [(one.name, one.wanted_M) for one in made.targets] == [
        (one.name, None if one.wanted_M is None else tuple(one.wanted_M)) for one in verify.targets
    ]
    page = (finished_copy / PAGE_FILE).read_text("utf-8")
    for words in ("Client Ltd, Town", "WI-17 rev. 3", "1005.5 hPa", "40 to 45 %", "copied as a whole", "Method:"):
        assert words in page, words
    assert not {"client", "procedure", "air pressure", "relative humidity"} & set(made.missing)


def test_nothing_is_said_to_be_complete_that_is_not(certified: Path) -> None:
    found = stored(certified)
    assert {"client", "procedure", "air pressure", "relative humidity"} <= set(found.missing)
    assert "Every entry" not in (certified / PAGE_FILE).read_text("utf-8")


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


def test_changed_readings_are_found(changeable: Path) -> None:
    with RunFile.open(changeable, write=True) as run:
        words = list(run.readings("left").split or ())
        run.assign_splits("left", words[::-1])
    assert "the readings of arm left were changed or added since" in problems(changeable)


def test_another_run_is_named(certified: Path, tmp_path: Path) -> None:
    empty_run(tmp_path / "other", small_twin(7)).close()
    (problem,) = problems(certified, against=tmp_path / "other")
    assert "is another run" in problem


def test_a_signed_certificate_is_never_replaced(changeable: Path, tmp_path: Path) -> None:
    before = (changeable / CERTIFICATE_FILE).read_bytes()
    with RunFile.open(changeable, write=True) as run:
        with pytest.raises(InputError, match="never replaced"):
            certificate_run(run, certificate_page)
        certificate_run(run, certificate_page, out=tmp_path / "elsewhere", number="QA 2026/17")
        assert complaints_of(run) == []
        verify = read_results(run).verify
        assert verify is not None
        again = verify.model_copy(update={"stopped": "by hand"})
        append_stage(run, VERIFY, again, read_stages(run).current[VERIFY].basis)
        certificate_run(run, certificate_page, out=tmp_path / "again")
        assert complaints_of(run) == [f"{CERTIFICATE_FILE} is an earlier certificate, of other data"]
    assert (changeable / CERTIFICATE_FILE).read_bytes() == before
    assert stored(tmp_path / "elsewhere").number == "QA 2026/17"
    assert not (tmp_path / "elsewhere" / SIGNATURE_FILE).exists()


def test_no_number_is_given_twice(changeable: Path, tmp_path: Path) -> None:
    signed = stored(changeable).number
    with RunFile.open(changeable, write=True) as run:
        numbers = [certificate_run(run, certificate_page, out=tmp_path / str(one), now=NOON).number for one in range(2)]
        with pytest.raises(InputError, match="give another number"):
            certificate_run(run, certificate_page, out=tmp_path / "again", number=signed)
    assert numbers == [f"{signed}-2", f"{signed}-3"]


@pytest.mark.parametrize("number", ["", " 1", "a\nb", "<b>", "n" * 61, "a\tb"])
def test_numbers_that_do_not_fit_a_comment_are_refused(finished_copy: Path, number: str) -> None:
    with RunFile.open(finished_copy, write=True) as run, pytest.raises(InputError, match="--number"):
        certificate_run(run, certificate_page, number=number)
    assert not (finished_copy / CERTIFICATE_FILE).exists()


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
        assert found.data is not None
        assert found.data.data_file is not None
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


def test_a_run_that_was_only_planned_gets_a_certificate_that_says_so(tmp_path: Path) -> None:
    overdue = Traceability(tracker=Instrument(serial="7", due=date(2020, 1, 1)))
    profile = small_twin().model_copy(update={"traceability": overdue, "tolerances": Tolerances(position=1e-4)})
    with empty_run(tmp_path / "run", profile) as run:
        found = certificate_run(run, certificate_page)
    assert any(one.startswith("not verified") for one in found.warnings)
    assert {one.conformity for one in found.judgements} == {"cannot say"}
    assert {"organisation", "operator", "time of measuring"} <= set(found.missing)
    assert "laser tracker: model, date of calibration, calibration certificate" in found.missing
    assert found.arms["left"].expanded_mm is None
    assert found.complaints()


def test_a_run_that_is_open_for_reading_is_left_as_it_is(finished_copy: Path) -> None:
    with RunFile.open(finished_copy) as run, pytest.raises(InputError, match="reading only"):
        certificate_run(run, certificate_page)
    assert not (finished_copy / CERTIFICATE_FILE).exists()


def test_files_that_are_no_certificates(tmp_path: Path) -> None:
    path = tmp_path / CERTIFICATE_FILE
    with pytest.raises(InputError, match="cannot be read"):
        check_certificate(path)
    for content in (b"", b"\xff", json.dumps({"schema": "cellapp-verify"}).encode()):
        path.write_bytes(content)
        assert "it is no certificate that this cellapp can read" in check_certificate(path).problems
