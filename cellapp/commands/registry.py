"""The records of all verbs, in the order of the work."""

from __future__ import annotations

from importlib import import_module

from cellapp.commands.folders import FOLDERS
from cellapp.commands.record import Verb

VERBS: tuple[Verb, ...] = tuple(import_module(f"cellapp.commands.{folder}.request").VERB for folder in FOLDERS)
