"""All current results of a run as ``report``, ``run`` and ``show`` give them, the certificate with them."""

from __future__ import annotations

from typing import TypeVar

from cellapp.cell.run.file import RunFile
from cellapp.commands.certificate.result import CertificateResult
from cellapp.commands.run_results import RESULTS, StageResults, results_as
from cellapp.commands.stages import RunStages, read_stages
from cellapp.ground.results import CERTIFICATE


class RunResults(StageResults):
    """The current results of a run, each None where that verb has not run."""

    certificate: CertificateResult | None = None


class ReportResult(RunResults, schema="cellapp-report"):
    """``report``: the page, and the results that it shows."""

    page: str


R = TypeVar("R", bound=RunResults)


def shown_by(kind: type[R], stored: RunResults, **more: object) -> R:
    """Return the stored results as the result of a verb that shows them."""
    return kind.model_validate({**{name: getattr(stored, name) for name in stored.model_fields_set}, **more})


def read_results(run: RunFile, stages: RunStages | None = None) -> RunResults:
    """Return the current results of a run as objects; those that no longer hold are listed in ``out_of_date``."""
    return results_as(RunResults, run, stages or read_stages(run), {**RESULTS, CERTIFICATE: CertificateResult})
