"""Colours for people who need strong contrast; Textual itself has light and dark themes."""

from __future__ import annotations

from textual.theme import Theme

HIGH_CONTRAST = Theme(
    name="cellapp-contrast",
    primary="#56B4E9",
    secondary="#0072B2",
    accent="#CC79A7",
    warning="#E69F00",
    error="#D55E00",
    success="#009E73",
    foreground="#FFFFFF",
    background="#000000",
    surface="#000000",
    panel="#101010",
    dark=True,
)
"""Colours of Okabe and Ito (2008) on black, distinguishable with any colour vision."""
