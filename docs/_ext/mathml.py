"""Formulas as MathML, which browsers set by themselves: no script, no font, no request."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(f'<span class="math">{convert(node.astext())}</span>')
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    number = node["number"]
    label = f'<span class="eqno">({number})</span>' if number else ""
    formula = convert(node.astext().replace("\n", " "), display="block")
    translator.body.append(translator.starttag(node, "div", CLASS="math-block", TABINDEX="0"))
    translator.body.append(f"{formula}{label}</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
