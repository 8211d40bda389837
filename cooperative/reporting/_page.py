"""One HTML page that needs nothing else: text, tables and figures within it, fit for the screen and for paper."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib import rc_context
from matplotlib.figure import Figure

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, "Liberation Sans", Arial, sans-serif; color: #1b1b1b; background: #fff;
  max-width: 60rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.7rem; margin: 0 0 .2rem; } h2 { font-size: 1.25rem; margin: 2.2rem 0 .6rem;
  border-bottom: 1px solid #bbb; } h3 { font-size: 1.05rem; margin: 1.4rem 0 .4rem; }
.answer { font-size: 1.25rem; margin: .6rem 0 1rem; } .answer strong { font-size: 1.9rem; }
table { border-collapse: collapse; margin: .6rem 0; } th, td { text-align: left; padding: .25rem .9rem .25rem 0;
  border-bottom: 1px solid #ddd; vertical-align: top; } th { font-weight: 600; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0 1.6rem; } figure img { max-width: 100%; height: auto; display: block; }
figcaption { color: #444; font-size: .92rem; max-width: 48rem; }
.note { border-left: 4px solid #D55E00; padding: .3rem .8rem; margin: .4rem 0; background: #fdf3ea; }
pre { font-size: .82rem; background: #f5f5f5; padding: .8rem; white-space: pre-wrap; }
.turn canvas { width: 100%; height: min(70vh, 34rem); display: block; touch-action: pan-y; cursor: grab;
  border: 1px solid #ddd; } .turn canvas:focus { outline: 2px solid #0072B2; }
.turn .key { font-size: .92rem; margin: .3rem 0; } .turn .choice label { margin-right: 1rem; }
.turn .swatch { display: inline-block; width: .9em; height: .9em; margin: 0 .3em 0 .6em; vertical-align: -.1em; }
.turn .scale { display: inline-block; width: 10em; height: .9em; vertical-align: -.1em; }
@page { size: A4; margin: 16mm; }
@media print {
  body { font-size: 10.5pt; max-width: none; padding: 0; }
  h2, h3 { break-after: avoid; } figure, table, .note { break-inside: avoid; }
  .note, pre { background: none; border: 1px solid #999; } figure img { max-height: 225mm; }
}
"""


def document(title: str, parts: Iterable[str]) -> str:
    """The page. parts: HTML made by the other functions of this module."""
    body = "\n".join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
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


def answer(strong: str, rest: str) -> str:
    """The page's one answer, large, and what belongs to it."""
    return f'<p class="answer"><strong>{escape(strong)}</strong> {escape(rest)}</p>'


def preformatted(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{escape(text)}</pre>"


def table(head: Sequence[str], rows: Iterable[Sequence[str | float | int | None]]) -> str:
    """A table, without a head where `head` is empty. Numbers are set to the right, None is a dash."""
    lines = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>\n" for row in rows)
    heads = "".join(f"<th>{escape(name)}</th>" for name in head)
    top = f"<thead><tr>{heads}</tr></thead>\n" if heads else ""
    return f"<table>\n{top}<tbody>\n{lines}</tbody>\n</table>"


def picture(figure: Figure, caption: str) -> str:
    """A figure within the page, as SVG; particles within it are pixels. Its caption is its text alternative too."""
    image = io.BytesIO()
    # With a fixed salt and no date the same figure gives the same page.
    with rc_context({"svg.hashsalt": "page"}):
        figure.savefig(image, format="svg", dpi=160, metadata={"Date": None})
    data = base64.b64encode(image.getvalue()).decode()
    said = escape(caption)
    shown = f'<img alt="{said}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>\n{shown}\n<figcaption>{said}</figcaption>\n</figure>"


def _cell(value: str | float | int | None) -> str:
    if value is None:
        return '<td class="number">–</td>'
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f'<td class="number">{value:.4g}</td>' if isinstance(value, float) else f'<td class="number">{value}</td>'


def _kind(kind: str | None) -> str:
    return f' class="{kind}"' if kind else ""
