"""Evaluate expressions that have the same value whenever the program runs.

A variable is constant if the whole program assigns it once, to such an expression, and no function has a parameter of
its name. Functions: ``pose_trans``, ``pose_inv``, ``pose_add``, ``d2r``, ``r2d`` (URScript Manual, module urmath).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cellapp.cell.programs.expressions import Call, Expression, Items, Name, Number, Operation
from cellapp.cell.programs.urscript import Program, Statement
from cellapp.ground.grouping import grouped
from cellapp.robot.kinematics.transforms import Array, invert, rotation_from_vector, rotation_vectors, transform

SIX = 6
_LONGEST_CHAIN = 40
_RUNNING = "is known only while the program runs"


class Unresolved(Exception):
    """The value is not constant; the text says why, as the end of a sentence."""


@dataclass(frozen=True, eq=False)
class Value:
    """Number, list of joint positions, or pose."""

    numbers: tuple[float, ...]
    pose: bool = False

    def T(self) -> Array:
        """Return the pose as a matrix (4, 4)."""
        return pose_matrix(self.numbers)


def pose_matrix(pose: Sequence[float]) -> Array:
    """Return the matrix (4, 4) of x, y, z [m] and a rotation vector [rad]."""
    return transform(rotation_from_vector(pose[3:]), pose[:3])


def pose_numbers(T: Array) -> tuple[float, ...]:
    """Return x, y, z [m] and rotation vector [rad] of a matrix (4, 4)."""
    return (*T[:3, 3].tolist(), *rotation_vectors(T[None, :3, :3])[0].tolist())


class Constants:
    """Constant variables of a program."""

    def __init__(self, program: Program) -> None:
        self._parameters = program.parameters
        self._assigned = grouped((name, one) for one in program.statements for name in _assigned_names(one))

    def definition(self, name: str) -> Expression:
        """Return the only expression that a variable is assigned. Raise ``Unresolved``."""
        if name in self._parameters:
            raise Unresolved(f"'{name}' is a parameter of a function")
        found = self._assigned.get(name, [])
        if not found:
            raise Unresolved(f"'{name}' is not assigned in this program")
        if len(found) > 1:
            lines = ", ".join(str(statement.line) for statement in found)
            raise Unresolved(f"'{name}' is assigned {len(found)} times (lines {lines})")
        if found[0].assigned != name or found[0].expression is None:
            raise Unresolved(f"what line {found[0].line} does to '{name}' cannot be read")
        return found[0].expression

    def value(self, expression: Expression, within: tuple[str, ...] = ()) -> Value:
        """Return the value of an expression. Raise ``Unresolved``."""
        match expression:
            case Number(value=value):
                return Value((value,))
            case Name(name=name):
                check_chain(name, within)
                return self.value(self.definition(name), (*within, name))
            case Items(items=items, pose=pose):
                return Value(tuple(self._number(item, within) for item in items), pose)
            case Operation(sign=sign, operands=operands):
                return _operation(sign, [self.value(operand, within) for operand in operands])
            case Call(function=function, arguments=arguments, named=named) if not named:
                return _call(function, [self.value(argument, within) for argument in arguments])
            case Call(function=function):
                raise Unresolved(f"{function}(...) {_RUNNING}")
        raise Unresolved(f"it {_RUNNING}")

    def _number(self, expression: Expression, within: tuple[str, ...]) -> float:
        numbers = self.value(expression, within).numbers
        if len(numbers) != 1:
            raise Unresolved("a list stands where a number is expected")
        return numbers[0]


def check_chain(name: str, within: Sequence[str]) -> None:
    """Raise ``Unresolved`` if a variable is in its own definition, or behind too many others."""
    if name in within:
        raise Unresolved(f"'{name}' is defined by itself")
    if len(within) > _LONGEST_CHAIN:
        raise Unresolved(f"'{name}' stands behind more than {_LONGEST_CHAIN} other variables")


# -- inside -----------------------------------------------------------------------------------------------------------


def _assigned_names(statement: Statement) -> list[str]:
    """Return the variables that a statement changes; if unreadable, it may change all names before its last '='."""
    if statement.expression is not None:
        return [statement.assigned] if statement.assigned else []
    words = statement.tokens
    equals = max((k for k, word in enumerate(words) if word.text == "="), default=0)
    return list(dict.fromkeys(word.text for word in words[:equals] if word.kind == "name"))


def _operation(sign: str, values: Sequence[Value]) -> Value:
    if any(len(value.numbers) != 1 for value in values):
        raise Unresolved(f"'{sign}' of lists or poses {_RUNNING}")
    numbers = [value.numbers[0] for value in values]
    match sign, numbers:
        case "-", [one]:
            return Value((-one,))
        case "+", [one]:
            return Value((one,))
        case "+", [one, other]:
            return Value((one + other,))
        case "-", [one, other]:
            return Value((one - other,))
        case "*", [one, other]:
            return Value((one * other,))
        case "/", [one, other] if other != 0.0:
            return Value((one / other,))
    raise Unresolved(f"'{sign}' is not evaluated")


def _call(function: str, values: Sequence[Value]) -> Value:
    if function in _OF_NUMBER and len(values) == 1 and len(values[0].numbers) == 1:
        return Value((_OF_NUMBER[function](values[0].numbers[0]),))
    poses = [value for value in values if value.pose and len(value.numbers) == SIX]
    if function in _OF_POSES and len(values) == len(poses) == _OF_POSES[function]:
        return Value(pose_numbers(_of_poses(function, [pose.T() for pose in poses])), pose=True)
    raise Unresolved(f"{function}(...) {_RUNNING}")


_OF_NUMBER = {"d2r": math.radians, "r2d": math.degrees}
_OF_POSES: Mapping[str, int] = {"pose_trans": 2, "pose_add": 2, "pose_inv": 1}


def _of_poses(function: str, poses: Sequence[Array]) -> Array:
    if function == "pose_inv":
        return invert(poses[0])
    first, second = poses
    if function == "pose_trans":
        return np.asarray(first @ second)
    return transform(first[:3, :3] @ second[:3, :3], first[:3, 3] + second[:3, 3])  # pose_add
