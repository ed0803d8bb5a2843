"""Fields of a profile's form: the key that each one fills, how its text becomes a value, its label and help.

A field holds the text that a person typed, wrong or right. ``draft_check`` validates it by the profile's own rules.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import yaml

from cellapp.cell.profile.loader import is_number, is_word
from cellapp.cell.profile.messages import KeyPath

Shape = Literal["text", "value", "vector", "ranges"]
"""text: a word; value: a number, with a unit or without; vector: values separated by commas; ranges: pairs of values,
with a semicolon between the pairs."""


@dataclass(frozen=True)
class FormField:
    """One field of the form.

    Attributes
    ----------
    name : str
        Attribute of the draft's section.
    path : KeyPath
        Key inside that section of the profile.
    shape : Shape
    label : str
        Two or three words.
    help : str
        What belongs there; also the comment in the YAML.
    """

    name: str
    path: KeyPath
    shape: Shape
    label: str
    help: str


ARM_FIELDS = (
    FormField("type", ("type",), "text", "Arm type", "file of the arm's type, relative to this file"),
    FormField("kind", ("driver", "kind"), "text", "Driver", "how the arm is reached"),
    FormField(
        "host", ("driver", "host"), "text", "Controller", "address of the controller (Setup Robot > Network on UR)"
    ),
    FormField(
        "serial",
        ("driver", "serial"),
        "text",
        "Serial number",
        "the controller's serial number; it is compared before the first motion. Empty: not compared",
    ),
    FormField(
        "position",
        ("base", "position"),
        "vector",
        "Base position",
        "x, y, z of the base in the cell frame C, to some centimetres; calibration finds the exact pose",
    ),
    FormField(
        "rpy", ("base", "rpy"), "vector", "Base rotation", "roll, pitch, yaw: rot_z(yaw) rot_y(pitch) rot_x(roll)"
    ),
    FormField(
        "smr_offset",
        ("smr", "offset"),
        "vector",
        "SMR offset",
        "x, y, z of the SMR centre in the flange frame, to some millimetres, off the last axis by 30 mm; or: unknown",
    ),
    FormField(
        "smr_normal", ("smr", "normal"), "vector", "SMR normal", "viewing direction of the SMR in the flange frame"
    ),
    FormField(
        "payload_mass",
        ("payload", "mass"),
        "value",
        "Payload mass",
        "SMR, holder and tool together, as set on the controller",
    ),
    FormField(
        "payload_center",
        ("payload", "center_of_mass"),
        "vector",
        "Payload centre",
        "x, y, z of its centre of mass in the flange frame",
    ),
    FormField(
        "limits",
        ("limits",),
        "ranges",
        "Joint ranges",
        "lower, upper of each joint, as cables and surroundings allow. Empty: the arm type's",
    ),
    FormField("home", ("home",), "vector", "Home", "joint positions before and after a job"),
    FormField("speed", ("speed_scale",), "value", "Speed", "share of the arm type's joint speeds"),
)
TRACKER_FIELDS = (
    FormField("kind", ("driver", "kind"), "text", "Driver", "how the tracker is reached"),
    FormField("address", ("driver", "address"), "text", "Address", "IP address or host name of the tracker"),
    FormField(
        "url",
        ("driver", "url"),
        "text",
        "Bridge",
        "address of `cellapp tracker-bridge`, as socket://192.168.0.20:50960 or a serial port",
    ),
    FormField(
        "token_file",
        ("driver", "token_file"),
        "text",
        "Token file",
        "file with the token that the bridge has too, as ~/tracker-token; readable by you alone",
    ),
    FormField(
        "serial",
        ("driver", "serial"),
        "text",
        "Serial number",
        "the tracker's serial number; it is compared at each connect. Empty: not compared",
    ),
    FormField(
        "position",
        ("pose", "position"),
        "vector",
        "Position",
        "x, y, z of the tracker's head in the cell frame C, to some centimetres",
    ),
    FormField("rpy", ("pose", "rpy"), "vector", "Rotation", "roll, pitch, yaw; its x axis points where yaw says"),
)
OBSTACLE_FIELDS = (
    FormField("shape", ("shape",), "text", "Shape", "box, cylinder, capsule, sphere or mesh"),
    FormField("fixed_to", ("fixed_to",), "text", "Fixed to", "cell, base or flange. Empty: the cell"),
    FormField("arm", ("arm",), "text", "Of arm", "the arm to whose base or flange it is fixed"),
    FormField(
        "position", ("pose", "position"), "vector", "Position", "x, y, z of its centre in the frame that it is fixed to"
    ),
    FormField("rpy", ("pose", "rpy"), "vector", "Rotation", "roll, pitch, yaw: rot_z(yaw) rot_y(pitch) rot_x(roll)"),
    FormField("size", ("size",), "vector", "Size", "full lengths along its x, y, z"),
    FormField("radius", ("radius",), "value", "Radius", "of the round part"),
    FormField("length", ("length",), "value", "Length", "along its z axis; of a capsule without its round ends"),
    FormField("file", ("file",), "text", "STL file", "triangle mesh, relative to this file"),
    FormField("scale", ("scale",), "value", "Scale", "metres for one unit of the mesh, as 0.001 for mm. Empty: 1"),
)
PLAN_FIELDS = (
    FormField("stops", ("stops",), "value", "Stops", "joint configurations of each arm that are measured"),
    FormField(
        "clearance",
        ("clearance",),
        "value",
        "Clearance",
        "between the arms; at least the uncertainty of the base poses",
    ),
    FormField("floor", ("floor",), "value", "Floor", "height in C below which nothing may reach: table or floor"),
)
OBSTACLE_NAME_FIELD = FormField("name", (), "text", "Name", "name of the obstacle, such as table; refusals use it")
ARM_NAME_FIELD = FormField("name", (), "text", "Name", "name of the arm, such as left; readings and targets use it")
NAME_FIELD = FormField("name", ("name",), "text", "Name", "name of the cell; a person types it before arms move")


def yaml_value(shape: Shape, text: str) -> str:
    """Return a field's text as YAML on one line: numbers plain, quantities with a unit and other texts in quotes."""
    text = text.strip()
    match shape:
        case "text":
            return yaml_text(text)
        case "value":
            return _yaml_scalar(text)
        case "vector":
            return _yaml_vector(text)
        case "ranges":
            return f"[{', '.join(yaml_pairs(text))}]"


def yaml_pairs(text: str) -> list[str]:
    """Return each pair of a field of ranges as YAML."""
    return [_yaml_vector(pair) for pair in text.strip("; ").split(";")]


def form_text(value: object) -> str:
    """Return a value of a profile as a field shows it; ``yaml_value`` converts it back to the same value."""
    match value:
        case None:
            return ""
        case bool():
            return str(value).lower()
        case list() if any(isinstance(item, list) for item in value):
            return "; ".join(map(form_text, value))
        case list():
            return ", ".join(map(form_text, value))
        case _:
            return str(value)


def yaml_text(text: str) -> str:
    """Return a text as YAML: plain if it is one word, else in quotes, escaped where necessary."""
    if is_word(text):
        return text
    return str(yaml.safe_dump(text, default_style='"', allow_unicode=True, width=10**6)).rstrip("\n")


def _yaml_vector(text: str) -> str:
    items = [item.strip() for item in text.split(",")]
    if len(items) == 1 and not is_number(items[0]):
        return _yaml_scalar(items[0])  # such as: unknown
    return f"[{', '.join(map(_yaml_scalar, items))}]"


def _yaml_scalar(text: str) -> str:
    """Return a number plain. YAML reads 010 as eight and 1_0 as ten: those are quoted, and refused later."""
    octal = text.lstrip("+-").startswith("0") and text.lstrip("+-")[1:2].isalnum() and text[-1:] != "."
    plain = is_number(text) and not octal and not set(text) & set("_:xX")
    return text if plain else yaml_text(text)
