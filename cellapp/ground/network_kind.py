"""Which residual network a calibration may use. Imports nothing: every start of the program loads it."""

from __future__ import annotations

from typing import Literal, TypeAlias

NetworkKind: TypeAlias = Literal["mlp", "batches", "none"]
