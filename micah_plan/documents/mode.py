"""Modes and the transitions between them: the entries `modes` and `transitions` of a model file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from micah_plan.automaton.hybrid import Edge, Mode, Pin, Reset, Tie
from micah_plan.documents.expressions import Affine, Expression, RegionEntries
from micah_plan.documents.fields import (
    ITEMS,
    CoordinateName,
    Matrix,
    ModeName,
    Name,
    Place,
    Row,
    Std,
    StdOrZero,
    each,
)
from micah_plan.documents.joint import JointDocument, check_size
from micah_plan.documents.layout import Document, Scope, doc, unique
from micah_plan.documents.located import Located
from micah_plan.errors import InputError


class PinDocument(Document):
    value: Place = doc("Configuration at which the mode pins the coordinate [rad or m].")
    std: StdOrZero = doc("Standard deviation of that value [rad or m].")


class ModeDocument(Document):
    joints: Annotated[dict[Name, JointDocument], each("linked part", "joint")] = doc(
        "The joint of every link in this mode, by child part."
    )
    step: dict[CoordinateName, Expression] = doc(
        "Change of each coordinate in one step as an affine expression, e.g. `door: input door`, or `door: input door "
        "- 0.05` for a door that swings shut; a coordinate that is left out does not move. A constant is kept as the "
        "effect `bias` of that mode."
    )
    invariant: RegionEntries = doc("Half-spaces in all of which the mode's dynamics hold.")
    inputs: RegionEntries = doc("Half-spaces that admissible inputs lie in.", list)
    pins: dict[CoordinateName, PinDocument] = doc("Coordinates that the mode fixes, e.g. by a latch.", dict)
    ties: dict[CoordinateName, Expression] = doc(
        "Coordinates that follow others, as an affine expression of them, e.g. `theta: 0.9 - 6.8*z`: an angle that "
        "follows a height while an edge touches a table.",
        dict,
    )
    observation_std: Annotated[dict[CoordinateName, Std], ITEMS] = doc(
        "Std of one measurement in this mode, for coordinates with another one than under `noise`, at any place [rad "
        "or m].",
        dict,
    )

    def read(self, at: Located, scope: Scope) -> Mode:
        values, coordinates = self.meanings(at, scope), scope["coordinate"]
        rows = [(0.0,) * len(scope["input"]) for _ in coordinates]
        for i, change in values.pop("step").items():
            if any(change.a):
                remedy = "write inputs and a constant, such as 'input door' or '0.5*input door - 0.02'"
                raise at.at("step", coordinates[i]).error("a step is affine in the inputs", remedy)
            rows[i] = change.b
        for i, tie in values["ties"].items():
            if any(tie.b):
                problem = "a tie is about coordinates, not inputs"
                raise at.at("ties", coordinates[i]).error(problem, "write e.g. '0.9 - 6.8*z'")
        pins = tuple(Pin(i, **pin) for i, pin in values.pop("pins").items())
        ties = tuple(Tie(i, tie.a, tie.constant) for i, tie in values.pop("ties").items())
        return Mode(at.name, **values, input_matrix=tuple(rows), pins=pins, ties=ties)

    def drifts(self, at: Located, scope: Scope) -> dict[str, float]:
        """Drift of each coordinate per step without input [rad or m], where it is not 0."""
        steps = self.meaning("step", at, scope)
        return {scope["coordinate"][i]: change.constant for i, change in steps.items() if change.constant}

    @classmethod
    def written(cls, value: Mode, scope: Scope) -> Mapping[str, Any]:
        n, m = len(scope["coordinate"]), len(scope["input"])
        if value.B.shape != (n, m):
            raise InputError(f"automaton: mode '{value.name}' needs B {(n, m)}. Got {value.B.shape}")
        return {
            **vars(value),
            "step": {i: Affine((0.0,) * n, row) for i, row in enumerate(value.input_matrix) if any(row)},
            "pins": unique((pin.coordinate, pin) for pin in value.pins),
            "ties": unique((tie.coordinate, Affine(tie.weights, (0.0,) * m, float(tie.offset))) for tie in value.ties),
        }


class MatricesDocument(Document):
    makes = Reset

    A: Matrix | None = doc("(n, n); default: identity.", None)
    B: Matrix | None = doc("(n, m); default: zero.", None)
    c: Row | None = doc("(n); default: zero.", None)

    def meanings(self, at: Located, scope: Scope) -> dict[str, Any]:
        n, m = len(scope["coordinate"]), len(scope["input"])
        c = None if self.c is None else (self.c,)
        for key, rows, height, width in (("A", self.A, n, n), ("B", self.B, n, m), ("c", c, 1, n)):
            if rows is not None:
                check_size(rows, height, width, at.at(key))
        return super().meanings(at, scope)


class TransitionDocument(Document):
    source: ModeName = doc("Mode that it leaves.")
    target: ModeName = doc("Mode that it enters; the same as `source` for a clamp.")
    guard: RegionEntries = doc("Half-spaces that must all hold.")
    reset: dict[CoordinateName, Expression] = doc(
        "New value of a coordinate as an affine expression, e.g. `door: 1.2` or `door: door + 0.1`; a coordinate that"
        " is left out keeps its value.",
        dict,
    )
    reset_matrices: MatricesDocument | None = doc("The reset as x+ = A x + B u + c, instead of `reset`.", None)
    threshold_std: StdOrZero = doc(
        "How well the guard's thresholds on coordinates are known: their standard deviation [rad or m].", 0.0
    )

    def read(self, at: Located, scope: Scope) -> Edge:
        if self.reset and self.reset_matrices is not None:
            problem = "both 'reset' and 'reset_matrices' are given"
            raise at.at("reset_matrices").error(problem, "keep one of them")
        own = self.meanings(at, scope)
        values, matrices = own.pop("reset"), own.pop("reset_matrices")
        return Edge(**own, reset=_reset_of(values, scope) if matrices is None else matrices)

    @classmethod
    def written(cls, value: Edge, scope: Scope) -> Mapping[str, Any]:
        """The transition's data, with the reset as expressions where exact, else as matrices."""
        n, m = len(scope["coordinate"]), len(scope["input"])
        a, b, c = value.reset.matrices(n, m)
        if a.shape != (n, n) or b.shape != (n, m) or c.shape != (n,):
            raise InputError(f"automaton: a reset has matrices of sizes {a.shape}, {b.shape}, {c.shape}")
        values = {}
        for i, unmoved in enumerate(np.eye(n)):
            is_number = not (a[i].any() or b[i].any())
            if is_number or c[i] or b[i].any() or not np.array_equal(a[i], unmoved):
                values[i] = Affine(tuple(a[i].tolist()), tuple(b[i].tolist()), float(c[i]), is_number or bool(c[i]))
        is_exact = _reset_of(values, scope) == value.reset
        return {**vars(value), **({"reset": values} if is_exact else {"reset": {}, "reset_matrices": value.reset})}


def _reset_of(values: Mapping[int, Affine], scope: Scope) -> Reset:
    """The affine map of expressions; A, B and c are omitted where they are trivial."""
    if not values:
        return Reset()
    n, m = len(scope["coordinate"]), len(scope["input"])
    a, b, c = np.eye(n), np.zeros((n, m)), np.zeros(n)
    for i, value in values.items():
        a[i], b[i], c[i] = value.a, value.b, value.constant
    return Reset(
        None if np.array_equal(a, np.eye(n)) else tuple(map(tuple, a.tolist())),
        tuple(map(tuple, b.tolist())) if b.any() else None,
        tuple(c.tolist()) if any(value.has_constant for value in values.values()) else None,
    )
