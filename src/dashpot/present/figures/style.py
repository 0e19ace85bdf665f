"""The look of all figures, and figures as files; no pyplot, so no window and no state is left behind."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import get_registered_canvas_class
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter, StrMethodFormatter
from PIL import Image

from dashpot.errors import DataError
from dashpot.estimate.registry import METHODS
from dashpot.io.atomic import write_bytes
from dashpot.io.words import PICTURES, chosen_format

INK, MUTED, GRID = "#1f2933", "#7b8794", "#e4e7eb"
MODEL, DATA, BAD = "#0b6e99", "#1f2933", "#b5372b"
_UNSAID = {"svg": ("Date", "Creator"), "png": ("Software",), "pdf": ("CreationDate", "Creator", "Producer")}
COLOURS = ("#0b6e99", "#c4661f", "#4a7c3a", "#8a4f9e", "#b5372b", "#5c6b7a", "#b08a1e", "#2f8f83")
HEAT = LinearSegmentedColormap.from_list("heat", ["#ffffff", "#d5e6ee", "#7fb6cd", "#0b6e99", "#083d56"])
DPI = 180
HALF_PAGE = 6.2  # inches of a figure that stands in half of a wide page: its text is as large as the page's

_STYLE = {
    "font.family": "sans-serif",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "dashpot",
    "figure.constrained_layout.use": True,
}


LONGEST = 20  # letters of a name in a figure
_TOO_LONG = re.compile(
    rf"(?<!\S)(?!\$\\mathdefault)\S{{{LONGEST + 1},}}"
)  # but for powers of ten, which are math


@contextmanager
def style() -> Iterator[None]:
    """The look of all figures."""
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # the stub wants every key as a literal
        yield


def panels(count: int, columns: int, size: tuple[float, float], **settings: Any) -> tuple[Figure, list[Axes]]:
    """A figure of that size (inches) with `count` panels in rows of `columns`, and the panels."""
    figure = ShownFigure(figsize=size)
    grid = list(figure.subplots(-(-count // columns), columns, squeeze=False, **settings).flat)
    for axes in grid[count:]:
        axes.set_visible(False)
    return figure, grid[:count]


def plain_log(axis: Axis, subs: Sequence[float] = (1.0, 2.0, 5.0), form: str = "{x:g}") -> None:
    """Plain numbers along a logarithmic axis, at these multiples of powers of ten."""
    axis.set_major_locator(LogLocator(subs=subs, numticks=14))
    axis.set_major_formatter(StrMethodFormatter(form))
    axis.set_minor_formatter(NullFormatter())


def row_names(axes: Axes, places: Sequence[float], names: Sequence[str]) -> None:
    """Names of rows at the left, without ticks."""
    axes.set_yticks(places, names)
    axes.tick_params(axis="y", length=0)


def heat_bar(mesh: ScalarMappable, axes: Axes, label: str, ticks: Sequence[float] | None = None) -> Colorbar:
    """The scale of colours beside a heat map."""
    bar = axes.figure.colorbar(mesh, ax=axes, pad=0.01, ticks=ticks)
    bar.set_label(label)
    bar.outline.set_visible(False)
    return bar


def limit_axis(limits: Callable[[float | None, float | None], object], low: float, high: float) -> None:
    """Set the limits of an axis (`axes.set_xlim`): an end that is no finite number stays what it is."""
    limits(low if np.isfinite(low) else None, high if np.isfinite(high) else None)


def _shortened(text: str) -> str:
    return _TOO_LONG.sub(lambda word: f"{word[0][:LONGEST]}…", text)


class ShownFigure(Figure):
    """A figure that a notebook shows where pyplot was not imported."""

    def _repr_svg_(self) -> str:
        return _saved(self, "svg").decode("utf-8")


def svg(figure: Figure) -> str:
    """The figure as an SVG element for a page: no XML head, no date."""
    text = _saved(figure, "svg", transparent=True).decode("utf-8")
    return text[text.index("<svg") :]


def png(figure: Figure) -> bytes:
    """The figure as a PNG file of 256 colours, a third of the size of all; the same bytes for the same figure."""
    out = io.BytesIO()
    with Image.open(io.BytesIO(_saved(figure, "png", dpi=DPI))) as picture:
        picture.convert("RGB").quantize(256).save(out, "PNG", optimize=True, dpi=(DPI, DPI))
    return out.getvalue()


def write_figure(path: str | os.PathLike[str], figure: Figure) -> None:
    """Write the figure as SVG, PNG or PDF by the end of the name.  Raises UsageError, DataError."""
    kind = chosen_format(path, PICTURES)
    write_bytes(path, png(figure) if kind == "png" else _saved(figure, kind))


def write_pictures(folder: str | Path, pictures: Mapping[str, bytes]) -> list[str]:
    """Write PNG files by name into a folder, which is made if missing; their paths.  Raises DataError."""
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise DataError(f"the folder cannot be made ({reason})", str(target), "name another one") from None
    paths = [str(target / f"{name}.png") for name in pictures]
    for path, content in zip(paths, pictures.values(), strict=True):
        write_bytes(path, content)
    return paths


def _saved(figure: Figure, kind: str, **settings: Any) -> bytes:
    """The content of a file of that kind, without the day and the program that would change it."""
    out = io.BytesIO()
    with style():
        # Texts are names and words, in which $ is a letter; only the ticks of logarithmic axes are math. Of a
        # name that would leave no room for the axes, the beginning is shown.
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            if isinstance(axis.get_major_formatter(), ScalarFormatter | StrMethodFormatter):
                continue  # numbers, whose ticks would all be made just to look at them
            labels = [label.get_text() for label in axis.get_ticklabels()]
            if any(map(_TOO_LONG.search, labels)):  # which the axis would write anew
                axis.set_ticks(axis.get_ticklocs(), [_shortened(label) for label in labels])
        for text in figure.findobj(Text):
            assert isinstance(text, Text)
            if _TOO_LONG.search(text.get_text()):
                text.set_text(_shortened(text.get_text()))
            if "$" in text.get_text() and not text.get_text().startswith("$\\mathdefault{"):
                text.set_parse_math(False)
        layout, dpi = figure.get_layout_engine(), figure.dpi
        if layout is not None:  # `savefig` would draw all once more for it
            get_registered_canvas_class(kind)(figure)
            figure.set_dpi(settings.get("dpi", dpi))
            layout.execute(figure)
            figure.set_layout_engine("none")
        figure.savefig(out, format=kind, metadata=dict.fromkeys(_UNSAID[kind]), **settings)
        figure.set_layout_engine(layout or "none")
        figure.set_dpi(dpi)
    return out.getvalue()


def method_colour(method: str, place: int = 0) -> str:
    """The colour of a method, the same in every figure; of one that is not registered, by its place."""
    names = list(METHODS)
    return COLOURS[(names.index(method) if method in names else place) % len(COLOURS)]
