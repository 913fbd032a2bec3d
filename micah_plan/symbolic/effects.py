"""The operations that forms of effects are written with, for CasADi expressions."""

from __future__ import annotations

from typing import Any

import casadi as ca


class CasadiOperations:
    """`automaton.effects.form.Operations` on CasADi expressions; names and meanings are NumPy's."""

    def where(self, condition: Any, yes: Any, no: Any) -> Any:
        return ca.if_else(condition, yes, no)

    def minimum(self, a: Any, b: Any) -> Any:
        return ca.fmin(a, b)

    def maximum(self, a: Any, b: Any) -> Any:
        return ca.fmax(a, b)

    def sign(self, a: Any) -> Any:
        return ca.sign(a)

    def abs(self, a: Any) -> Any:
        return ca.fabs(a)

    def exp(self, a: Any) -> Any:
        return ca.exp(a)

    def sin(self, a: Any) -> Any:
        return ca.sin(a)

    def cos(self, a: Any) -> Any:
        return ca.cos(a)
