"""The records of the verbs that store results in a run."""

from __future__ import annotations

from importlib import import_module

from cellapp.commands.folders import STORING as FOLDERS
from cellapp.commands.record import Verb

STORING: tuple[Verb, ...] = tuple(import_module(f"cellapp.commands.{folder}.request").VERB for folder in FOLDERS)
