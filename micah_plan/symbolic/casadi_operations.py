"""The operations that forms of effects are written with, for CasADi expressions."""

from __future__ import annotations

import casadi as ca


class CasadiOperations:
    """`automaton.effects.form.Operations` on CasADi expressions; names and meanings are NumPy's."""

    where = staticmethod(ca.if_else)
    minimum = staticmethod(ca.fmin)
    maximum = staticmethod(ca.fmax)
    sign = staticmethod(ca.sign)
    abs = staticmethod(ca.fabs)
    sqrt = staticmethod(ca.sqrt)
    exp = staticmethod(ca.exp)
    sin = staticmethod(ca.sin)
    cos = staticmethod(ca.cos)
