"""Short explanations of the figures of merit in reports."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

EXPLANATIONS: Mapping[str, str] = MappingProxyType(
    {
        "±": "One standard deviation of the value: if the test is repeated, values scatter by about that much.",
        "interval": "Contains the true value in 95 of 100 tests (or whatever level is named), as long as the model "
        "fits.",
        "bound": "The smallest ± that any unbiased method could reach with these data (Cramér-Rao). A ± near it means "
        "that a better method would not help, only more or other data.",
        "χ²": "Sum of the squared residuals over the variance of the noise. Where the model fits, it is about the "
        "number of degrees of freedom (measured numbers minus unknowns); p is the probability of a larger one by "
        "chance.",
        "residual": "Measured minus predicted amplitude, over the standard deviation that this difference has from "
        "the noise. Where the model fits, its rms is 1 and 95 % lie below 1.73.",
        "difference of the motion": "Rms of measured minus predicted amplitudes over the rms of the measured ones, in "
        "per cent, for each channel: what the model leaves unexplained of the motion, noise included.",
        "band": "95 % band of the model's response: from the covariance of the estimate, to first order.",
        "correlation": "Near ±1, two unknowns are hard to separate: their sum or difference is known better than "
        "either.",
        "share": "Share of the information on an unknown that comes from a line or band. A line that contributes to no "
        "unknown can be left out of the next test.",
        "damping ratio": "Damping over critical damping; 0.01 halves a free motion in 11 cycles.",
        "FIT": "1 minus the rms of the difference over the rms of the measured motion, in per cent: 100 % is a perfect "
        "prediction, 0 % is no better than predicting rest.",
        "profile": "χ² with one unknown held at a value and all others at their best; where it is not a parabola, the "
        "normal interval misleads and that of the profile is the one to use.",
        "duality gap": "How far the designed test is from the best one possible; 0 proves it optimal.",
        "spread": "Standard deviation of the values over the draws of a simulation; bias is the mean error.",
        "coverage": "Share of the draws whose interval contains the true value; 95 % is right.",
    }
)
