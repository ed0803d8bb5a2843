"""Common base of the library's results: they print themselves as text, as HTML and as charts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from cellapp.commands.view.charts import Chart
from cellapp.commands.view.parts import Parts
from cellapp.ground.errors import InputError
from cellapp.interfaces.page.notebook import html_view
from cellapp.interfaces.render.terminal import plain_text

if TYPE_CHECKING:
    from cellapp.interfaces.page.notebook import Drawing

_LONGEST = 190
"""Longest ``repr`` [characters]: one line of a wide screen or two of a narrow one."""


class Printed(ABC):
    """A result that prints itself, with ``print(result)`` or by its name at the end of a notebook cell."""

    @abstractmethod
    def view(self) -> Parts:
        """Return the full content as tables and lines, in reading order."""

    @abstractmethod
    def summary(self) -> str:
        """Return one line: what the result is, and its most important figures."""

    def report(self, width: int = 100) -> str:
        """Return the view as plain text; tables are at most ``width`` characters wide."""
        return plain_text(self.view(), width)

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        text = f"{type(self).__name__}({self.summary()})"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]}...)"

    def _repr_html_(self) -> str:
        return html_view(self.view())


class Charted(Printed):
    """A result that can also draw itself."""

    @abstractmethod
    def charts(self) -> Mapping[str, Callable[[], Sequence[Chart]]]:
        """Return the available charts by name, most informative first; each value creates its charts when called."""

    def plot(self, what: str = "") -> Drawing:
        """Draw charts of one kind as HTML, which a notebook shows; without a name the first kind of ``charts()``.

        Raises
        ------
        InputError
            If there are no charts of that name.
        """
        from cellapp.interfaces.page.notebook import draw_charts

        known = self.charts()
        if what and what not in known:
            raise InputError(f"plot: nothing is called '{what}'; known are {', '.join(known)}")
        drawn = known[what or next(iter(known))]()
        if not drawn:
            raise InputError(f"plot: there is nothing to draw of '{what}' in {self.summary()}")
        return draw_charts(drawn)
