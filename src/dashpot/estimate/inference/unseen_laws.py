"""Unknowns that leave no trace, told by the information; and laws of nonlinear elements that the data do not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arrays import Real
from dashpot.errors import IdentifiabilityError
from dashpot.estimate.inference.diagnostics import ZERO, nonlinear_names
from dashpot.io.words import joined, with_values
from dashpot.model.network import Model
from dashpot.notices import Notice
from dashpot.numerics.small_systems import standard_deviations

UNSEEN_LAW = "law_not_seen"  # code of a notice
CONSTANT_HARDLY_SEEN = "constant_hardly_seen"  # code of a notice
SHARE = 1e-3  # part of a direction from which an unknown belongs to it
ROUNDING = 1e-13  # of an information matrix with ones on its diagonal


@dataclass(frozen=True)
class Traceless:
    """Unknowns without any effect, and the least group of those that can change together without one."""

    silent: tuple[str, ...]
    together: tuple[str, ...]


def traceless(names: Sequence[str], information: Real, least: float = ROUNDING) -> Traceless:
    """What an information matrix (M, M) of the unknowns `names`, the first of M, tells nothing about.

    least: eigenvalue, of the matrix with ones on its diagonal, below which it tells nothing.
    """
    if not np.all(np.isfinite(information)):
        return Traceless((), ())
    diagonal = np.abs(np.diagonal(information))
    silent = tuple(name for name, told in zip(names, diagonal, strict=False) if told == 0)
    scale = np.where(diagonal > 0, np.sqrt(diagonal), 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale) + np.diag(1.0 * (diagonal == 0)))
    if not values[0] < least:
        return Traceless(silent, ())
    part = np.abs(vectors[:, 0])
    chosen = part[: len(names)] > SHARE * np.max(part)
    return Traceless(silent, tuple(name for name, there in zip(names, chosen, strict=True) if there))


def require_traces(model: Model, names: Sequence[str], information: Real, least: float = ROUNDING) -> None:
    """Raises IdentifiabilityError that names laws or combinations of unknowns that leave no trace.

    names: the first unknowns of information (M, M).
    """
    hidden = traceless(names, information, least)
    silent = [name for name in hidden.silent if name in nonlinear_names(model)]
    if silent:
        raise IdentifiabilityError(
            f"{joined(silent)} leave{'s' if len(silent) == 1 else ''} no trace: the element never moves far "
            "enough for its law to show",
            cure=f"drive the rig further, give {'it' if len(silent) == 1 else 'them'} a value, or leave the "
            "element out",
        )
    if len(hidden.together) > 1:
        raise IdentifiabilityError(
            f"the data do not tell {joined(hidden.together)} apart: they can change together without a trace",
            cure=f"{with_values(hidden.together)}, or leave one out",
        )


def unseen_laws(model: Model, theta: Real, covariance: Real) -> list[Notice]:
    """Warnings of nonlinear elements whose parameter may be 0: the data do not show them.

    Where the element shows, but 0 is within the intervals of lengths or speeds in its law, these are named.
    theta (m,) or longer, covariance (m, m) by the noise alone: an interval that a misfit has widened hides no law.
    """
    if not len(model.nonlinear):
        return []
    sd = dict(zip(model.unknown_names, standard_deviations(covariance), strict=False))
    values = dict(zip(model.unknown_names, theta.tolist(), strict=False))
    notices = []
    for element in (model.elements[int(index)] for index in model.nonlinear):
        law, name = element.force_law, element.name
        if law is None:
            continue
        if name not in values or not abs(values[name]) <= ZERO * sd[name]:
            rough = [
                c for c in (f"{name}.{c}" for c in law.constant_names if c in law.positive) if c in values
            ]
            notices += _hardly_seen(name, [c for c in rough if abs(values[c]) <= ZERO * sd[c]])
            continue
        inner = [f"{name}.{constant.name}" for constant in law.constants if constant.unknown]
        then = f", and {joined(inner)} mean{'s' if len(inner) == 1 else ''} nothing then" if inner else ""
        text = (
            f"the data do not show {name}: 0 is within its interval{then}; drive the rig further, "
            "or leave the element out"
        )
        notices.append(Notice(UNSEEN_LAW, text, (name,)))
    return notices


def _hardly_seen(name: str, rough: Sequence[str]) -> list[Notice]:
    """A warning of constants `rough` in the law of an element that shows, 0 within their intervals."""
    if not rough:
        return []
    single = len(rough) == 1
    text = (
        f"the data hardly show {joined(rough)}: 0 is within {'its interval' if single else 'their intervals'}, which "
        f"{'is' if single else 'are'} rough then, as are those of {name} and of what else its law holds; drive the rig "
        "further, or give a value"
    )
    return [Notice(CONSTANT_HARDLY_SEEN, text, tuple(rough))]
