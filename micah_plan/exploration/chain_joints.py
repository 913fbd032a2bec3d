"""Chains of slides and hinges for the same rows, with the probabilities of their kinds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.exploration.chain import Chain, StepRows, fitted

_JOINT = 3.0  # nats against each joint more
_NONE = 1e-3  # odds that none of the chains is right: of 1,200 objects of which it was surer than 99 % two were not
_WELL, _FIRST = 4, 2  # rounds of a fit from a rough guess, and of one that goes on with the next step
_SPLITS = (0.2, 0.45, 0.7)  # of the way of a joint: from where the place is fitted at which another took over


def with_joint(
    before: Chain | None, pose: tuple[Floats, Floats], along: Floats, rows: StepRows, row: int
) -> tuple[Chain, Chain]:
    """Chains in which a new joint moves the handle from a row on, as a slide and as a hinge.

    Args:
        before: the chain so far; None: nothing had moved.
        pose: (3,) and (3, 3), of the handle before it moved at all.
        along: (3,) how it has moved since that row [m].
    """
    direction = along / np.linalg.norm(along)
    if before is None:
        way = np.concatenate([[0.0], np.cumsum(rows.moved @ direction)])
        guess = Chain((False,), *pose, np.zeros(1), direction[None], np.zeros((1, 3)), way)
    else:
        way = np.append(before.way, before.way[-1] + np.cumsum(rows.moved[row:] @ direction))
        guess = _with_next_joint(replace(before, way=way), float(before.way[-1]), False, direction, np.zeros(3))
    slide = fitted(guess, rows, _FIRST)
    return slide, _of_kind(slide, -1, rows, _FIRST)


def refitted(chains: tuple[Chain, Chain], rows: StepRows) -> tuple[Chain, Chain]:
    """Both chains refitted with the new rows."""
    slide, hinge = (fitted(chain, rows) for chain in chains)
    if hinge.loss > slide.loss + 0.5:  # what hinges can do includes slides: it is in a wrong valley
        hinge = _of_kind(slide, -1, rows, _FIRST)
    return slide, hinge


def most_probable_chain(chains: Sequence[Chain], rows: StepRows) -> tuple[Chain, float]:
    """(most probable chain, probability of its kinds) among all that differ from the best in one joint."""
    compared, best = list(chains), max(chains, key=_log_probability)
    while True:
        compared += _neighbours(best, rows)
        before, best = best, max(compared, key=_log_probability)
        if best is before:
            break
    odds: dict[tuple[str, ...], float] = {}
    for chain in compared:
        odds[chain.kinds] = max(odds.get(chain.kinds, -np.inf), _log_probability(chain))
    return best, 1.0 / (_NONE + sum(float(np.exp(log - odds[best.kinds])) for log in odds.values()))


def _log_probability(chain: Chain) -> float:
    """Log of its probability, up to a constant [nats]."""
    return chain.evidence - _JOINT * len(chain.hinges)


def _neighbours(chain: Chain, rows: StepRows) -> list[Chain]:
    """Chains that differ in one joint: in its kind, or in its presence."""
    numbers = range(len(chain.hinges))
    others = [_without(chain, number, rows) for number in numbers if len(numbers) > 1]
    return [*_split(chain, rows), *(_of_kind(chain, number, rows) for number in numbers), *others]


def _of_kind(chain: Chain, number: int, rows: StepRows, rounds: int = _WELL) -> Chain:
    """The chain with one joint of the other kind; a hinge from a slide starts without curvature."""
    hinges, rate = list(chain.hinges), chain.rate.copy()
    hinges[number] = not hinges[number]
    rate[number] = 0.0
    return fitted(replace(chain, hinges=tuple(hinges), rate=rate), rows, rounds)


def _without(chain: Chain, number: int, rows: StepRows) -> Chain:
    begin, direction, rate = (np.delete(a, number, axis=0) for a in (chain.begin, chain.direction, chain.rate))
    begin[0] = 0.0
    hinges = tuple(hinge for i, hinge in enumerate(chain.hinges) if i != number)
    return fitted(replace(chain, hinges=hinges, begin=begin, direction=direction, rate=rate), rows, _WELL)


def _with_next_joint(chain: Chain, begin: float, hinge: bool, direction: Floats, rate: Floats) -> Chain:
    """The chain continued by another joint from a distance on."""
    return replace(
        chain,
        hinges=(*chain.hinges, hinge),
        begin=np.append(chain.begin, begin),
        direction=np.concatenate([chain.direction, direction[None]]),
        rate=np.concatenate([chain.rate, rate[None]]),
    )


def _split(chain: Chain, rows: StepRows) -> list[Chain]:
    """The chain with an additional joint of the other kind, behind or before the last one."""
    chains, last = list[Chain](), chain.rate[-1]
    straight = replace(chain, hinges=(*chain.hinges[:-1], False), rate=np.append(chain.rate[:-1], np.zeros((1, 3)), 0))
    for share in _SPLITS:
        begin = float(chain.begin[-1] + share * (chain.way.max() - chain.begin[-1]))
        tangent = chain.poses(np.array([begin]))[2][0]
        chains.append(fitted(_with_next_joint(straight, begin, True, tangent, last), rows, _WELL))
        if chain.hinges[-1]:
            chains.append(fitted(_with_next_joint(chain, begin, False, tangent, np.zeros(3)), rows, _WELL))
    return chains
