"""Libraries that only some formats need, and what damaged files do to them."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from dashpot.errors import DashpotError, DataError
from dashpot.io.words import shown

PANIC = "PanicException"  # of Rust, which is no Exception


def library(module: str, extra: str, source: str, what: str) -> Any:
    """An optional module.  Raises DataError that names the extra where it is not installed."""
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ImportError:
        cure = f'install it: pip install ".[{extra}]" from the copy of dashpot'
        raise DataError(f"to read {what}, {package} is needed", source, cure) from None
    finally:
        _silence(package)


def _silence(package: str) -> None:
    """Nothing goes to stderr past us: what is wrong with a file is raised, in one line."""
    for name, logger in logging.root.manager.loggerDict.items():
        if name.partition(".")[0] == package and isinstance(logger, logging.Logger):
            logger.setLevel(logging.CRITICAL + 1)


@contextmanager
def damaged(source: str, what: str) -> Iterator[None]:
    """Whatever a library raises, in one line: files are not to be trusted."""
    try:
        yield
    except DashpotError:
        raise
    except MemoryError:
        raise DataError(
            f"the {what} file asks for more memory than there is", source, "it may be damaged"
        ) from None
    except BaseException as error:  # libraries of formats raise what they like
        if not isinstance(error, Exception) and type(error).__name__ != PANIC:
            raise
        reason = re.sub(r"\s+", " ", str(error)).strip() or type(error).__name__
        raise DataError(
            f"the {what} file is damaged or cut off ({shown(reason, 100)})", source, "copy it again"
        ) from None
