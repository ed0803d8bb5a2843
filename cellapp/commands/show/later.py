"""Verbs that store results and have no record yet: each goes as its record declares what it stores."""

from __future__ import annotations

from importlib import import_module

from cellapp.commands.record import Request, Stored, Verb, View
from cellapp.ground.results import Result


class _Later(Verb):
    def stored_view(self, stored: Stored, result: Result) -> View:
        module = import_module(f"cellapp.commands.{self.name}.view")
        if hasattr(module, "view"):
            shown: View = module.view(result, None)
            return shown
        tables, sentences = (getattr(module, f"{stored.view}_{what}") for what in ("tables", "sentences"))
        return View((*tables(result), *sentences(result)))


def _later(name: str, part: str, missing: str, stages: tuple[str, ...], view: str) -> Verb:
    return _Later(name, Request, "", stored=(Stored(part, missing, stages, view=view),))


LATER = (
    _later("follow", "paths", "no paths are", ("follow", "path"), "path"),
    _later("iso9283", "iso9283", "no test by ISO 9283 is", ("iso9283",), "iso9283"),
    _later("check", "check", "no check is", ("check",), "check"),
    _later("certificate", "certificate", "no certificate is", ("certificate",), "certificate"),
)
