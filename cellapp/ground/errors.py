"""Errors that are meant for the person at the cell: one clear sentence each, and an exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Found = TypeVar("Found")


class CellappError(Exception):
    """What is wrong, where, what was expected, what to do. ``exit_code`` as in the handbook, chapter "commands"."""

    exit_code = 2


class InputError(CellappError):
    """Bad input: a profile, a file, a run folder or an argument."""

    exit_code = 2


class CheckFailed(CellappError):
    """A check did not hold: a verification, or a doctor's finding."""

    exit_code = 1


class HardwareError(CellappError):
    """A device refused or faulted."""

    exit_code = 3


class NotConverged(CellappError):
    """A fit did not converge: an error of the program, which says nothing about the arm, the cell or the readings."""

    exit_code = 1

    @classmethod
    def of(cls, fit: str, why: str, do: str = "please report it, with the run") -> NotConverged:
        """Return the error of ``fit``, such as "fit of the tracker's station", with its reason and what to do."""
        return cls(f"the {fit} did not converge: {why}; this is a failure of the program and no finding; {do}")


def tried(what: str, candidate: Callable[[], Found | None], not_fitted: list[str]) -> Found | None:
    """Return what a ``candidate`` of a search leads to; None, and ``what`` joins ``not_fitted``, if no fit converges.

    Such a candidate is dropped without a judgement: a search must not take the failure for evidence.
    """
    try:
        return candidate()
    except NotConverged:
        not_fitted.append(what)
        return None


def with_not_fitted(sentence: str, not_fitted: Sequence[str]) -> str:
    """Append to the sentence of a search what it could not judge, because a fit of it did not converge."""
    if not not_fitted:
        return sentence
    return f"{sentence}; not judged, as no fit of it converged: {', '.join(dict.fromkeys(not_fitted))}"
