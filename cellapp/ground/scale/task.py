"""What is computed many times: a kind of task, what all tasks of a batch share, and the parameters of each.

Everything that travels between processes is text: parameters and results are JSON, and a kind is named by where it
stands (``module:NAME``). A result depends on nothing else, so that the same task gives the same result anywhere.
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

from pydantic import BaseModel

from cellapp.ground.errors import InputError
from cellapp.ground.profile import Profile
from cellapp.ground.results import Record
from cellapp.ground.scale.program import source_outside

Common = TypeVar("Common", bound=BaseModel)
Prepared = TypeVar("Prepared")
Parameters = TypeVar("Parameters", bound=BaseModel)
Found = TypeVar("Found", bound=BaseModel)


@dataclass(frozen=True)
class TaskKind(Generic[Common, Prepared, Parameters, Found]):
    """How tasks of one kind are computed.

    Attributes
    ----------
    reference : str
        ``module:NAME`` of this object; a worker imports it from there.
    common, parameters, found : type
        Models of what all tasks of a batch share, of the parameters of one task, and of its result.
    prepare : callable
        From what is shared to what ``run`` needs: readings parsed, a cell planned. A process does it once a batch.
    run : callable
        The task itself. Its result depends on its two arguments only.
    """

    reference: str
    common: type[Common]
    parameters: type[Parameters]
    found: type[Found]
    prepare: Callable[[Common], Prepared]
    run: Callable[[Prepared, Parameters], Found]


@dataclass(frozen=True)
class Task:
    """One task: the reference of its kind, its parameters as JSON, and a ``key`` that is the same for equal tasks only.

    ``name`` says in a few words which one it is.
    """

    kind: str
    parameters: str
    key: str
    name: str


@dataclass(frozen=True)
class Batch(Generic[Common, Prepared, Parameters, Found]):
    """Tasks of one kind that share ``common``; ``names`` say in a few words which task is which."""

    kind: TaskKind[Common, Prepared, Parameters, Found]
    common: Common
    parameters: Sequence[Parameters]
    names: Sequence[str]

    @cached_property
    def shared(self) -> str:
        """What all tasks share, as JSON."""
        return as_json(self.common)

    def digest(self, program: str) -> str:
        """SHA-256 of what all tasks share and of the program that computes them, with modules outside of it."""
        return _sha256(self.kind.reference, program, source_outside(self.kind.run), self.shared)

    def tasks(self, program: str) -> list[Task]:
        """All tasks, in their order."""
        batch = self.digest(program)
        texts = [as_json(one) for one in self.parameters]
        return [
            Task(self.kind.reference, text, _sha256(batch, text), name)
            for text, name in zip(texts, self.names, strict=True)
        ]


class SimulatedCell(Record):
    """What the tasks of most trials share: the profile of a simulated cell."""

    profile: Profile


class Seed(Record):
    """Parameters of a task that is drawn by a seed and has no others."""

    seed: int


def as_given(common: Common) -> Common:
    """What is shared, as it is: ``prepare`` of tasks that need nothing made of it."""
    return common


def profile_of(common: SimulatedCell) -> Profile:
    """The profile of what is shared: ``prepare`` of tasks that need only this."""
    return common.profile


def as_json(model: BaseModel) -> str:
    """JSON text of a model, the same for equal models."""
    return model.model_dump_json(by_alias=True)


def load_kind(reference: str) -> TaskKind[Any, Any, Any, Any]:
    """Import a kind of task. Raises ``InputError`` if it does not stand where its reference says."""
    module, _, name = reference.partition(":")
    try:
        kind = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"tasks of kind '{reference}' are not known here ({error})") from None
    if not isinstance(kind, TaskKind):
        raise InputError(f"'{reference}' is no kind of task")
    return kind


def _sha256(*texts: str) -> str:
    return hashlib.sha256(json.dumps(texts).encode()).hexdigest()
