"""Events of a running job, in one line each, for the log of a screen."""

from __future__ import annotations

from cellapp.ground.progress import Detail, LogReport, Notice, ReferenceReport, StateChange, StopReport, Suspicion


def detail_words(detail: Detail) -> str:
    """Describe an event in one line; empty for steps of a stop, which a screen draws and a log omits."""
    match detail:
        case StateChange(state, reason):
            return f"{state.upper()}: {reason}"
        case StopReport():
            return f"stop {detail.stop + 1}, {stop_words(detail)}"
        case Suspicion(kind, text):
            return f"SUSPICION: {kind}: {text}"
        case ReferenceReport(drift_mm, limit_mm):
            drifts = ", ".join(f"{name} {drift:.3f}" for name, drift in drift_mm.items())
            return f"reference: {drifts} mm from the first measurement, limit {limit_mm:.3f} mm"
        case LogReport(text=text) | Notice(text=text):
            return text
        case _:
            return ""


def stop_words(report: StopReport) -> str:
    """State the newest residual and standard error of one arm."""
    return f"{report.arm}: residual {report.residual_mm:.3f} mm, standard error {report.standard_error_mm:.4f} mm"
