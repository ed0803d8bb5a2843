"""``plan --view``: what the tracker sees of each arm's workspace."""

from __future__ import annotations

from pathlib import Path

from cellapp.cli.job import Job


def show_view(job: Job, profile: Path) -> None:
    """Print the view of the cell of a profile; nothing is stored."""
    from cellapp.planning.view import view_workspace
    from cellapp.profile import load_profile
    from cellapp.reporting.view_text import view_sentences, view_tables

    result = view_workspace(load_profile(profile), job.listen, job.control)
    job.show(view_tables(result))
    job.say(*view_sentences(result))
    job.result(result)
