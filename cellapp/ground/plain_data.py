"""What a caller in Python hands over in place of a file, as the plain data that a file would give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def plain_data(value: Any) -> Any:
    """Mappings as dict, sequences and arrays as list, numpy's numbers as those of Python; other values as they are."""
    if isinstance(value, Mapping):
        return {str(key): plain_data(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(part) for part in value]
    return value.tolist() if hasattr(value, "tolist") else value
