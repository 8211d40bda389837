"""One HTML page that needs nothing else: text, tables and figures within it, fit for the screen and for paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from cooperative.reporting import _svg as svg
from cooperative.reporting import _turn as turn

HERE = Path(__file__)
STYLE = HERE.with_suffix(".css").read_text(encoding="utf-8")
SCRIPT = f"<script>\n{HERE.with_suffix('.js').read_text(encoding='utf-8')}</script>"
"""What makes all figures before it answer, once on a page."""

TURN = turn.SCRIPT
"""The same for bodies that turn."""

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""A browser fetches nothing for the page."""


def document(title: str, parts: Iterable[str]) -> str:
    """The page. parts: HTML made by the other functions of this module."""
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
    """A paragraph; kind: a class of the style sheet, "note" for what a reader must beware of."""
    return f"<p{_kind(kind)}>{escape(text)}</p>"


def answer(before: str, strong: str, after: str) -> str:
    """The page's one answer, a sentence with its number large."""
    return f'<p class="answer">{escape(before)} <strong>{escape(strong)}</strong> {escape(after)}</p>'


def preformatted(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{escape(text)}</pre>"


def number(value: float) -> str:
    """Four figures of a number, as people write them: 0.1234, 42,560."""
    return f"{float(f'{value:.4g}'):,.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"


def table(head: Sequence[str], rows: Iterable[Sequence[str | float | int | None]]) -> str:
    """A table, without a head where `head` is empty. Numbers are set to the right, None is a dash."""
    names = [escape(name) for name in head]
    given = [list(row) for row in rows]
    lines = "".join(
        f"<tr>{''.join(_cell(value, names[at] if names else None) for at, value in enumerate(row))}</tr>\n"
        for row in given
    )
    # The head of a column of numbers stands above them.
    numbers = [bool(given) and all(not isinstance(row[at], str) for row in given) for at in range(len(names))]
    heads = "".join(
        f'<th scope="col"{_kind("number" if right else None)}>{name}</th>'
        for name, right in zip(names, numbers, strict=True)
    )
    top = f"<thead><tr>{heads}</tr></thead>\n" if heads else ""
    return f"<table{_kind('rows' if heads else None)}>\n{top}<tbody>\n{lines}</tbody>\n</table>"


def picture(figure: Figure, caption: str) -> str:
    """A figure within the page, its panels as SVG that answer mouse and keyboard where `SCRIPT` stands after them."""
    said = escape(caption)
    link = " data-linked" if svg.linked(figure) else ""
    return (
        f'<figure>\n<div class="panels"{link}>\n{"".join(svg.panels(figure))}</div>\n'
        f"<figcaption>{said}</figcaption>\n</figure>"
    )


def figures(drawn: Iterable[str]) -> str:
    """Figures, those of one panel beside each other where there is room."""
    return '<div class="figures">\n' + "\n".join(drawn) + "\n</div>"


def _cell(value: str | float | int | None, head: str | None) -> str:
    named = "" if head is None else f' data-head="{head}"'
    if isinstance(value, str):
        return f"<td{named}>{escape(value)}</td>"
    said = "–" if value is None else number(value) if isinstance(value, float) else f"{value}"
    return f'<td class="number"{named}>{said}</td>'


def _kind(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""
