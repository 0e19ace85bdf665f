"""What tests of the compiled kernel share: the module, skipped where it is absent, and distances between twins."""

import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dashpot.arrays import Real

SOURCES = Path(__file__).parents[1] / "kernels" / "pyproject.toml"


def compiled() -> Any:
    """The module dashpot_kernels; skips where it is absent or of another version than the sources."""
    module = pytest.importorskip(
        "dashpot_kernels", reason="the compiled kernel is not installed (dev.py env)"
    )
    wanted = tomllib.loads(SOURCES.read_text(encoding="utf-8"))["project"]["version"]
    if module.__version__ != wanted:
        pytest.skip(f"the compiled kernel is {module.__version__}, its sources {wanted} (dev.py env)")
    return module


def instruction_sets() -> list[str]:
    """Those of this machine; one that is skipped where there is no kernel."""
    try:
        import dashpot_kernels
    except ImportError:
        return ["none"]
    return dashpot_kernels.instruction_sets()


@contextmanager
def instructions(name: str) -> Iterator[Any]:
    """The kernel with one instruction set, the best one again afterwards."""
    module = compiled()
    before = module.instruction_set()
    module.set_instructions(name)
    try:
        yield module
    finally:
        module.set_instructions(before)


def apart(values: Real, twin: Real, size: Real | float = 1.0) -> float:
    """Largest difference of K rows over the largest entry of each, entries in units of `size`."""
    difference, scale = np.abs(values - twin) * size, np.abs(twin) * size
    rows = range(len(twin))
    return max(float(np.max(difference[k])) / max(float(np.max(scale[k])), 1e-300) for k in rows)
