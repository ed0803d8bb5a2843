"""How many files a new effect, driver, export, verb, chart or screen touches, by the toys of the tests.

    python -m tests.touches

prints the table of the handbook: their own files, and lines elsewhere.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

TESTS = Path(__file__).parent
_EXAMPLE = "interfaces/plugins/example_plugin/cellapp_example"
_VERB = "commands/toys/greet.py"


@dataclass(frozen=True)
class Touch:
    """What a new one of some kind touches.

    Attributes
    ----------
    kind : str
    own : tuple of str
        Files of the toy, relative to ``tests``.
    elsewhere : tuple of str
        Lines elsewhere: file, relative to the repository, and what is written there.
    shown_by : str
        Test that shows the toy at work.
    """

    kind: str
    own: tuple[str, ...]
    elsewhere: tuple[str, ...]
    shown_by: str


TOUCHES: tuple[Touch, ...] = (
    Touch(
        "effect",
        (f"{_EXAMPLE}/hose_pull.py",),
        ("cellapp/robot/effects/registry.py: its class",),
        "robot/effects/test_declarations.py",
    ),
    Touch(
        "driver of an arm",
        (f"{_EXAMPLE}/line_settings.py", f"{_EXAMPLE}/line_arm.py"),
        ("drivers/arms/registry.py: its settings",),
        "interfaces/plugins/test_example_plugin.py",
    ),
    Touch(
        "driver of a tracker",
        ("cell/driving/toys/tracker.py",),
        ("drivers/trackers/registry.py: its settings",),
        "cell/driving/test_controllers.py",
    ),
    Touch(
        "export",
        (f"{_EXAMPLE}/serial_link.py",),
        ("cellapp/cell/exports/formats.py: its format",),
        "commands/test_export.py",
    ),
    Touch(
        "verb with its result",
        (_VERB,),
        ("cellapp/commands/registry.py: its name",),
        "commands/test_show.py",
    ),
    Touch(
        "chart of a result",
        (_VERB,),
        (),
        "commands/test_show.py",
    ),
    Touch(
        "dialog with its job",
        (_VERB,),
        (),
        "commands/test_show.py",
    ),
    Touch(
        "screen of the day",
        (),
        ("cellapp/interfaces/tui/screens/__init__.py: its entry", "cellapp/interfaces/tui/workspace.py: its step"),
        "test_touches.py",
    ),
)


def touches_table(touches: Sequence[Touch] = TOUCHES) -> str:
    """The table of the handbook, in Markdown."""
    lines = ["| a new | files of its own | lines elsewhere |", "| --- | --- | --- |"]
    for one in touches:
        own = str(len(one.own)) if one.own else "1"
        lines.append(f"| {one.kind} | {own} | {len(one.elsewhere)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(touches_table())
