"""Transitions with their guards and resets: the entries `transitions` of a model file."""

from __future__ import annotations

from typing import Any

import numpy as np

from micah_plan.automaton.hybrid import Edge, Reset
from micah_plan.documents.expressions import (
    Expression,
    RegionEntries,
    Variables,
    affine_of,
    affine_text,
    parse_affine,
    region_data,
    region_of,
)
from micah_plan.documents.joint import check_size
from micah_plan.documents.layout import Document, Matrix, Name, NonNegative, Row, doc, plain
from micah_plan.documents.located import Located
from micah_plan.errors import InputError


class MatricesDocument(Document):
    A: Matrix | None = doc("(n, n); default: identity.", None)
    B: Matrix | None = doc("(n, m); default: zero.", None)
    c: Row | None = doc("(n); default: zero.", None)


class TransitionDocument(Document):
    source: Name = doc("Mode that it leaves.")
    target: Name = doc("Mode that it enters; the same as `source` for a clamp.")
    guard: RegionEntries = doc("Half-spaces that must all hold.")
    reset: dict[Name, Expression] = doc(
        "New value of a coordinate as an affine expression, e.g. `door: 1.2` or `door: door + 0.1`; a coordinate that"
        " is left out keeps its value.",
        dict,
    )
    reset_matrices: MatricesDocument | None = doc("The reset as x+ = A x + B u + c, instead of `reset`.", None)
    threshold_std: NonNegative = doc(
        "How well the guard's thresholds on coordinates are known: their standard deviation [rad or m].", 0.0
    )


def edge_of(document: TransitionDocument, names: Variables, modes: list[str], located: Located) -> Edge:
    """The transition that an entry describes.

    Args:
        modes: names of those of the model.
    """
    for key in ("source", "target"):
        located.at(key).number(getattr(document, key), modes, "mode")
    if document.reset and document.reset_matrices is not None:
        problem = "both 'reset' and 'reset_matrices' are given"
        raise located.at("reset_matrices").error(problem, "keep one of them")
    guard = region_of(document.guard, names, located.at("guard"))
    if document.reset_matrices is not None:
        reset = _matrices_of(document.reset_matrices, names, located.at("reset_matrices"))
    else:
        reset = _reset_of(document.reset, names, located.at("reset"))
    return Edge(document.source, document.target, guard, reset, document.threshold_std)


def edge_data(edge: Edge, names: Variables) -> dict[str, Any]:
    """The entry of a transition, which `edge_of` reads back."""
    guard, reset = region_data(edge.guard, names), _reset_data(edge.reset, names)
    return plain(TransitionDocument, {**vars(edge), "guard": guard, "reset": {}, **reset})


def _reset_of(reset: dict[str, str], names: Variables, located: Located) -> Reset:
    """The affine map of the expressions: A, B and c are there only if the expressions say something of them."""
    n, m = len(names.coordinates), len(names.inputs)
    a, b, c, has_constant = np.eye(n), np.zeros((n, m)), np.zeros(n), False
    for name, text in reset.items():
        index = located.at(name).number(name, names.coordinates, "coordinate")
        value = affine_of(text, names, located.at(name))
        a[index], b[index], c[index] = value.a, value.b, value.constant
        has_constant |= value.has_constant
    return Reset(
        None if np.array_equal(a, np.eye(n)) else tuple(map(tuple, a.tolist())),
        tuple(map(tuple, b.tolist())) if b.any() else None,
        tuple(c.tolist()) if has_constant else None,
    )


def _matrices_of(document: MatricesDocument, names: Variables, located: Located) -> Reset:
    n, m = len(names.coordinates), len(names.inputs)
    for key, rows, width in (("A", document.A, n), ("B", document.B, m)):
        if rows is not None:
            check_size(rows, n, width, located.at(key))
    if document.c is not None:
        check_size([document.c], 1, n, located.at("c"))
    return Reset(**dict(document))


def _reset_data(reset: Reset, names: Variables) -> dict[str, Any]:
    """Expressions where they mean exactly this reset, else its matrices."""
    n, m = len(names.coordinates), len(names.inputs)
    a, b, c = reset.matrices(n, m)
    if a.shape != (n, n) or b.shape != (n, m) or c.shape != (n,):
        raise InputError(f"automaton: a reset has matrices of sizes {a.shape}, {b.shape}, {c.shape}")
    texts: dict[str, str | float] = {}
    for i, name in enumerate(names.coordinates):
        if not (np.array_equal(a[i], np.eye(n)[i]) and not b[i].any() and c[i] == 0.0):
            is_number = not (a[i].any() or b[i].any())
            texts[name] = float(c[i]) if is_number else affine_text(a[i], b[i], c[i], names)
    says_constant = any(parse_affine(str(text), names).has_constant for text in texts.values())
    is_exact = (
        (reset.A is None) == np.array_equal(a, np.eye(n))
        and (reset.B is None) == (not b.any())
        and (reset.c is not None) == says_constant
    )
    return {"reset": texts} if is_exact else {"reset_matrices": plain(MatricesDocument, reset)}
