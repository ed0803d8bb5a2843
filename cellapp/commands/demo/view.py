"""The result of ``demo``: that of the run."""

from __future__ import annotations

from cellapp.commands.run.view import view as view
