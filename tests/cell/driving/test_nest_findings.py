"""What the doctor says of nests on a flange and of reference nests that tie tracker stations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cellapp.cell.driving.examination import examine
from cellapp.ground.profile import Profile
from cellapp.ground.profile.smr import Smr
from drivers.findings import Finding
from tests.twin import small_twin, with_arm

pytestmark = pytest.mark.fast
NESTS = {"B": {"offset": (-0.045, 0.02, 0.06)}, "C": {"offset": (0.0, 0.075, 0.06)}}
TIE = "station,nest,x_m,y_m,z_m\n" + "".join(
    f"{station},F{k},{x + shift:.5f},{y:.5f},{z:.5f}\n"
    for station, shift in (("north", 0.0), ("south", 0.5))
    for k, (x, y, z) in enumerate([(2.0, 1.5, -0.5), (3.5, -1.0, -0.5), (1.5, -1.0, 0.4), (3.0, 1.0, 0.8)])
)


def with_nests(**keys: Any) -> Profile:
    profile = small_twin()
    smr = Smr.model_validate({**profile.arms["left"].smr.model_dump(), "name": "A", "nests": NESTS, **keys})
    return with_arm(profile, "left", smr=smr)


def said(profile: Profile, subject: str, reference_nests: Path | None = None) -> Finding:
    (found,) = [one for one in examine(profile, reference_nests) if one.subject == subject]
    return found


def test_nests_that_agree_are_said_with_what_they_tell() -> None:
    distances = [{"between": ("A", "B"), "distance": 0.09}]
    profile = with_nests(distances=distances)
    found = said(profile, "arm left: nests")
    assert found.status == "ok"
    assert "3 nests, which tell the orientation at home to 0." in found.text
    assert "at home the tracker sees" in said(profile, "arm left: nests at home").text
    assert not [one for one in examine(small_twin()) if "nests" in one.subject]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"distances": [{"between": ("A", "B"), "distance": 0.15}]},
            "offsets put A and B 90.00 mm apart, distances say",
        ),
        ({"nests": {"B": NESTS["B"], "C": {"offset": (0.0, 0.02, 0.06)}}}, "they stand on one line"),
        ({"nests": {"B": NESTS["B"], "C": NESTS["B"]}}, "B and C are at the same place"),
    ],
)
def test_nests_that_cannot_be_are_named(keys: dict[str, Any], words: str) -> None:
    found = said(with_nests(**keys), "arm left: nests")
    assert found.status == "failed"
    assert words in found.text


def test_nests_of_unknown_offset_are_not_pointed_at() -> None:
    profile = with_nests(nests={"B": NESTS["B"], "C": {"offset": "unknown"}})
    assert "is known once they are measured" in said(profile, "arm left: nests").text
    assert "C cannot be pointed at" in said(profile, "arm left: nests at home").text


def test_how_well_stations_are_tied_at_the_arms(tmp_path: Path) -> None:
    path = tmp_path / "nests.csv"
    path.write_text(TIE, "utf-8")
    found = said(small_twin(), "reference nests: station south", path)
    assert found.status == "ok"
    assert "tied to north by 4 reference nests, which are off by 0.000 mm rms" in found.text
    assert "a coordinate of arm right at home to 0.0" in found.text
    path.write_text(TIE.replace("F3", "F4").replace("south,F0,2.50000", "south,F0,2.60000"), "utf-8")
    refused = said(small_twin(), "reference nests", path)
    assert refused.status == "failed"
    assert str(path) in refused.text
