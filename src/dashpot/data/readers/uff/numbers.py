"""Floating-point numbers of old machines: IBM System/370 and DEC VAX."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arrays import Real


def from_ibm(whole: Any, width: int) -> Real:
    """Numbers ± fraction · 16^(exponent − 64) from unsigned integers of 4 or 8 bytes."""
    bits = 8 * width
    whole = whole.astype(np.uint64)
    sign = np.where(whole >> np.uint64(bits - 1), -1.0, 1.0)
    exponent = ((whole >> np.uint64(bits - 8)) & np.uint64(0x7F)).astype(np.int64) - 64
    fraction = (whole & np.uint64((1 << (bits - 8)) - 1)).astype(float) / 2.0 ** (bits - 8)
    values: Real = sign * np.ldexp(fraction, 4 * exponent)
    return values


def from_vax(words: Any, width: int) -> Real:
    """F_floating (4 bytes) and D_floating (8 bytes) from words of two bytes, each little-endian."""
    words = words.astype(np.uint64).reshape(-1, width // 2)
    whole = np.zeros(len(words), dtype=np.uint64)
    for k in range(width // 2):  # the word of sign and exponent comes first
        whole = (whole << np.uint64(16)) | words[:, k]
    bits = 8 * width
    sign = np.where(whole >> np.uint64(bits - 1), -1.0, 1.0)
    exponent = ((whole >> np.uint64(bits - 9)) & np.uint64(0xFF)).astype(np.int64)
    hidden = 1 << (bits - 9)
    fraction = ((whole & np.uint64(hidden - 1)) | np.uint64(hidden)).astype(float) / (2.0 * hidden)
    values: Real = np.where(exponent == 0, 0.0, sign * np.ldexp(fraction, exponent - 128))
    return values
