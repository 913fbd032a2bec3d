"""What an automaton made by hand can get wrong in sizes, said when it is made and by the names of its elements.

Values can still disagree with each other; `check.check_automaton` says where.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from micah_plan.automaton.region import Region
from micah_plan.errors import InputError, shown

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode

Sizes = tuple[int, ...]


def check_sizes(automaton: HybridAutomaton) -> None:
    """Refuse matrices, regions and stds whose sizes are not those of the coordinates and inputs.

    Raises:
        InputError: with the mode, edge or noise, the size it must have and for which names, and the one it has.
    """
    n, m = automaton.n, automaton.m
    rows = f"one for each coordinate ({', '.join(coordinate.name for coordinate in automaton.coordinates)})"
    columns = f"one column for each input ({', '.join(given.name for given in automaton.inputs)})"
    for mode in automaton.modes:
        _check_mode(automaton, mode, f"{rows}, {columns}")
    for edge in automaton.edges:
        _check_edge(edge, n, m, rows)
    for name in ("process_std", "observation_std"):
        _check_length(getattr(automaton.noise, name), n, f"noise: {name}", rows)
    for name, region in automaton.init:
        _check_region(region, n, m, f"init of mode {name}")


def _check_mode(automaton: HybridAutomaton, mode: Mode, why: str) -> None:
    n, m, where = automaton.n, automaton.m, f"mode {mode.name}"
    if len(mode.joints) != len(automaton.links):
        names = ", ".join(link.child for link in automaton.links) or "none"
        raise InputError(
            f"{where}: must have {len(automaton.links)} joints, one for each link ({names}). Got {len(mode.joints)}"
        )
    _check_matrix(mode.input_matrix, (n, m), f"{where}: input_matrix", why)
    _check_region(mode.invariant, n, m, f"{where}: invariant")
    _check_region(mode.inputs, n, m, f"{where}: inputs")


def _check_edge(edge: Edge, n: int, m: int, rows: str) -> None:
    where = f"edge {edge.name}"
    _check_region(edge.guard, n, m, f"{where}: guard")
    for name, matrix, size in (("A", edge.reset.A, (n, n)), ("B", edge.reset.B, (n, m))):
        if matrix is not None:
            _check_matrix(matrix, size, f"{where}: reset matrix {name}", rows)
    if edge.reset.c is not None:
        _check_length(edge.reset.c, n, f"{where}: reset offset c", rows)


def _check_region(region: Region, n: int, m: int, where: str) -> None:
    for k, half_space in enumerate(region.half_spaces):
        if (len(half_space.a), len(half_space.b)) != (n, m):
            named = f" '{half_space.name}'" if half_space.name else ""
            raise InputError(
                f"{where}, half-space {k + 1}{named}: must have {n} weights of coordinates and {m} of inputs. "
                f"Got {len(half_space.a)} and {len(half_space.b)}"
            )


def _check_matrix(matrix: Sequence[Sequence[float]], size: Sizes, where: str, why: str) -> None:
    try:
        widths = {len(row) for row in matrix}
    except TypeError:
        raise InputError(f"{where}: must be rows of numbers, {why}. Got {shown(matrix)}") from None
    if len(matrix) != size[0] or widths - {size[1]}:
        found = f"{len(matrix)} x {' or '.join(map(str, sorted(widths))) or 0}"
        raise InputError(f"{where}: must be {size[0]} x {size[1]}: {why}. Got {found}")


def _check_length(values: Sequence[float], n: int, where: str, rows: str) -> None:
    if len(values) != n:
        raise InputError(f"{where}: must be {n} numbers, {rows}. Got {len(values)}")
