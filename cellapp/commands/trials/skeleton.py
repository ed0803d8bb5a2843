"""Parts that all trials share: tasks that are computed and stored, bars, and tables of the results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from cellapp.commands.view.table import Table
from cellapp.ground.progress import CancelToken, Listener, ignore
from cellapp.ground.results import Result
from cellapp.ground.scale.executor import IN_PROCESS, Resources
from cellapp.ground.scale.gather import Gathered, gather
from cellapp.ground.scale.task import Batch, Common, Found, Parameters, Prepared, TaskKind

_NAMED = 10
"""Most failures that are named one by one."""


@dataclass(frozen=True)
class Work:
    """Where the tasks of a trial are computed and stored, and who listens to them and can cancel them."""

    resources: Resources = IN_PROCESS
    listener: Listener = ignore
    cancel: CancelToken = field(default_factory=CancelToken)

    def gather(
        self,
        kind: TaskKind[Common, Prepared, Parameters, Found],
        job: str,
        common: Common,
        parameters: Sequence[Parameters],
        name: str = "seed {0.seed}",
        *,
        all_may_fail: bool = False,
    ) -> Gathered[Found]:
        """Compute all tasks; ``name`` is the format string of a task's name, given its parameters.

        Raises as ``gather`` of ``cellapp.ground.scale`` does.
        """
        batch = Batch(kind, common, parameters, [name.format(one) for one in parameters])
        return gather(batch, job, self.resources, self.listener, self.cancel, all_may_fail=all_may_fail)


IN_PLACE = Work()
"""In this process, without store and listener."""


@dataclass(frozen=True)
class Stated:
    """Outcome of a trial: its result, tables and sentences; ``refused`` says why it does not hold, else empty."""

    result: Result
    tables: Sequence[Table] = ()
    sentences: Sequence[str] = ()
    refused: str = ""


class Trial(Protocol):
    """A result that can state its failures and missed bars."""

    def complaints(self) -> list[str]:
        """State what failed, and which bars are missed."""
        ...


def not_computed(failed: Sequence[str]) -> str:
    """Name the first tasks that failed; empty if none did."""
    if not failed:
        return ""
    more = f"; and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
    return f"{len(failed)} could not be computed: {'; '.join(failed[:_NAMED])}{more}"


def complained(trial: str, result: Trial) -> str:
    """Return the complaints of the trial named ``trial`` in one line; empty if there are none."""
    said = result.complaints()
    return f"trials {trial}: {'; '.join(said)}" if said else ""
