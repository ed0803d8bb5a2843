"""``open_run`` by the path that earlier versions had; ``cellapp.open_run`` is the same."""

from cellapp.interfaces.python.api import Run, open_run

__all__ = ["Run", "open_run"]
