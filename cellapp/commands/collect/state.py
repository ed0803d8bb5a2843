"""What a run says about its collecting, as a typed result."""

from __future__ import annotations

from cellapp.cell.driving.practice import LiveModel
from cellapp.cell.driving.records import CollectionResult, SessionRecord, SessionRequest
from cellapp.cell.run import RunFile
from cellapp.cell.run.collected import missing_readings, missing_share, reference_drifts


def collection_state(run: RunFile) -> CollectionResult | None:
    """Sessions, missing readings, reference drift and standard errors; None if this run records no session."""
    sessions = run.sessions()
    if not sessions:
        return None
    missing = missing_readings(run)
    settings = run.profile.collection
    errors_mm: dict[str, float] = {}
    if plan := run.read_plan():
        stored = {name: run.readings(name) for name in plan}
        errors_mm = LiveModel(run.profile, plan, stored, lambda level, text: None).standard_error_mm
    return CollectionResult(
        run=str(run.folder),
        sessions=tuple(
            SessionRecord.like(
                session,
                requests=tuple(
                    SessionRequest(written=written, kind=kind, reason=reason)
                    for written, kind, reason in session.requests
                ),
            )
            for session in sessions
        ),
        missing=missing,
        missing_share=missing_share(run, missing),
        tolerated_share=settings.tolerated,
        references=reference_drifts(run),
        drift_limit_mm=settings.reference.drift * 1e3,
        standard_error_mm=errors_mm,
    )
