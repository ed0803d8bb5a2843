"""Keys for certificates: made once, read by their owner alone, never overwritten."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from cellapp.commands.sign_key.keys import is_encrypted, load_public_key, load_sign_key
from cellapp.commands.sign_key.minisign import PublicKey
from cellapp.commands.sign_key.run import new_sign_key
from cellapp.ground.errors import InputError

pytestmark = pytest.mark.fast

PASSPHRASE = "naïve 鍵"


@pytest.mark.parametrize("passphrase", ["", PASSPHRASE], ids=["plain", "encrypted"])
def test_keys_round_trip(tmp_path: Path, passphrase: str) -> None:
    path = tmp_path / "lab.key"
    made = new_sign_key(path, passphrase)
    public = PublicKey.of(load_sign_key(path, passphrase))
    assert load_public_key(made.public_file) == public == load_public_key(made.public_key)
    assert made.key_id == public.id_text
    assert made.encrypted == is_encrypted(path) == bool(passphrase)
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.read_bytes().startswith(b"-----BEGIN ")
    assert PASSPHRASE not in made.to_json()


def test_a_wrong_or_missing_passphrase_is_refused_without_repeating_it(tmp_path: Path) -> None:
    path = tmp_path / "lab.key"
    new_sign_key(path, PASSPHRASE)
    with pytest.raises(InputError, match="wrong passphrase") as refused:
        load_sign_key(path, "secret guess")
    assert "secret guess" not in str(refused.value)
    with pytest.raises(InputError, match="its passphrase is needed"):
        load_sign_key(path)


def test_a_passphrase_for_a_key_without_one_does_no_harm(tmp_path: Path) -> None:
    new_sign_key(tmp_path / "lab.key")
    load_sign_key(tmp_path / "lab.key", PASSPHRASE)


@pytest.mark.parametrize("existing", ["lab.key", "lab.pub"])
def test_keys_are_never_overwritten(tmp_path: Path, existing: str) -> None:
    (tmp_path / existing).write_text("mine")
    with pytest.raises(InputError, match="never overwritten"):
        new_sign_key(tmp_path / "lab.key")
    assert [path.name for path in tmp_path.iterdir()] == [existing]
    assert (tmp_path / existing).read_text() == "mine"


def test_a_link_to_nowhere_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "lab.key").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="exists already"):
        new_sign_key(tmp_path / "lab.key")
    assert not (tmp_path / "elsewhere").exists()


def test_a_folder_that_is_missing_and_a_name_of_a_public_key_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no folder .* make it first"):
        new_sign_key(tmp_path / "nowhere" / "lab.key")
    with pytest.raises(InputError, match=r"must not end in \.pub"):
        new_sign_key(tmp_path / "lab.pub")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lab.key"
    new_sign_key(path)
    path.chmod(0o640)
    with pytest.raises(InputError, match="chmod 600"):
        load_sign_key(path)


def test_other_files_are_no_keys(tmp_path: Path) -> None:
    pem = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    for name, content, words in (("a", pem, "not an Ed25519 key"), ("b", b"text", "not a private key in PEM")):
        path = tmp_path / name
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(InputError, match=words):
            load_sign_key(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_sign_key(tmp_path / "missing")
    with pytest.raises(InputError, match="not a public key"):
        load_public_key(str(tmp_path / "a"))
    with pytest.raises(InputError, match="cannot be read"):
        load_public_key(str(tmp_path / "missing"))
