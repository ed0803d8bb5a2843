"""Result of ``follow``: paths as planned, and with driving how well they were followed."""

from __future__ import annotations

from typing import Literal

from cellapp.estimation.uncertainty.records import ToleranceVerdict
from cellapp.ground.results import DecisionRule, ErrorSummary, Record, Result

PathSource = Literal["", "moving", "at rest"]


class PathReversal(Record):
    """A joint that turns round: place, play crossed there as displacement of the SMR, and way in which it is crossed.

    ``window_mm`` is 0 where the arm stands meanwhile.
    """

    joint: int
    at_mm: float
    jump_mm: float
    window_mm: float


class PathLag(Record):
    """How the joints followed what was sent, by their encoders.

    Attributes
    ----------
    delay_ms : float
        Delay common to all joints, which is no error of the path.
    late_mm : float
        Distance that the tool covers in that time at its fastest.
    cut_mm : float
        Largest distance of the SMR from the path without that delay: by how much corners are cut.
    """

    delay_ms: float
    late_mm: float
    cut_mm: float


class PathTime(Record):
    """How the SMR followed the path in time, by the tracker's stamps.

    Attributes
    ----------
    delay_ms, delay_expanded_ms : float
        By how much it was later than the positions that were sent: controller, and the way of the stamps. It is taken
        out of all that follows. With its expanded uncertainty (k = 2).
    rms_mm, largest_mm : float
        Distance from where the path wants it at the delayed time.
    speed_mm_s, mean_mm_s, expanded_mm_s, fluctuation_mm_s : float or None
        Wanted speed, mean where the path has it, expanded uncertainty of that (k = 2), and from the slowest to the
        fastest 0.2 s; None where the path does not keep its speed long enough.
    """

    delay_ms: float
    delay_expanded_ms: float
    rms_mm: float
    largest_mm: float
    speed_mm_s: float | None = None
    mean_mm_s: float | None = None
    expanded_mm_s: float | None = None
    fluctuation_mm_s: float | None = None


class DrivenPath(Record):
    """Distances of measured points from the wanted path [mm], without regard to time.

    Attributes
    ----------
    moving : ErrorSummary or None
        Of points measured while the arm moved; None where the tracker cannot.
    at_rest : ErrorSummary or None
        Of points measured at rest at places along the same joint path.
    nominal : ErrorSummary or None
        Of the path as the published geometry drives it; measured moving, or else at rest.
    lag : PathLag or None
        None where the arm did not report its joints.
    in_time : PathTime or None
        Delay and speed of the measured points; None where the tracker does not measure a moving SMR.
    rehearsed : bool
        Whether the path was driven once before, and corrected by how the joints followed.
    expanded_mm : float or None
        Expanded uncertainty (k = 2) of a distance where the path is farthest from the tracker; None where a
        contribution was not given.
    rule : str
        By which the tolerance was decided; in results of earlier versions the error alone was compared.
    verdict : str
        Of 95 % of the points, moving or else at rest, against the tolerance, by the decision rule.
    judged : str
        Which of them that is; empty without a measurement.
    note : str
        Why something was not driven or not measured; empty if nothing is missing.
    lost_beams : int
        How often the beam broke; the path was driven again from its beginning.
    """

    moving: ErrorSummary | None = None
    at_rest: ErrorSummary | None = None
    nominal: ErrorSummary | None = None
    lag: PathLag | None = None
    in_time: PathTime | None = None
    rehearsed: bool = False
    expanded_mm: float | None = None
    rule: DecisionRule = "simple"
    verdict: ToleranceVerdict = ""
    judged: PathSource = ""
    note: str = ""
    lost_beams: int = 0
    omitted_when_none = frozenset({"in_time"})


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
    unseen_mm : float or None
        From where on the tracker does not see the SMR; None if it sees the whole path.
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
    unseen_mm: float | None = None
    reversals: tuple[PathReversal, ...] = ()
    driven: DrivenPath | None = None


class PathResult(Result, schema="cellapp-path"):
    """``follow``: every path, and with ``--verify`` how far its measured points are from it."""

    paths: tuple[PathRecord, ...]
    notes: tuple[str, ...] = ()

    def complaints(self) -> list[str]:
        """Return why following failed: paths that were refused, not driven or out of tolerance; empty if none."""
        found = [f"path {path.name} refused {path.refusal}" for path in self.paths if path.refusal]
        for path in self.paths:
            driven = path.driven
            if driven is None:
                continue
            if driven.note:
                found.append(f"path {path.name}: {driven.note}")
            errors = driven.moving or driven.at_rest
            if errors is not None and errors.p95 is not None and errors.p95 > path.tolerance_mm:
                proven = "" if driven.verdict == "out" else ", not proven with the uncertainty"
                found.append(
                    f"path {path.name}: 95 % of the points are within {errors.p95:.3f} mm, tolerance"
                    f" {path.tolerance_mm:g} mm{proven}"
                )
        return found
