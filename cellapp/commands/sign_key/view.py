"""The result of ``sign-key`` as sentences."""

from __future__ import annotations

from cellapp.commands.record import Request, View
from cellapp.commands.sign_key.result import SignKeyResult


def view(result: SignKeyResult, request: Request | None = None) -> View:
    """Show where the keys are, and what to do with each."""
    protected = "encrypted with your passphrase" if result.encrypted else "NOT encrypted: whoever reads it can sign"
    return View(
        [
            f"private key: {result.private_file}, {protected}; keep it to yourself and keep a copy in a safe place",
            f"public key: {result.public_file}; give it to whoever checks certificates",
            f"key {result.key_id}: {result.public_key}",
        ]
    )
