"""An Estimate as the content of a JSON file, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dashpot.arrays import Real
from dashpot.estimate.assessment import assessment_from
from dashpot.estimate.result import FORMAT, Estimate, Fit, ModeValues
from dashpot.io.json_document import nullable
from dashpot.notices import Notice

MOST_COVARIANCE = 1000  # unknowns, above which the covariance is null


def content_of(estimate: Estimate) -> dict[str, Any]:
    """What `Estimate.to_json` writes (no batch axes)."""
    assessment = estimate.assessment
    return {
        "dashpot": FORMAT,
        "model": estimate.model,
        **({} if estimate.rig is None else {"rig": estimate.rig}),
        "method": estimate.method,
        "status": estimate.status,
        "iterations": int(estimate.iterations),
        "parameters": _parameters(estimate),
        "order": list(estimate.names),
        "covariance": _covariance_rows(estimate.covariance),
        "noise_covariance": _covariance_rows(estimate.noise_covariance),
        "intervals_count": estimate.basis,
        "tied": [list(tie) for tie in estimate.tied],
        "signs": {name: float(sign) for name, sign in estimate.signs.items()},
        "modes": [] if estimate.modes is None else _mode_rows(estimate.modes),
        "fit": {
            "chi2": float(estimate.fit.chi2), "dof": estimate.fit.dof, "p": float(estimate.fit.p),
            "known_noise": estimate.fit.known_noise,
            **({} if assessment is None else assessment.fit_content()),
        },
        "diagnosis": [] if assessment is None else [finding.content() for finding in assessment.findings],
        "history": estimate.history.tolist(),
        "warnings": [str(notice) for notice in estimate.warnings],
        "codes": [notice.code for notice in estimate.warnings],
        "concerns": [list(notice.of) for notice in estimate.warnings],
        "notes": [str(notice) for notice in estimate.notes],
        "note_codes": [notice.code for notice in estimate.notes],
        "note_concerns": [list(notice.of) for notice in estimate.notes],
    }  # fmt: skip


def _parameters(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """An entry for each parameter: all have values, the unknowns what belongs to their intervals as well."""
    entries: dict[str, dict[str, Any]] = {
        name: {
            "value": v.value, "sd": v.sd, "interval95": list(v.interval95), "unit": v.unit, "known": v.known,
            "bound_sd": v.bound_sd,
        }
        for name, v in estimate.parameters().items()
    }  # fmt: skip
    columns = (estimate.noise_sd, estimate.dof, estimate.lower, estimate.upper, estimate.free_values)
    for j, name in enumerate(estimate.names):
        noise, dof, low, high, free = (float(column[j]) for column in columns)
        entries[name] |= {"noise_sd": noise, "interval_dof": dof}
        if math.isfinite(low) or math.isfinite(high) or free != float(estimate.values[j]):
            entries[name] |= {"min": low, "max": high, "without_limits": free}
        if name in estimate.profiles:
            at, roots = estimate.profiles[name]
            entries[name]["profile"] = {"values": list(at), "roots": list(roots)}
    return entries


def _mode_rows(modes: ModeValues) -> list[dict[str, Any]]:
    rows = []
    for k in range(len(modes.eigenvalues)):
        rows.append(
            {
                "frequency_hz": float(modes.frequency_hz[k]),
                "damping_ratio": float(modes.damping_ratio[k]),
                "eigenvalue": [float(modes.eigenvalues[k].real), float(modes.eigenvalues[k].imag)],
                "frequency_sd": float(modes.frequency_sd[k]),
                "damping_sd": float(modes.damping_sd[k]),
                "shape": [[float(z.real), float(z.imag)] for z in modes.shapes[k]],
            }
        )
    return rows


def estimate_from(content: Mapping[str, Any]) -> Estimate:
    """The Estimate of such a content.  Raises what Python raises where something is missing or of a wrong type."""
    names = tuple(content["order"])
    parameters, fit = content["parameters"], content["fit"]
    unknowns = [parameters[name] for name in names]
    return Estimate(
        model=content["model"],
        method=content["method"],
        names=names,
        units=tuple(entry["unit"] for entry in unknowns),
        values=_numbers([entry["value"] for entry in unknowns]),
        covariance=_covariance(content["covariance"], [entry["sd"] for entry in unknowns]),
        noise_covariance=_covariance(content["noise_covariance"], [entry["noise_sd"] for entry in unknowns]),
        bound_sd=_numbers([entry["bound_sd"] for entry in unknowns]),
        dof=_numbers([entry["interval_dof"] for entry in unknowns], math.inf),
        lower=_numbers([entry.get("min") for entry in unknowns], -math.inf),
        upper=_numbers([entry.get("max") for entry in unknowns], math.inf),
        free_values=_numbers([entry.get("without_limits", entry["value"]) for entry in unknowns]),
        basis=content["intervals_count"],
        converged=np.asarray(content["status"] == "converged"),
        iterations=np.asarray(content["iterations"], dtype=np.int64),
        history=_rows(content["history"]),
        assessment=assessment_from(fit, content.get("diagnosis", [])),
        fit=_fit(fit),
        known=tuple((n, float(e["value"]), str(e["unit"])) for n, e in parameters.items() if e["known"]),
        tied=tuple((str(a), str(b), float(c), str(d)) for a, b, c, d in content["tied"]),
        modes=_modes(content["modes"]),
        signs={name: np.asarray(float(sign)) for name, sign in content["signs"].items()},
        warnings=_notices(content, "warnings", "codes", "concerns"),
        notes=_notices(content, "notes", "note_codes", "note_concerns"),
        rig=content.get("rig"),
        profiles={
            name: _profile(entry["profile"])
            for name, entry in zip(names, unknowns, strict=True)
            if "profile" in entry
        },
    )


def _profile(content: Mapping[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Values and roots; an end that is null is no limit on its side."""
    roots = tuple(float(root) for root in content["roots"])
    values = tuple(
        nullable(value, math.copysign(math.inf, root))
        for value, root in zip(content["values"], roots, strict=True)
    )
    return values, roots


def _numbers(values: Sequence[Any], missing: float = math.nan) -> Real:
    """Numbers of which some may be null."""
    return np.array([nullable(value, missing) for value in values])


def _rows(rows: Sequence[Sequence[Any]]) -> Real:
    return np.array([[nullable(value) for value in row] for row in rows])


def _covariance_rows(covariance: Real) -> list[list[float]] | None:
    """The rows of a covariance; None of more than MOST_COVARIANCE unknowns, whose square nobody wants in a text."""
    if len(covariance) > MOST_COVARIANCE:
        return None
    rows: list[list[float]] = covariance.tolist()
    return rows


def _covariance(rows: Sequence[Sequence[Any]] | None, sd: Sequence[Any]) -> Real:
    """A covariance of a file; where it was left out, the variances alone."""
    return np.diag(_numbers(sd) ** 2) if rows is None else _rows(rows)


def _fit(fit: Mapping[str, Any]) -> Fit:
    chi2, p = np.asarray(nullable(fit["chi2"])), np.asarray(nullable(fit["p"]))
    return Fit(chi2, int(fit["dof"]), p, bool(fit["known_noise"]))


def _modes(rows: Sequence[Mapping[str, Any]]) -> ModeValues | None:
    modes = ModeValues(
        np.array([complex(*row["eigenvalue"]) for row in rows]),
        np.array([row["frequency_hz"] for row in rows], dtype=float),
        np.array([row["damping_ratio"] for row in rows], dtype=float),
        _numbers([row["frequency_sd"] for row in rows]),
        _numbers([row["damping_sd"] for row in rows]),
        np.array([[complex(*z) for z in row["shape"]] for row in rows]),
    )
    return modes if rows else None


def _notices(content: Mapping[str, Any], texts: str, codes: str, concerns: str) -> tuple[Notice, ...]:
    """Notices of a file; those of older files have texts alone, and no code."""
    sentences = content.get(texts, [])
    return tuple(
        Notice(str(code), str(text), tuple(str(name) for name in of))
        for text, code, of in zip(
            sentences,
            content.get(codes, [""] * len(sentences)),
            content.get(concerns, [()] * len(sentences)),
            strict=True,
        )
    )
