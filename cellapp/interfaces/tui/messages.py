"""Messages that other threads send to the application."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from textual.message import Message

from cellapp.interfaces.tui.workspace import Workspace

if TYPE_CHECKING:
    from cellapp.commands.runs.result import RunSummary

Severity = Literal["information", "warning", "error"]
"""Severity of a sentence, with Textual's words."""


class LeaveAsked(Message):
    """The terminal was closed, or the system ends this program."""


class StopGiven(Message):
    """A person pressed STOP and the brakes were called; the screens must only say so. ``arms``: whether arms brake."""

    def __init__(self, arms: bool) -> None:
        super().__init__()
        self.arms = arms


class WorkspaceLoaded(Message):
    """Profile and run were read."""

    def __init__(self, workspace: Workspace) -> None:
        super().__init__()
        self.workspace = workspace


class ResumeOffered(Message):
    """An interrupted run of collecting was found."""

    def __init__(self, run: RunSummary) -> None:
        super().__init__()
        self.run = run
