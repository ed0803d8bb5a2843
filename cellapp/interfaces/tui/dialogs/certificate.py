"""Ask what a certificate is written with, which certificate is checked, and where a new key goes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from textual.app import ComposeResult
from textual.widgets import Checkbox, Input

from cellapp.interfaces.tui.dialogs.file_picker import PathField
from cellapp.interfaces.tui.dialogs.question import A, Answer, AnswerQuestion
from cellapp.interfaces.tui.widgets.labelled import Labelled, text_field


@dataclass(frozen=True)
class CertificateRequest:
    """What ``certificate`` is asked for; see ``certificate_run``. Without a key it is not signed.

    ``key`` is the file of a private key, ``passphrase`` the one of that file; it is in no text made of this object.
    """

    number: str | None
    data: Path | None
    out: Path | None
    key: Path | None
    passphrase: str = field(repr=False)
    pdf: bool = False


@dataclass(frozen=True)
class CheckFileRequest:
    """What ``check-certificate`` is asked for; ``key`` is the file of a public key or its line, ``run`` a folder."""

    certificate: Path
    key: str | None
    run: Path | None


@dataclass(frozen=True)
class SignKeyRequest:
    """What ``sign-key`` is asked for; an empty passphrase leaves the private key readable."""

    path: Path
    passphrase: str = field(repr=False)


class _FilesQuestion(AnswerQuestion[A]):
    """A question with fields for files, which has the focus first; an answer sends them off, ``no`` closes."""

    AUTO_FOCUS = "Input"

    def __init__(self, title: str, text: str, send: str) -> None:
        answers = (Answer("send", send, send[0].lower(), "success"), Answer("no", "Not now", "n"))
        super().__init__(title, f"{text} Nothing moves.", answers)

    def action_answer(self, value: str) -> None:
        """Send the fields off, or close."""
        if value == "no":
            self.dismiss(None)
        else:
            self.send()

    def send(self) -> None:
        """Close with the request, if the fields are complete."""
        raise NotImplementedError

    def path(self, name: str) -> Path | None:
        """The path that a field holds; None where it is empty."""
        text = self.typed(name)
        return Path(text).expanduser() if text else None

    def refuse(self, name: str, sentence: str) -> None:
        """Say what is wrong with a field, and go to it."""
        self.explain(sentence)
        self.query_one(f"#{name}").focus()


class WriteCertificate(_FilesQuestion[CertificateRequest]):
    """Returns the request; None where the dialog is closed.

    Parameters
    ----------
    text : str
        What a person must know: what is out of date, what is not judged.
    key : str
        Key file that is proposed.
    """

    def __init__(self, text: str, key: str) -> None:
        super().__init__("Write the certificate", text, "Write")
        self._key = key

    def fields(self) -> ComposeResult:
        """Number, data that complete the profile, folder, key, passphrase."""
        yield text_field("number", "number", hint="empty: of profile, day and data")
        yield Labelled(
            "data file", PathField("", _is_yaml, id="data", hint="YAML, tolerances and traceability; may be empty")
        )
        yield Labelled("into folder", PathField("", _is_any, id="out", hint="empty: that of the run"))
        yield Labelled("private key", PathField(self._key, _is_any, id="key", hint="empty: not signed"))
        yield text_field("passphrase", "passphrase", hint="of the key; it is not kept", hidden=True)
        yield Checkbox("print to certificate.pdf, too (needs Chromium)", id="pdf", compact=True)

    def send(self) -> None:
        """Close with the request; the verb judges it."""
        passphrase = self.query_one("#passphrase", Input).value
        request = CertificateRequest(
            number=self.typed("number") or None,
            data=self.path("data"),
            out=self.path("out"),
            key=self.path("key"),
            passphrase=passphrase,
            pdf=self.query_one("#pdf", Checkbox).value,
        )
        self.dismiss(request)


class CheckCertificate(_FilesQuestion[CheckFileRequest]):
    """Returns the request; None where the dialog is closed.

    Parameters
    ----------
    proposed : str
        File of a certificate, empty for none.
    run : Path or None
        The run that is open.
    """

    def __init__(self, proposed: str, run: Path | None) -> None:
        text = "Is the signature valid, and are the data those that were signed?"
        super().__init__("Check a certificate", text, "Check")
        self._proposed, self._run = proposed, run

    def fields(self) -> ComposeResult:
        """Certificate, public key, and whether a run is compared."""
        yield Labelled(
            "certificate", PathField(self._proposed, _is_certificate, id="certificate", hint="JSON, or its page or PDF")
        )
        yield Labelled("public key", PathField("", _is_any, id="key", hint="its file or its line; empty: not checked"))
        if self._run is not None:
            yield Checkbox(f"compare with the run {self._run}", True, id="compare", compact=True)

    def send(self) -> None:
        """Close with the request, if there is a file."""
        certificate = self.path("certificate")
        if certificate is None:
            self.refuse("certificate", "Type the file of a certificate.")
            return
        compares = self._run is not None and self.query_one("#compare", Checkbox).value
        self.dismiss(CheckFileRequest(certificate, self.typed("key") or None, self._run if compares else None))


class NewSignKey(_FilesQuestion[SignKeyRequest]):
    """Returns the request; None where the dialog is closed."""

    def __init__(self) -> None:
        text = "Keep the private key safe; give the public one (.pub) to those who check certificates."
        super().__init__("Make a key for signing", text, "Make")

    def fields(self) -> ComposeResult:
        """Where it goes, and the passphrase, twice."""
        yield Labelled("private key", PathField("", _is_any, id="key", hint="a new file, as ~/cell-key.pem"))
        yield text_field("passphrase", "passphrase", hint="empty: the file alone signs", hidden=True)
        yield text_field("once more", "again", hidden=True)

    def send(self) -> None:
        """Close with the request, if there is a file and the passphrase was typed alike."""
        path = self.path("key")
        first, second = (self.query_one(f"#{name}", Input).value for name in ("passphrase", "again"))
        if path is None:
            self.refuse("key", "Type a file for the private key.")
        elif first != second:
            self.refuse("again", "The passphrases differ: type the same one twice.")
        else:
            self.dismiss(SignKeyRequest(path, first))


def _is_yaml(path: Path) -> bool:
    return path.suffix in (".yaml", ".yml")


def _is_certificate(path: Path) -> bool:
    return path.suffix in (".json", ".html", ".pdf")


def _is_any(path: Path) -> bool:
    return True
