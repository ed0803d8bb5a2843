"""Registry of the screens, in the order of the day. A screen's module is loaded when it is first shown."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from textual.screen import Screen

from cellapp.commands.docs.keys import STEPS, Step


@dataclass(frozen=True)
class ScreenEntry:
    """One screen: its step, the key that shows it, its title, and its class, in the module named like the step."""

    step: Step
    key: str
    title: str
    class_name: str
    purpose: str

    def make(self) -> Screen[None]:
        """Load the module and create the screen."""
        module = importlib.import_module(f"cellapp.interfaces.tui.screens.{self.step}")
        screen: Screen[None] = getattr(module, self.class_name)()
        return screen


SCREENS: tuple[ScreenEntry, ...] = (
    ScreenEntry("cell", "1", "Cell", "CellScreen", "profile, devices, doctor; all runs"),
    ScreenEntry("plan", "2", "Plan", "PlanScreen", "stops that the arms will visit"),
    ScreenEntry("collect", "3", "Collect", "CollectScreen", "drive and measure"),
    ScreenEntry("calibrate", "4", "Calibrate", "CalibrateScreen", "identify, errors by stage"),
    ScreenEntry("discover", "5", "Discover", "DiscoverScreen", "name the missing effect"),
    ScreenEntry("targets", "6", "Targets", "TargetsScreen", "compensate, push, verify"),
    ScreenEntry("accept", "7", "Accept", "AcceptScreen", "verdict, check, ISO 9283, certificate, report"),
)
assert tuple(entry.step for entry in SCREENS) == STEPS
