"""The calibration that a controller brings from the factory: what it adds to the published D-H rows of its arm."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.settings import Section

_Deltas = tuple[Annotated[float, Field(strict=True, ge=-1e5, le=1e5)], ...]


class ControllerTable(Section):
    """Deltas of the D-H rows of a controller [rad, m, m, rad], one of each joint; plain rows, so that d may be large.

    ``checksum`` is that of the calibration in the controller, as ``doctor`` shows it; empty if the file has none.
    """

    delta_theta: _Deltas
    delta_d: _Deltas
    delta_a: _Deltas
    delta_alpha: _Deltas
    checksum: str = ""

    @property
    def deltas(self) -> tuple[_Deltas, _Deltas, _Deltas, _Deltas]:
        """Columns theta, d, a, alpha."""
        return self.delta_theta, self.delta_d, self.delta_a, self.delta_alpha

    @model_validator(mode="after")
    def _as_long_as_each_other(self) -> Self:
        lengths = [len(column) for column in self.deltas]
        if len(set(lengths)) > 1:
            raise ValueError(f"delta_theta, delta_d, delta_a, delta_alpha have {lengths} values, one a joint is needed")
        return self
