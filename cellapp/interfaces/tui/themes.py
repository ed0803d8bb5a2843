"""Colours for people who need strong contrast; Textual brings light and dark themes."""

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
"""The colours of Okabe and Ito (2008), which people with any colour vision tell apart, on black."""
