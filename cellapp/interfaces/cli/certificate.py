"""``certificate``, ``sign-key``, ``check-certificate``: state what a run proves, sign it, verify that."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cellapp.commands.record import Writes
from cellapp.ground.errors import InputError
from cellapp.interfaces.cli.job import Job, open_run, require_none
from cellapp.interfaces.cli.options import JsonOption, RunFolder

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PASSPHRASE_VARIABLE = "CELLAPP_KEY_PASSPHRASE"
"""Environment variable with the passphrase of the signing key, where nobody can be asked."""


def certificate(
    folder: RunFolder,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FOLDER", help="Folder of the files; DIR if not given."),
        Writes.FOLDER,
    ] = None,
    number: Annotated[
        str | None, typer.Option("--number", metavar="N", help="Number of the certificate; else a new one.")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="FILE", help="YAML with sections tolerances, traceability; before the profile."),
    ] = None,
    key: Annotated[
        Path | None, typer.Option("--key", metavar="KEYFILE", help="Sign with this private key (see sign-key).")
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print it to certificate.pdf, too, through an installed Chromium.")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit code 1 unless all is verified, holds and conforms.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Write certificate.json and certificate.html: errors as found and left, budget, tolerances, hashes, what lacks."""
    from cellapp.commands.certificate.run import certificate_run
    from cellapp.commands.certificate.view import certificate_sentences, certificate_tables
    from cellapp.interfaces.page.certificate_page import certificate_page

    private = None if key is None else _private_key(key)
    with Job(json_file) as job, open_run(folder, write=True) as opened:
        result = certificate_run(
            opened, certificate_page, out=out, number=number, data=data, key=private, pdf=pdf, outputs=job.outputs
        )
        job.show(certificate_tables(result))
        job.say(*certificate_sentences(result), f"written: {out or folder}")
        job.result(result)
        if strict:
            require_none(result.complaints(), "certificate")


def sign_key(
    path: Annotated[Path, typer.Argument(metavar="NEW.key", help="File of the new private key; it must not exist.")],
    json_file: JsonOption = None,
) -> None:
    """Make a key pair for certificates: NEW.key for who signs, NEW.pub for who checks. Asks for a passphrase."""
    from cellapp.commands.certificate.sign_key import new_sign_key
    from cellapp.commands.certificate.view import sign_key_sentences

    with Job(json_file) as job:
        result = new_sign_key(path, _new_passphrase())
        job.say(*sign_key_sentences(result))
        job.result(result)


def check_certificate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A certificate.json, or its page or PDF beside it.")],
    public_key: Annotated[
        str | None, typer.Option("--public-key", metavar="PUB", help="The signer's public key: its file or its line.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("--run", metavar="DIR", help="Compare with the data of this run as they are now.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Verify signature and page of a certificate, with --run its data; exit code 1 if anything does not hold."""
    from cellapp.commands.certificate.run import check_certificate as check
    from cellapp.commands.certificate.sign_key import load_public_key
    from cellapp.commands.certificate.view import check_sentences

    public = None if public_key is None else load_public_key(public_key)
    with Job(json_file) as job, nullcontext() if folder is None else open_run(folder) as opened:
        result = check(file, public, opened)
        job.say(*check_sentences(result))
        job.result(result)
        require_none(result.problems, f"check-certificate: {file} does not hold")


def _private_key(path: Path) -> Ed25519PrivateKey:
    from cellapp.commands.certificate.sign_key import is_encrypted, load_sign_key

    if not is_encrypted(path):
        return load_sign_key(path)
    passphrase = os.environ.get(PASSPHRASE_VARIABLE)
    if passphrase is None and not sys.stdin.isatty():
        raise InputError(f"{path}: the key is encrypted; set {PASSPHRASE_VARIABLE}, or run this in a terminal")
    if passphrase is None:
        passphrase = typer.prompt(f"Passphrase of {path}", hide_input=True, err=True)
    return load_sign_key(path, passphrase)


def _new_passphrase() -> str:
    """Empty for none: asked for twice in a terminal, else from the environment."""
    given = os.environ.get(PASSPHRASE_VARIABLE)
    if given is not None or not sys.stdin.isatty():
        return given or ""
    asked: str = typer.prompt(
        "Passphrase (empty for none)",
        default="",
        show_default=False,
        hide_input=True,
        err=True,
        confirmation_prompt=True,
    )
    return asked
