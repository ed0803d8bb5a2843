"""Models of one arm (chain, effects, network) and of the cell (arms, inter-base transform), and their JSON file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from cellapp.ground.counting import counted
from cellapp.ground.errors import InputError
from cellapp.ground.file_text import file_text
from cellapp.ground.grouping import grouped
from cellapp.ground.profile import Profile
from cellapp.ground.results import plain_data
from cellapp.robot.effects import (
    EFFECTS,
    Displacement,
    EffectColumn,
    EffectContext,
    EffectTerm,
    InputVariable,
    MeasurementConditions,
    displacement,
    term_from_json,
    term_to_json,
)
from cellapp.robot.effects.effect import ordered_columns
from cellapp.robot.kinematics.chain import (
    BASE_NAMES,
    PROBE_NAMES,
    Geometry,
    JointAngles,
    base_twists,
    flange_poses,
    jacobian,
    joint_jacobian,
    parameter_unit,
    probe_rotations,
    smr_positions,
)
from cellapp.robot.kinematics.statics import Bodies, base_moment
from cellapp.robot.kinematics.transforms import Array
from cellapp.robot.model.arguments import configurations, of_arm, require_radians
from cellapp.robot.model.nominal import bodies_of, up_in_tracker

# -- Residual network of an arm model: evaluation with numpy alone, and its JSON form ---------------------------------
#
# A committee of small multilayer perceptrons (tanh, linear output) maps joint positions to the residual of the SMR
# position. The mean of the members is the correction, their standard deviation its uncertainty. Outside the trained
# joint ranges the correction fades to zero over a margin, because a network does not extrapolate.

Inputs = Literal["angles", "sincos", "both"]
Layers = tuple[tuple[Array, Array], ...]


@dataclass(frozen=True)
class ResidualNetwork:
    """A trained committee.

    Attributes
    ----------
    inputs : str
        ``angles`` scaled to the trained ranges, ``sincos``, or ``both``.
    low, high : array, shape (N,)
        Trained joint ranges [rad].
    margin : array, shape (N,)
        Distance outside the ranges over which the correction fades to zero [rad].
    rotates_with_joint_1 : bool
        Whether the members' output frame rotates with joint 1 about z. Effects of gravity and gears do not depend on
        joint 1 in that frame. The correction is rotated back.
    scale : float
        Scale of the outputs [m].
    members : tuple of layers
        For each member and layer: weights (out, in) and offsets (out,).
    rotation : ResidualNetwork or None
        Correction of the flange's rotation in the same frame, as rotation vectors [rad]; None where positions alone
        were measured, or it did not help.
    """

    inputs: Inputs
    low: Array
    high: Array
    margin: Array
    rotates_with_joint_1: bool
    scale: float
    members: tuple[Layers, ...]
    rotation: ResidualNetwork | None = None

    def correct(self, q: Array) -> Array:
        """Compute the correction (n, 3) [m] of SMR positions at ``q`` (n, N) [rad], in the frame of its training."""
        correction = self._each(q).mean(axis=0) * self._fade(q)
        return rotate_about_z(correction, q[:, 0]) if self.rotates_with_joint_1 else np.asarray(correction)

    def spread(self, q: Array) -> Array:
        """Compute the standard deviation (n, 3) [m] of the members at ``q`` (n, N) [rad]."""
        each = self._each(q)
        if self.rotates_with_joint_1:
            each = np.array([rotate_about_z(member, q[:, 0]) for member in each])
        return np.asarray(each.std(axis=0, ddof=1) * self._fade(q))

    def _each(self, q: Array) -> Array:
        x = network_inputs(self.inputs, self.low, self.high, q)
        outputs = []
        for layers in self.members:
            y = x
            for weights, offsets in layers[:-1]:
                y = np.tanh(y @ weights.T + offsets)
            weights, offsets = layers[-1]
            outputs.append(y @ weights.T + offsets)
        return np.asarray(outputs) * self.scale

    def _fade(self, q: Array) -> Array:
        beyond = np.maximum(np.maximum(self.low - q, q - self.high), 0.0) / self.margin
        each = np.where(beyond < 1.0, 0.5 * (1.0 + np.cos(np.pi * np.minimum(beyond, 1.0))), 0.0)
        return np.asarray(each.prod(axis=1)[:, None])


def network_to_json(network: ResidualNetwork) -> dict[str, Any]:
    """Convert a network to a JSON object; floats are exact."""
    content = plain_data(vars(network))
    content["turning_with_joint_1"], content["scale_m"] = content.pop("rotates_with_joint_1"), content.pop("scale")
    members = [[{"weights": one, "offsets": other} for one, other in layers] for layers in content.pop("members")]
    del content["rotation"]
    rotation = {} if network.rotation is None else {"turning": network_to_json(network.rotation)}
    return {**content, "activation": "tanh", "members": members, **rotation}


def network_from_json(content: Mapping[str, Any]) -> ResidualNetwork:
    """Parse an object from ``network_to_json``; raise ``KeyError``, ``ValueError`` or ``TypeError`` for others."""
    if content["inputs"] not in get_args(Inputs) or content["activation"] != "tanh":
        raise ValueError(f"unknown inputs '{content['inputs']}' or activation '{content['activation']}' of the network")
    members = [[(_array(one["weights"]), _array(one["offsets"])) for one in layers] for layers in content["members"]]
    low, high, margin = (_array(content[name]) for name in ("low", "high", "margin"))
    return ResidualNetwork(
        content["inputs"],
        low,
        high,
        margin,
        rotates_with_joint_1=bool(content["turning_with_joint_1"]),
        scale=float(content["scale_m"]),
        members=tuple(tuple(one) for one in members),
        rotation=network_from_json(content["turning"]) if "turning" in content else None,
    )


def _array(value: Any) -> Array:
    return np.array(value, dtype=np.float64)


def rotate_about_z(vectors: Array, angles: Array) -> Array:
    """Rotate vectors (n, 3) about z by ``angles`` (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def network_inputs(kind: Inputs, low: Array, high: Array, q: Array) -> Array:
    """Compute inputs of the first layer from ``q`` (n, N) [rad], by ``kind``: angles scaled to [-1, 1], (n, N), cosines
    and sines, (n, 2 N), or both in this order."""
    parts = []
    if kind != "sincos":
        parts.append((q - 0.5 * (low + high)) / np.maximum(0.5 * (high - low), 1e-9))
    if kind != "angles":
        parts += [np.cos(q), np.sin(q)]
    return np.hstack(parts)


Signs = NDArray[np.float64] | NDArray[np.int8]
MODEL_SCHEMA = "cellapp-calibration"
_VERSION = 1
_AT_ONCE = 4096
"""Configurations per batch of effect columns: 1000 columns of a batch take 32 MB."""


@dataclass(frozen=True, repr=False)
class ArmModel:
    """Calibrated model of one arm.

    Attributes
    ----------
    geometry : Geometry
        The identified chain; its base is in the tracker frame.
    nominal : Geometry
        The published chain with its base registered to the same data.
    bodies : Bodies
        Masses and centres of mass for gravity torques.
    up_M : array, shape (3,)
        Unit vector against gravity in the tracker frame.
    effects : tuple of EffectTerm
        Effects that discovery found.
    network : ResidualNetwork or None
        Correction of the residual pose that geometry and effects leave, in the base frame B.
    identified : tuple of str, length k
        Names of the identified parameters, effects last.
    covariance : array, shape (k, k), or None
        Covariance of the identified parameters in their units. If an effect is a free curve, it covers the geometry and
        the effects before that curve only.
    smr_normal : array, shape (3,), or None
        SMR viewing direction in the flange frame.
    posterior : PosteriorSamples or None
        Uncertainty of geometry and effects, as samples.
    """

    geometry: Geometry
    nominal: Geometry
    bodies: Bodies
    up_M: Array
    effects: tuple[EffectTerm, ...] = ()
    network: ResidualNetwork | None = None
    identified: tuple[str, ...] = ()
    covariance: Array | None = None
    smr_normal: Array | None = None
    posterior: PosteriorSamples | None = None

    @classmethod
    def of(
        cls,
        profile: Profile,
        name: str,
        geometry: Geometry,
        nominal: Geometry,
        identified: tuple[str, ...] = (),
        covariance: Array | None = None,
    ) -> ArmModel:
        """Return an arm of a profile without effects."""
        arm = profile.arms[name]
        normal = np.array(arm.smr.normal, dtype=np.float64)
        bodies, up_M = bodies_of(arm), up_in_tracker(profile)
        return cls(geometry, nominal, bodies, up_M, identified=identified, covariance=covariance, smr_normal=normal)

    def __repr__(self) -> str:
        effects = ", ".join(dict.fromkeys(term.slug for term in self.effects)) or "none"
        return (
            f"ArmModel({self.geometry.joints} joints, {counted(len(self.identified), 'parameter')}, effects:"
            f" {effects:.100})"
        )

    def beside(
        self, conditions: MeasurementConditions, q: Array, payload_kg: Array | None = None
    ) -> MeasurementConditions:
        """Return n conditions of another arm with this one beside it at ``q`` (n, N) [rad], with payloads (n,) [kg]."""
        moment = base_moment(self.geometry, self.bodies, q, self.up_M, payload_kg)
        return replace(conditions, other_q=q, other_moment_M=moment)

    def context(self, q: Array, conditions: MeasurementConditions | None = None) -> EffectContext:
        """Return the variables that effects depend on, at configurations ``q`` (n, N) [rad]."""
        return EffectContext(
            q=q,
            conditions=conditions or MeasurementConditions(),
            geometry=self.geometry,
            bodies=self.bodies,
            up_M=self.up_M,
            smr_normal=self.smr_normal,
        )

    def effect_displacement(self, q: Array, conditions: MeasurementConditions) -> Displacement:
        """Compute the displacement by all effects of the model at controller readings ``q`` (n, N) [rad]."""
        if len(q) > _AT_ONCE:
            chunks = np.array_split(np.arange(len(q)), -(-len(q) // _AT_ONCE))
            parts = [self.effect_displacement(q[rows], conditions.take(rows)) for rows in chunks]
            return Displacement(*map(np.concatenate, zip(*((one.joints, one.shift_M) for one in parts), strict=True)))
        context = self.context(q, conditions)
        each = [displacement([term], EFFECTS, context) for term in self.effects]
        moved = Displacement.total(each, len(context), q.shape[1])
        if not moved.joints.any():
            return moved
        # Gravity acts at the actual joint positions, a few mrad off: the loads change by some parts in a thousand.
        # Effects that depend on joint readings only and do not shift the SMR are not recomputed.
        actual = replace(context, q_actual=q + moved.joints)
        again = [
            one
            if EFFECTS[term.slug].variables == {InputVariable.JOINT_ANGLE} and not one.shift_M.any()
            else displacement([term], EFFECTS, actual)
            for term, one in zip(self.effects, each, strict=True)
        ]
        return Displacement.total(again, len(context), q.shape[1])

    def true_joints(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Compute true joint positions (n, N) [rad] at controller readings ``q`` (n, N) [rad]; see ``predict``."""
        q, conditions = configurations(q, self.geometry.joints), conditions or MeasurementConditions()
        return q if not self.effects else q + self.effect_displacement(q, conditions).joints

    def predict(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Predict SMR positions (n, 3) in the tracker frame [m] at controller readings ``q`` (n, N) [rad].

        ``conditions`` are the sides of approach, payloads, times, temperatures and the state of the other arm, as far
        as they are known. Rows with a measured orientation return the rotation vector from it to the computed one [rad]
        instead. Raise ``InputError`` if ``q`` has another shape.
        """
        q, conditions = configurations(q, self.geometry.joints), conditions or MeasurementConditions()
        if self.effects:
            moved = self.effect_displacement(q, conditions)
            p_M = smr_positions(self.geometry, q + moved.joints, conditions.R_M_S) + moved.shift_M
        else:
            p_M = smr_positions(self.geometry, q, conditions.R_M_S)
        if self.network is None:
            return p_M
        correction_M = self.network.correct(q) @ self.geometry.T_M_B()[:3, :3].T
        if conditions.angular is not None:
            correction_M[conditions.angular] = self.angles_M(q[conditions.angular])
        return np.asarray(p_M + correction_M)

    def orientation(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Predict rotations (n, 3, 3) of the probe in the tracker frame at controller readings ``q`` (n, N) [rad].

        If the model has no probe, these are rotations of the flange.
        """
        q = configurations(q, self.geometry.joints)
        rotations = probe_rotations(self.geometry, self.true_joints(q, conditions=conditions))
        return self.rotations(q, conditions) @ rotations if self.rotates_flange else rotations

    @property
    def rotates_flange(self) -> bool:
        """Whether effects or the network may turn the flange."""
        return bool(self.effects) or (self.network is not None and self.network.rotation is not None)

    def angles_M(self, q: Array) -> Array:
        """Return the network's rotation vectors (n, 3) [rad] of the flange in the tracker frame."""
        if self.network is None or self.network.rotation is None:
            return np.zeros((len(q), 3))
        return np.asarray(self.network.rotation.correct(q) @ self.geometry.T_M_B()[:3, :3].T)

    def rotations(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Compute flange rotations (n, 3, 3), in the tracker frame, by deflection of links, bearings and base, and by
        the network."""
        rotated = replace(conditions or MeasurementConditions(), R_M_S=np.tile(np.eye(3), (len(q), 1, 1)))
        angle_M = self.effect_displacement(q, rotated).shift_M + self.angles_M(q)  # both are milliradians
        return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(angle_M).as_matrix())

    def uncertainty(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Compute the standard deviation (n,) [m] of a predicted coordinate at ``q`` (n, N) [rad], without noise.

        It is the rms over the three coordinates and includes geometry, effects and network; zero if the model has
        neither samples nor a network. It grows outside the trained joint ranges. For a measured orientation it is that
        of a component of the rotation [rad].
        """
        q = configurations(q, self.geometry.joints)
        variance = np.zeros(len(q))
        angular = None if conditions is None else conditions.angular
        if self.posterior is not None:
            moved = self.posterior.displacements(self.geometry, self.effects, self.context(q, conditions=conditions))
            variance += np.mean(moved**2, axis=(0, 2))
        if self.network is not None:
            of_network = np.mean(self.network.spread(q) ** 2, axis=1)
            rotation = self.network.rotation
            of_rotations = 0.0 if angular is None or rotation is None else np.mean(rotation.spread(q) ** 2, axis=1)
            variance += of_network if angular is None else np.where(angular, of_rotations, of_network)
        return np.asarray(np.sqrt(variance))

    def measured_uncertainty(self, q: Array, conditions: MeasurementConditions | None = None) -> Array:
        """Compute the standard deviation (n,) [m] of a measured coordinate about its prediction: model and noise.

        For a measured orientation it is that of a component of the rotation [rad].
        """
        noise = self.noise(q)
        if conditions is not None and conditions.angular is not None:
            of_rotations = None if self.posterior is None else self.posterior.noise.rad
            noise[conditions.angular] = of_rotations or 0.0
        return np.asarray(np.hypot(self.uncertainty(q, conditions), noise))

    def noise(self, q: Array) -> Array:
        """Compute the standard deviation (n,) [m] of a measured coordinate about the true one at ``q`` (n, N) [rad].

        It depends on the configuration where the scatter of the joints is known; zero if the model has no samples.
        """
        q = configurations(q, self.geometry.joints)
        if self.posterior is None:
            return np.zeros(len(q))
        if self.posterior.noise.parts is None:
            return np.full(len(q), self.posterior.noise.m)
        own_m, *joints_rad = self.posterior.noise.parts
        _, by_joint = joint_jacobian(self.geometry, JointAngles.of(q))
        return np.asarray(np.sqrt(own_m**2 + np.einsum("cjn,j->n", by_joint**2, np.square(joints_rad)) / 3.0))

    def flange(self, q: Array, conditions: MeasurementConditions | None = None) -> tuple[Array, Array]:
        """Compute flange rotations (n, 3, 3) and origins (n, 3) [m] in the tracker frame.

        Rotations include ``rotations`` only if the model has a probe: only measured orientations can confirm them.
        """
        rotations, origins = flange_poses(self.geometry, self.true_joints(q, conditions=conditions))
        if self.geometry.probe is None or not self.rotates_flange:
            return rotations, origins
        return self.rotations(q, conditions) @ rotations, origins

    def of_positions(self) -> ArmModel:
        """Return the arm without the rotation of a probe, for positions alone."""
        if self.geometry.probe is None:
            return self
        kept = [place for place, name in enumerate(self.identified) if name not in PROBE_NAMES]
        return replace(
            self,
            geometry=replace(self.geometry, probe=None),
            nominal=replace(self.nominal, probe=None),
            identified=tuple(self.identified[place] for place in kept),
            covariance=None if self.covariance is None else self.covariance[np.ix_(kept, kept)],
            posterior=None if self.posterior is None else self.posterior.of_columns(len(self.geometry.vector()) - 3),
        )


@dataclass(frozen=True, repr=False)
class CellModel:
    """The calibrated cell.

    Attributes
    ----------
    arms : mapping
        Name -> ArmModel.
    T_R_L : array, shape (4, 4), or None
        Maps coordinates in the base frame of ``pair[0]`` (left) to that of ``pair[1]`` (right).
    pair : tuple of two names, or None
    provenance : mapping
        Profile, seed, time and versions of the programs that made the model.
    T_M_M0 : array, shape (4, 4), or None
        Maps the tracker frame of the station where the readings were taken (``tracker.pose`` of the profile) into the
        tracker frame M of this model. None if the tracker has not been moved.
    """

    arms: Mapping[str, ArmModel]
    T_R_L: Array | None = None
    pair: tuple[str, str] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    T_M_M0: Array | None = None

    def __repr__(self) -> str:
        arms = ", ".join(f"{name}: {arm.geometry.joints} joints" for name, arm in self.arms.items())
        return f"CellModel({arms:.150})"

    def other(self, arm: str) -> ArmModel | None:
        """Return the other arm of a cell of two; None in other cells."""
        others = [other for name, other in self.arms.items() if name != arm]
        return others[0] if len(others) == 1 else None

    def predict(
        self,
        arm: str,
        q: ArrayLike,
        approach: Signs | None = None,
        payload_kg: Array | None = None,
        conditions: MeasurementConditions | None = None,
    ) -> Array:
        """Predict SMR positions (n, 3) of one arm in the tracker frame [m] at joint positions ``q`` (n, N) [rad].

        Raises
        ------
        InputError
            If there is no such arm, or ``q`` has another shape or seems to be in degrees.
        """
        model = of_arm(self.arms, arm, "this model")
        q = configurations(q, model.geometry.joints, arm)
        require_radians(q, arm)
        conditions = conditions or MeasurementConditions(approach=approach, payload_kg=payload_kg)
        return model.predict(q, conditions=conditions)

    def to_json(self) -> str:
        """Return JSON text with floats in their shortest exact form."""
        station = {} if self.T_M_M0 is None else {"T_M_M0": self.T_M_M0.tolist()}
        return json.dumps(
            {
                "schema": MODEL_SCHEMA,
                "version": _VERSION,
                "units": "m, rad, kg; T_A_B maps coordinates of B into A; M tracker, B base",
                "provenance": dict(self.provenance),
                "arms": {name: _arm_to_json(arm) for name, arm in self.arms.items()},
                "pair": None
                if self.pair is None or self.T_R_L is None
                else {"arms": list(self.pair), "T_second_first": self.T_R_L.tolist()},
                **station,
            },
            indent=1,
        )

    @classmethod
    def from_json(cls, text: str, where: str = "calibration") -> CellModel:
        """Parse text from ``to_json``; raise ``InputError``, which begins with ``where``, for anything else."""
        try:
            content = json.loads(text)
        except json.JSONDecodeError as error:
            raise InputError(f"{where}:{error.lineno}: not JSON; make it again with 'cellapp calibrate DIR'") from None
        if not isinstance(content, dict) or content.get("schema") != MODEL_SCHEMA:
            raise InputError(f'{where}: expected a file with "schema": "{MODEL_SCHEMA}"')
        if content.get("version") != _VERSION:
            raise InputError(
                f"{where}: version {content.get('version')} is not {_VERSION}, which this program reads; update cellapp"
            )
        try:
            pair = content["pair"]
            return cls(
                arms={name: _arm_from_json(arm) for name, arm in content["arms"].items()},
                T_R_L=None if pair is None else np.array(pair["T_second_first"], dtype=np.float64),
                pair=None if pair is None else (pair["arms"][0], pair["arms"][1]),
                provenance=content["provenance"],
                T_M_M0=np.array(content["T_M_M0"], dtype=np.float64).reshape(4, 4) if "T_M_M0" in content else None,
            )
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise InputError(
                f"{where}: incomplete or damaged ({error}); make it again with 'cellapp calibrate DIR'"
            ) from None

    def save(self, path: Path) -> None:
        """Write the file atomically: a reader finds the old or the new file, never a partial one."""
        partial = path.with_name(path.name + ".part")
        partial.write_text(self.to_json() + "\n", encoding="utf-8")
        partial.replace(path)

    @classmethod
    def load(cls, path: Path | str) -> CellModel:
        """Read a calibration file; raise ``InputError`` if it is missing, damaged or of another version."""
        return cls.from_json(file_text(Path(path), "run 'cellapp calibrate DIR' first"), str(path))


def _geometry_to_json(geometry: Geometry) -> dict[str, Any]:
    return {
        "parameters": dict(zip(geometry.names, geometry.vector().tolist(), strict=True)),
        "base_z_is_tracker_axis": "xyz"[geometry.reference_axis],
        "T_M_B": geometry.T_M_B().tolist(),
        **({"tied": plain_data(geometry.tied)} if geometry.tied else {}),
        **({"bounds": plain_data(geometry.bounds)} if geometry.bounds else {}),
    }


def _geometry_from_json(content: Mapping[str, Any]) -> Geometry:
    vector = np.array(list(content["parameters"].values()), dtype=np.float64)
    has_probe = PROBE_NAMES[0] in content["parameters"]
    joints, remainder = divmod(len(vector) - (12 if has_probe else 9), 5)
    geometry = Geometry(
        base=np.zeros(6),
        rows=np.zeros((joints, 5)),
        tool=np.zeros(3),
        reference_axis="xyz".index(content["base_z_is_tracker_axis"]),
        probe=np.zeros(3) if has_probe else None,
        tied=tuple(tuple(group) for group in content.get("tied", ())),
        bounds={name: (low, high) for name, (low, high) in content.get("bounds", {}).items()},
    )
    if remainder or tuple(content["parameters"]) != geometry.names:
        raise ValueError("the parameters are not those of a chain")
    return geometry.with_vector(vector)


def _arm_to_json(arm: ArmModel) -> dict[str, Any]:
    names = arm.geometry.names
    delta = arm.geometry.vector() - arm.nominal.vector()
    return {
        "geometry": _geometry_to_json(arm.geometry),
        "nominal": _geometry_to_json(arm.nominal),
        "deltas": {
            name: {"value": value, "unit": parameter_unit(name)}
            for name, value in zip(names, delta.tolist(), strict=True)
            if value != 0.0
        },
        "bodies": plain_data(vars(arm.bodies)),
        "up_M": arm.up_M.tolist(),
        "effects": [term_to_json(term) for term in arm.effects],
        "network": None if arm.network is None else network_to_json(arm.network),
        "identified": list(arm.identified),
        "covariance": plain_data(arm.covariance),
        "smr_normal": plain_data(arm.smr_normal),
        "posterior": None if arm.posterior is None else posterior_to_json(arm.posterior),
    }


def _arm_from_json(content: Mapping[str, Any]) -> ArmModel:
    bodies = content["bodies"]
    return ArmModel(
        geometry=_geometry_from_json(content["geometry"]),
        nominal=_geometry_from_json(content["nominal"]),
        bodies=Bodies(
            _array(bodies["masses"]),
            _array(bodies["centers"]).reshape(-1, 3),
            float(bodies["payload_mass"]),
            _array(bodies["payload_center"]),
        ),
        up_M=_array(content["up_M"]),
        effects=tuple(term_from_json(entry, EFFECTS) for entry in content["effects"]),
        network=None if content["network"] is None else network_from_json(content["network"]),
        identified=tuple(content["identified"]),
        covariance=None if content["covariance"] is None else _array(content["covariance"]),
        smr_normal=None if content.get("smr_normal") is None else _array(content["smr_normal"]).reshape(3),
        posterior=None if content.get("posterior") is None else posterior_from_json(content["posterior"]),
    )


# -- Express a calibrated cell in the tracker frame of a new station, after the tracker was moved ---------------------
#
# Geometry, effects and networks of the arms stay; their bases and the direction of gravity are expressed in the new
# tracker frame. The uncertainty of the new station is the same for all arms: it is added to the samples of each arm's
# base.


_BASE = tuple(range(len(BASE_NAMES)))


def relocated(model: CellModel, T_new_old: Array, twists: Array | None = None) -> CellModel:
    """Return the cell in the new tracker frame; ``T_new_old`` (4, 4) maps coordinates of the old frame into the new.

    ``twists`` (S, 6) are samples of the error of ``T_new_old``, one per sample of the arms' posteriors: shift of the
    point at the new origin [m], then rotation [rad], both in the new frame. Arms without samples get none.
    """
    station = T_new_old if model.T_M_M0 is None else T_new_old @ model.T_M_M0
    arms = {name: _relocated_arm(arm, T_new_old, twists) for name, arm in model.arms.items()}
    return replace(model, arms=arms, T_M_M0=station)


def _relocated_arm(arm: ArmModel, T: Array, twists: Array | None) -> ArmModel:
    geometry = arm.geometry.with_T_M_B(T @ arm.geometry.T_M_B())
    to_parameters: Array = np.asarray(np.linalg.inv(base_twists(geometry)), dtype=np.float64)
    base_map = to_parameters @ _adjoint(T) @ base_twists(arm.geometry)
    added = None if twists is None else twists @ to_parameters.T
    return replace(
        arm,
        geometry=geometry,
        nominal=arm.nominal.with_T_M_B(T @ arm.nominal.T_M_B()),
        up_M=T[:3, :3] @ arm.up_M,
        covariance=_relocated_covariance(arm, base_map, added),
        posterior=None if arm.posterior is None else _relocated_samples(arm.posterior, base_map, added),
    )


def _relocated_covariance(arm: ArmModel, base_map: Array, added: Array | None) -> Array | None:
    """Transform the covariance of the identified parameters; None if the base was not identified completely.

    The station's part is added as uncorrelated; only the samples keep its correlation with the arm's own parameters.
    """
    if arm.covariance is None or not set(BASE_NAMES) <= set(arm.identified):
        return None
    rows = [arm.identified.index(name) for name in BASE_NAMES]
    whole = np.eye(len(arm.covariance))
    whole[np.ix_(rows, rows)] = base_map
    covariance = whole @ arm.covariance @ whole.T
    if added is not None:
        covariance[np.ix_(rows, rows)] += added.T @ added / len(added)
    return np.asarray(covariance)


def _relocated_samples(posterior: PosteriorSamples, base_map: Array, added: Array | None) -> PosteriorSamples:
    columns = (*_BASE, *(column for column in posterior.columns if column not in _BASE))
    sampled = dict(zip(posterior.columns, posterior.geometry.T, strict=True))
    none = np.zeros(len(posterior.geometry))
    base = np.stack([sampled.get(column, none) for column in _BASE], axis=1) @ base_map.T
    if added is not None:
        base = base + added
    others = [sampled[column][:, None] for column in columns[len(_BASE) :]]
    return replace(posterior, columns=columns, geometry=np.concatenate([base, *others], axis=1))


def _adjoint(T: Array) -> Array:
    """Return the matrix (6, 6) that maps a twist (v, w) into another frame; v is the velocity at the frame's origin."""
    rotation, (x, y, z) = T[:3, :3], T[:3, 3].tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    whole = np.zeros((6, 6))
    whole[:3, :3] = whole[3:, 3:] = rotation
    whole[:3, 3:] = cross @ rotation
    return whole


# -- Uncertainty of predictions from samples of all fitted parameters about their estimate ----------------------------
#
# The posterior of geometry and effects is close to normal, but with smooth functions its covariance has a million
# entries. S samples of the parameters keep all correlations and give the standard deviation of any prediction with a
# relative error of 1 / sqrt(2 S): 9 % with 64. With up to S parameters the samples are made orthogonal, so that their
# second moment is exactly the covariance.

SAMPLES = 64
_DIGITS = 4
"""Significant digits of a sample in JSON: more than enough, as the scatter is known to one digit."""


class ReadingsNoise(NamedTuple):
    """Standard deviations of measured coordinates about the true predictions.

    ``m`` is that of a coordinate [m], ``rad`` that of a component of an orientation [rad], None if none was measured.
    ``axes_rad`` (3,) are those about the three axes in ascending order if they differ, as with several SMRs on a
    flange; else None. ``parts`` (1 + N,) are the readings' own part of ``m`` [m] and that of each joint's position
    [rad], if these are known.
    """

    m: float
    rad: float | None = None
    axes_rad: Array | None = None
    parts: Array | None = None


@dataclass(frozen=True, eq=False)
class PosteriorSamples:
    """Deviations of the fitted parameters from their estimate in S samples, and the scatter of the readings.

    Attributes
    ----------
    columns : tuple of int, length K
        Geometric parameters, as indices into ``parameter_names``.
    geometry : array, shape (S, K)
        Deviations of the geometric parameters, in their units.
    terms : tuple of array, shape (S, m)
        Deviations of the parameters of each term of the model, in the order of the term's names.
    noise : ReadingsNoise
    """

    columns: tuple[int, ...]
    geometry: Array
    terms: tuple[Array, ...]
    noise: ReadingsNoise

    @classmethod
    def of_covariance(
        cls,
        columns: tuple[int, ...],
        sizes: Sequence[int],
        covariance: Array,
        noise: ReadingsNoise,
        seed: Sequence[int],
        tied: Sequence[tuple[int, int]] = (),
    ) -> PosteriorSamples:
        """Sample from ``covariance`` (p, p) of K geometric parameters and of terms with ``sizes`` parameters.

        Further geometric parameters are ``tied``, each to one of ``columns``.
        """
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        correlation = covariance / scale / scale[:, None]
        root, failed = scipy.linalg.lapack.dpotrf(correlation, lower=1)
        if failed or len(scale) <= SAMPLES:
            values, vectors = np.linalg.eigh(correlation)
            root = vectors * np.sqrt(np.maximum(values, 0.0))
        normal = np.random.default_rng(seed).standard_normal((SAMPLES, len(scale)))
        if len(scale) <= SAMPLES:
            normal = math.sqrt(SAMPLES) * np.linalg.qr(normal)[0]
        sampled = (normal @ root.T) * scale
        ends = np.cumsum([len(columns), *sizes])
        parts = np.split(sampled, ends[:-1], axis=1)
        geometry = parts[0][:, [*range(len(columns)), *(columns.index(first) for _, first in tied)]]
        return cls((*columns, *(column for column, _ in tied)), geometry, tuple(parts[1:]), noise)

    def of_columns(self, end: int) -> PosteriorSamples:
        """Keep the samples of geometric parameters before ``end`` and of all terms; drop the noise of orientations."""
        kept = [place for place, column in enumerate(self.columns) if column < end]
        columns = tuple(self.columns[place] for place in kept)
        noise = self.noise._replace(rad=None, axes_rad=None)
        return replace(self, columns=columns, geometry=self.geometry[:, kept], noise=noise)

    def displacements(self, geometry: Geometry, terms: Sequence[EffectTerm], context: EffectContext) -> Array:
        """Compute deviations (S, n, 3) of SMR [m] or orientation [rad] from the prediction, to first order."""
        by_geometry, by_terms = self.displacements_by_part(geometry, terms, context)
        return by_geometry + by_terms

    def displacements_by_part(
        self, geometry: Geometry, terms: Sequence[EffectTerm], context: EffectContext
    ) -> tuple[Array, Array]:
        """Compute deviations (S, n, 3) [m] of the SMR by geometric parameters and by terms; their sum is the total."""
        angles = JointAngles.of(context.q, context.conditions.R_M_S)
        _, J = jacobian(geometry, angles, self.columns)
        _, by_joint = joint_jacobian(geometry, angles)
        by_geometry = np.einsum("sk,ckn->snc", self.geometry, J, optimize=True)
        moved = np.zeros_like(by_geometry)
        joints = np.zeros((len(self.geometry), *context.q.shape))
        for term, sampled in zip(terms, self.terms, strict=True):
            _add(joints, moved, ordered_columns(term, EFFECTS, context), sampled)
        moved += np.einsum("snj,cjn->snc", joints, by_joint, optimize=True)
        return np.asarray(by_geometry), moved


def _add(joints: Array, moved: Array, columns: Sequence[EffectColumn], sampled: Array) -> None:
    """Add joint offsets (S, n, N) and shifts (S, n, 3) of columns with sampled values (S, m)."""
    for joint, own in grouped((column.joint, k) for k, column in enumerate(columns)).items():
        if joint is None:
            moved += np.tensordot(sampled[:, own], np.array([columns[k].shift_M for k in own]), axes=1)
        else:
            joints[:, :, joint] += sampled[:, own] @ np.array([columns[k].offset for k in own])


def posterior_to_json(posterior: PosteriorSamples) -> dict[str, Any]:
    """Convert samples to a JSON object, rounded."""
    return {
        "columns": list(posterior.columns),
        "geometry": _rounded(posterior.geometry),
        "terms": [_rounded(one) for one in posterior.terms],
        **{f"noise_{key}": plain_data(value) for key, value in posterior.noise._asdict().items() if value is not None},
    }


def posterior_from_json(content: Mapping[str, Any]) -> PosteriorSamples:
    """Parse an object from ``posterior_to_json``."""
    geometry = _array(content["geometry"])
    terms = tuple(_array(one).reshape(len(geometry), -1) for one in content["terms"])
    noise = {key: content[f"noise_{key}"] for key in ReadingsNoise._fields if f"noise_{key}" in content}
    stated: dict[str, Any] = {key: _array(one) if isinstance(one, list) else float(one) for key, one in noise.items()}
    return PosteriorSamples(tuple(content["columns"]), geometry, terms, ReadingsNoise(**stated))


def _rounded(values: Array) -> list[list[float]]:
    return [[float(f"{value:.{_DIGITS}g}") for value in row] for row in values.tolist()]
