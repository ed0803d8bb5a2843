"""Result of ``compensate`` for a path file: each path as the model drives it."""

from __future__ import annotations

from cellapp.ground.results import Record, Result


class PathReversal(Record):
    """A joint that turns round: place, play crossed there as displacement of the SMR, and way in which it is crossed.

    ``window_mm`` is 0 where the arm stands meanwhile.
    """

    joint: int
    at_mm: float
    jump_mm: float
    window_mm: float


class PathRecord(Record):
    """One path. Where ``refusal`` says why it cannot be driven, figures that do not exist are None.

    Attributes
    ----------
    length_mm, duration_s, period_ms, samples : numbers or None
        Arc length, time from beginning to end, controller's period and number of joint positions.
    deviation_mm, deviation_at_mm : float or None
        Largest distance of the SMR from the wanted path by the model, and where.
    uncertainty_mm : float or None
        Largest standard uncertainty of a coordinate along the path by the model; None where it states none.
    at_speed : float or None
        Share of the length at the wanted speed; ``slowed`` says where a limit leaves the least of it.
    """

    name: str
    arm: str
    frame: str
    tolerance_mm: float
    refusal: str = ""
    length_mm: float | None = None
    duration_s: float | None = None
    period_ms: float | None = None
    samples: int | None = None
    deviation_mm: float | None = None
    deviation_at_mm: float | None = None
    uncertainty_mm: float | None = None
    at_speed: float | None = None
    slowed: str = ""
    reversals: tuple[PathReversal, ...] = ()


class PathResult(Result, schema="cellapp-path"):
    """``compensate`` of a path file: every path; ``files`` hold the joint positions."""

    paths: tuple[PathRecord, ...]
    notes: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Return which paths were refused, and why; empty if none."""
        return [f"path {path.name} refused {path.refusal}" for path in self.paths if path.refusal]
