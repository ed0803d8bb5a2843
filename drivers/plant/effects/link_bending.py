"""Links as elastic beams: bending and torsion under the weight of all bodies beyond, and of the link itself."""

from __future__ import annotations

import numpy as np

from drivers.plant.config import Array
from drivers.plant.effect import JOINTS, STIFFNESSES, Bend, by, by_law, made
from drivers.plant.mechanism import Deflection, Posture
from drivers.plant.transforms import inverse, rigid, transform_points

_SEGMENTS = 12


def _bent(
    posture: Posture, links: np.ndarray, bending: Array, torsion: Array, shear: Array | None = None
) -> Deflection:
    """Return the deviation by beams, each from D-H origin i - 1 to origin i, in segments that rotate under the local
    moment.

    The moment at the middle of a segment is that of all weight beyond it in the deflected posture: bodies and load
    beyond the link, and the link's own mass, distributed along the beam such that its centre of mass is correct. A
    segment of length s rotates by ``s M / EI`` across the beam (Euler-Bernoulli) and by ``s M / GJ`` about it; the
    tip's twist is the product of these rotations. Size: ``EI`` about 1e5 Nm^2 for a UR10 (an estimate).

    With ``shear``, the product kappa G A [N], the transverse force of all weight beyond the middle of the link shifts
    the tip by ``force length / shear`` as well (Timoshenko), as in short tubes with openings.
    """
    twists = np.zeros((len(posture.q), posture.q.shape[1], 6))
    for k, link in enumerate(links.tolist()):
        twists[:, link] = _tip_twist(posture, link, bending[k], torsion[k])
        if shear is not None:
            twists[:, link, :3] += _shear_shift(posture, link, shear[k])
    return Deflection(links=twists)


def _shear_shift(posture: Posture, link: int, shear: float) -> Array:
    """Return the shift (n, 3) of a beam's tip by shear, in the D-H frame of the tip."""
    mechanism = posture.mechanism
    root = transform_points(inverse(mechanism.frames[link + 1]), mechanism.frames[link, :3, 3])
    length = float(np.linalg.norm(root))
    if length == 0.0:
        return np.zeros((len(posture.q), 3))
    pose = posture.placements[link] @ mechanism.frames[link + 1]
    # half of the link's own weight lies beyond its middle
    mass = posture.masses_beyond[link] - 0.5 * mechanism.masses[link]
    back = pose[:, :3, :3].swapaxes(1, 2)
    force = mass[:, None] * (back @ posture.gravity)
    along = root / length
    shift: Array = (force - (force @ along)[:, None] * along) * (length / shear)
    return shift


def _tip_twist(posture: Posture, link: int, bending: float, torsion: float) -> Array:
    """Return the twist (n, 6) of a beam's tip, the origin of its D-H frame, in that frame."""
    mechanism = posture.mechanism
    home = inverse(mechanism.frames[link + 1])
    root = transform_points(home, mechanism.frames[link, :3, 3])
    length = float(np.linalg.norm(root))
    if length == 0.0:
        return np.zeros((len(posture.q), 6))
    along = -root / length
    share = (np.arange(_SEGMENTS) + 0.5) / _SEGMENTS
    places = root * (1.0 - share)[:, None]  # the middles of the segments

    # the link's own mass: linear density along the beam that gives the correct centre of mass
    mass, center = mechanism.masses[link], transform_points(home, mechanism.centers[link])
    lean = float(np.clip((center - root) @ along / length - 0.5, -1 / 6, 1 / 6))
    masses = mass / _SEGMENTS * (1.0 + 12.0 * lean * (share - 0.5))
    beside = center - along * (center @ along)

    # first moment of everything beyond the tip, relative to it, in the link's own frame
    pose = posture.placements[link] @ mechanism.frames[link + 1]
    back = pose[:, :3, :3].swapaxes(1, 2)
    down = (back @ posture.gravity)[:, None]
    if link + 1 < len(mechanism.masses):
        beyond, weight = posture.first_moments[link + 1 :].sum(axis=0), posture.masses_beyond[link + 1]
    else:
        beyond, weight = posture.load_moment, posture.load_mass
    carried = (back @ (beyond - weight[:, None] * pose[:, :3, 3])[..., None])[..., 0]

    own_mass = np.cumsum(masses[::-1])[::-1] - 0.5 * masses
    own = np.cumsum((masses[:, None] * (places + beside))[::-1], axis=0)[::-1] - 0.5 * masses[:, None] * (
        places + beside
    )
    total = carried[:, None] + own - (weight[:, None] + own_mass)[..., None] * places
    moment = np.cross(total, down)
    axial = (moment @ along)[..., None] * along
    rotations = ((moment - axial) / bending + axial / torsion) * (length / _SEGMENTS)

    motions = rigid(np.concatenate([np.zeros_like(rotations), rotations], axis=-1))[..., :3, :3]
    tip, R = np.zeros((len(pose), 3)), np.broadcast_to(np.eye(3), (len(pose), 3, 3))
    for k in reversed(range(_SEGMENTS)):
        tip = places[k] + (motions[:, k] @ (tip - places[k])[..., None])[..., 0]
        R = motions[:, k] @ R
    vector = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.concatenate([tip, vector / np.sinc(np.arcsin(np.minimum(sine, 1.0)) / np.pi)], axis=1)


link_bending = by_law(
    slender=made(by(Bend, _bent), links=JOINTS, bending=STIFFNESSES, torsion=STIFFNESSES),
    shear=made(by(Bend, _bent), links=JOINTS, bending=STIFFNESSES, torsion=STIFFNESSES, shear=STIFFNESSES),
)
"""``links``: numbers from 1; for each ``bending`` EI and ``torsion`` GJ [Nm^2], or ``inf``.

With ``law`` shear also ``shear``, kappa G A of each [N].
"""
