"""Masses, dampers and springs of a vibrating rig from noisy test data.

    import dashpot

    rig = dashpot.read_rig("rig.toml")
    estimate = rig.identify("data.csv")
    print(estimate)

Public names are loaded when they are first used, so that `import dashpot` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from dashpot.api import compare, draw, identify, read, simulate, state_space, transfer_functions
    from dashpot.channel import Channel, Quantity
    from dashpot.check.residuals import Residuals, residuals
    from dashpot.data.conditioning.drive_frequency import refine_frequency
    from dashpot.data.conditioning.harmonic_fit import HarmonicFit, fit_harmonics
    from dashpot.data.conditioning.lines import spectrum
    from dashpot.data.conditioning.settings import Conditioning
    from dashpot.data.conditioning.transients import settled
    from dashpot.data.modal_data import ModalData
    from dashpot.data.readers import Reading, write_amplitudes, write_records
    from dashpot.data.readers.in_memory import record, records_of
    from dashpot.data.readers.modes import read_modes
    from dashpot.data.record import Record
    from dashpot.data.spectrum import Moments, Spectrum, concatenate, merge_repeats
    from dashpot.errors import (
        ConvergenceError,
        DashpotError,
        DataError,
        IdentifiabilityError,
        ModelError,
        Problem,
        UsageError,
    )
    from dashpot.estimate.comparison import Comparison
    from dashpot.estimate.likelihood.maximum_likelihood import MaximumLikelihood
    from dashpot.estimate.linear.definite import DefiniteOptimalIV, FreeMatrices, matrices_of
    from dashpot.estimate.linear.instrumental_variables import InstrumentalVariables, OptimalIV
    from dashpot.estimate.linear.least_squares import HarmonicLeastSquares, LeastSquares, WeightedLeastSquares
    from dashpot.estimate.linear.total_least_squares import CompensatedLeastSquares, TotalLeastSquares
    from dashpot.estimate.modal.identify_modal import identify_modal
    from dashpot.estimate.registry import method
    from dashpot.estimate.result import Estimate, Fit, ModeValues, Value
    from dashpot.export.state_space import StateSpace
    from dashpot.export.transfer_functions import TransferFunctions
    from dashpot.model.blocks import block_elements
    from dashpot.model.dynamics import Matrices, matrices, response, sensitivities
    from dashpot.model.elements import Element, Kind, between, mass
    from dashpot.model.modes import Modes, modes
    from dashpot.model.network import Input, Model, Unknown
    from dashpot.model.rigfile import Rig, default_channels, parse_rig, read_rig, write_rig
    from dashpot.model.unstructured import free_model
    from dashpot.study.simulate import Dwells, dwells, simulate_records, simulate_spectrum

_NAMES = {
    "api": "compare draw identify read simulate state_space transfer_functions",
    "channel": "Channel Quantity",
    "check.residuals": "Residuals residuals",
    "data.conditioning.drive_frequency": "refine_frequency",
    "data.conditioning.harmonic_fit": "HarmonicFit fit_harmonics",
    "data.conditioning.lines": "spectrum",
    "data.conditioning.settings": "Conditioning",
    "data.conditioning.transients": "settled",
    "data.modal_data": "ModalData",
    "data.readers": "Reading write_amplitudes write_records",
    "data.readers.in_memory": "record records_of",
    "data.readers.modes": "read_modes",
    "data.record": "Record",
    "data.spectrum": "Moments Spectrum concatenate merge_repeats",
    "errors": "ConvergenceError DashpotError DataError IdentifiabilityError ModelError Problem UsageError",
    "estimate.comparison": "Comparison",
    "estimate.result": "Estimate Fit ModeValues Value",
    "estimate.linear.definite": "DefiniteOptimalIV FreeMatrices matrices_of",
    "estimate.linear.instrumental_variables": "InstrumentalVariables OptimalIV",
    "estimate.linear.least_squares": "HarmonicLeastSquares LeastSquares WeightedLeastSquares",
    "estimate.likelihood.maximum_likelihood": "MaximumLikelihood",
    "estimate.registry": "method",
    "estimate.modal.identify_modal": "identify_modal",
    "estimate.linear.total_least_squares": "CompensatedLeastSquares TotalLeastSquares",
    "export.state_space": "StateSpace",
    "export.transfer_functions": "TransferFunctions",
    "model.blocks": "block_elements",
    "model.dynamics": "Matrices matrices response sensitivities",
    "model.modes": "Modes modes",
    "model.elements": "Element Kind between mass",
    "model.unstructured": "free_model",
    "model.rigfile": "Rig default_channels parse_rig read_rig write_rig",
    "model.network": "Input Model Unknown",
    "notices": "Notice",
    "study.simulate": "Dwells dwells simulate_records simulate_spectrum",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [
    "Channel",
    "Comparison",
    "CompensatedLeastSquares",
    "Conditioning",
    "ConvergenceError",
    "DashpotError",
    "DataError",
    "DefiniteOptimalIV",
    "Dwells",
    "Element",
    "Estimate",
    "Fit",
    "FreeMatrices",
    "HarmonicFit",
    "HarmonicLeastSquares",
    "IdentifiabilityError",
    "Input",
    "InstrumentalVariables",
    "Kind",
    "LeastSquares",
    "Matrices",
    "MaximumLikelihood",
    "ModalData",
    "ModeValues",
    "Model",
    "ModelError",
    "Modes",
    "Moments",
    "Notice",
    "OptimalIV",
    "Problem",
    "Quantity",
    "Reading",
    "Record",
    "Residuals",
    "Rig",
    "Spectrum",
    "StateSpace",
    "TotalLeastSquares",
    "TransferFunctions",
    "Unknown",
    "UsageError",
    "Value",
    "WeightedLeastSquares",
    "__version__",
    "between",
    "block_elements",
    "compare",
    "concatenate",
    "default_channels",
    "draw",
    "dwells",
    "fit_harmonics",
    "free_model",
    "identify",
    "identify_modal",
    "mass",
    "matrices",
    "matrices_of",
    "merge_repeats",
    "method",
    "modes",
    "parse_rig",
    "read",
    "read_modes",
    "read_rig",
    "record",
    "records_of",
    "refine_frequency",
    "residuals",
    "response",
    "sensitivities",
    "settled",
    "simulate",
    "simulate_records",
    "simulate_spectrum",
    "spectrum",
    "state_space",
    "transfer_functions",
    "write_amplitudes",
    "write_records",
    "write_rig",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        return version("dashpot")
    if name not in _HOME:
        raise AttributeError(f"module 'dashpot' has no attribute {name!r}")
    attribute = getattr(import_module(f"dashpot.{_HOME[name]}"), name)
    if isinstance(attribute, FunctionType):
        attribute = import_module("dashpot.shorthand").refusing(attribute)
        attribute.__module__ = "dashpot"  # under which pickle finds it again
    globals()[name] = attribute
    return attribute


def __dir__() -> list[str]:
    return sorted(__all__)
