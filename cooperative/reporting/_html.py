"""Elements of one HTML page that needs no other file: text, tables and figures, for the screen and for paper."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import matplotlib

from cooperative.reporting import _interactive as interactive
from cooperative.reporting._plots import Drawn

Cell = str | float | int | None
"""Of a table: numbers stand on the right, None is a dash."""

STYLE = Path(__file__).with_name("_page.css").read_text(encoding="utf-8")

WIDE = 7.5
"""Figures of this width (inch) or more stand alone."""

DPI = 120
"""Resolution of particles and maps within a figure."""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""A browser fetches nothing for the page."""


def document(title: str, parts: Iterable[str]) -> str:
    """The page.

    Args:
        title: of the window.
        parts: HTML made by the other functions of this module.
    """
    body = "\n".join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n'
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def heading(text: str, level: int = 2) -> str:
    """A heading; level 1 is the page's own."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str, kind: str | None = None) -> str:
    """A paragraph, nothing for empty text.

    Args:
        text: of the paragraph.
        kind: a class of the style sheet, "note" for warnings.
    """
    return f"<p{_class(kind)}>{escape(text)}</p>" if text else ""


def headline(before: str, strong: str, after: str) -> str:
    """A sentence with its number large."""
    return f'<p class="answer">{escape(before)} <strong>{escape(strong)}</strong> {escape(after)}</p>'


def preformatted(text: str) -> str:
    """Text with its own line ends."""
    return f"<pre>{escape(text)}</pre>"


def number(value: float) -> str:
    """Four significant figures: 0.1234, 42,560."""
    return f"{float(f'{value:.4g}'):,.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"


def table(head: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A table, without a head where `head` is empty."""
    rows, names = list(rows), [escape(name) for name in head]
    heads: list[str | None] = [*names] or [None] * max(map(len, rows), default=0)
    lines = "".join(f"<tr>{''.join(map(_cell, row, heads))}</tr>\n" for row in rows)
    # The head of a column of numbers stands on the right too.
    numeric = [bool(rows) and not any(isinstance(row[at], str) for row in rows) for at in range(len(names))]
    shown = "".join(
        f'<th scope="col"{_class("number" if right else None)}>{name}</th>'
        for name, right in zip(names, numeric, strict=True)
    )
    top = f"<thead><tr>{shown}</tr></thead>\n" if shown else ""
    return f"<table{_class('rows' if shown else None)}>\n{top}<tbody>\n{lines}</tbody>\n</table>"


def figure(drawn: Drawn) -> str:
    """A figure as matplotlib draws it; where Plotly is installed and the browser runs scripts, its interactive form."""
    shown = _inlined(drawn)
    if drawn.interactive is not None and interactive.installed():
        shown = f"{interactive.html(drawn.interactive(), drawn.name)}\n<noscript>{shown}</noscript>"
    wide = " wide" if drawn.figure.get_figwidth() > WIDE else ""
    return (
        f'<figure class="drawn{wide}" aria-labelledby="of-{drawn.name}">\n{shown}\n'
        f'<figcaption id="of-{drawn.name}">{escape(drawn.caption)}</figcaption>\n</figure>'
    )


def figures(drawn: Iterable[Drawn]) -> str:
    """Figures, narrow ones beside each other where there is room; nothing for none."""
    shown = "\n".join(map(figure, drawn))
    return f'<div class="figures">\n{shown}\n</div>' if shown else ""


def _inlined(drawn: Drawn) -> str:
    """A figure as an SVG element, whose ids no other element of the page has."""
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": drawn.name}):
        drawn.figure.savefig(file, format="svg", dpi=DPI, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    drawing = file.getvalue().decode()
    # Its style sheet would apply to all elements of the page; the page's own has what it needs.
    drawing = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", drawing[drawing.find("<svg") :], flags=re.S)
    drawing = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{drawn.name}-", drawing)
    return drawing.replace("<svg ", f'<svg role="img" aria-labelledby="of-{drawn.name}" ', 1)


def _cell(value: Cell, head: str | None) -> str:
    name = "" if head is None else f' data-head="{head}"'
    if isinstance(value, str):
        return f"<td{name}>{escape(value)}</td>"
    text = "–" if value is None else number(value) if isinstance(value, float) else f"{value}"
    return f'<td class="number"{name}>{text}</td>'


def _class(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""
