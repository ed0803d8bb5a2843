"""What the stored text of a stage says, as far as it decides which stages hold; the whole result is not read."""

from __future__ import annotations

import json

from cellapp.estimation.monitoring.check.records import CHANGES_OF_ARMS, TRACKER_MOVED
from cellapp.ground.results import CHECK


def json_object(text: str) -> dict[str, object] | None:
    """The JSON object that a text holds; None if it is none."""
    try:
        content = json.loads(text)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def says_moved(text: str) -> bool:
    """Whether ``locate`` found the tracker elsewhere than where the readings were taken."""
    content = json_object(text)
    return content is not None and content.get("moved") is True


def found_change(text: str) -> str:
    """The verdict of a check that found a change; empty if it found none or could not say."""
    verdict = _verdict(text)
    return verdict if verdict in (TRACKER_MOVED, *CHANGES_OF_ARMS) else ""


def cannot_say(text: str) -> bool:
    """Whether a check came to no verdict."""
    return _verdict(text) == "cannot say"


def change_words(verdict: str) -> str:
    """That a check found a change, as the reason why a model should not be used."""
    return f"the last '{CHECK}' found: {verdict}"


def _verdict(text: str) -> str:
    content = json_object(text)
    verdict = None if content is None else content.get("verdict")
    return verdict if isinstance(verdict, str) else ""
