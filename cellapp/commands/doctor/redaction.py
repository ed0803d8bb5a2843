"""Removal of secrets from texts that leave the computer."""

from __future__ import annotations

import re
from collections.abc import Collection

REDACTED = "[redacted]"
_PRIVATE = re.compile(r"-----BEGIN [A-Z ]*KEY-----.*?(?:-----END [A-Z ]*KEY-----|\Z)", re.DOTALL)
_USER = re.compile(r"(?<=//)[^/\s@\"']+:[^/\s@\"']*(?=@)")
_BEARER = re.compile(r"\b(Bearer|Basic)\s+[\w.~+/=-]{8,}", re.IGNORECASE)
_NAMED = re.compile(
    r"(?P<name>[\"']?\b[\w-]*(?:password|passwd|passphrase|secret|token|api[_-]?key|private[_-]?key|credential)[\w-]*"
    r"[\"']?\s*[:=]\s*)(?P<value>\"(?:[^\"\\]|\\.)*\"|'[^']*'|[^\s,}\]]+)",
    re.IGNORECASE,
)
_LEAST = 4
"""Least length of a secret that is searched for: shorter ones would be found in every number."""


def redacted(text: str, secrets: Collection[str] = ()) -> str:
    """Remove values of keys such as ``token`` or ``password``, PEM keys, users in addresses, ``secrets`` from texts."""
    for secret in sorted((one for one in secrets if len(one) >= _LEAST), key=len, reverse=True):
        text = text.replace(secret, REDACTED)
    text = _PRIVATE.sub(REDACTED, text)
    text = _USER.sub(REDACTED, text)
    text = _BEARER.sub(rf"\1 {REDACTED}", text)
    return _NAMED.sub(lambda found: f'{found["name"]}"{REDACTED}"', text)
