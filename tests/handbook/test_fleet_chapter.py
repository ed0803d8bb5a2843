"""The words on the page about many runs."""

from __future__ import annotations

import re
from typing import get_args

import pytest

from cellapp.commands.docs.handbook import chapter_text
from cellapp.estimation.monitoring.fleet.records import ARM_CONDITIONS, IdentityBasis

pytestmark = pytest.mark.fast


def test_the_page_names_every_condition_and_every_way_to_know_an_arm() -> None:
    named = re.findall(r"^\| ([a-z ]+) \|", chapter_text("fleet"), re.M)
    assert named == ["known by", *get_args(IdentityBasis), "condition", *ARM_CONDITIONS]
