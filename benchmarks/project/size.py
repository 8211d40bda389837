"""How large the repository is, and how plain its words are.

`code_lines_*` are lines without blanks, comments and docstrings. `files_above_350_lines` counts all lines of a file.
`public_names_*` are the names that a package exports; `any_lines` are the lines of the packages with `Any`.
`words_left` are words that the table of names replaces: each identifier of a file that has one as a part, and each use
in the prose of a page. Uses with a reason to stay, in `EXCEPTIONS`, are not in it. `sentences_above_30_words` are those
of the pages; a table's cell or a list's item is a sentence of its own. `python -m benchmarks.project.size` lists each
word and sentence with its file.
"""

from __future__ import annotations

import ast
import importlib
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.measure import ROOT, Report

PACKAGES = ("foundation", "jaxmpm", "kl", "cooperative")
LINES = 350
WORDS = 30

REPLACED = {
    "realisation": "sample",
    "place": "lane, position or element at risk",
    "moved": "failed, failure_displacement",
    "weakened": "reduced, R",
    "crew": "workers",
    "hands": "workers",
    "said": "given",
    "unsaid": "default",
    "found": "result",
    "kept": "stored",
    "told": "message, given",
    "meant": "given",
    "believed": "default",
}
"""Word by the one to use instead. `limit`, `modes`, `slide` and `Ground` have another meaning too, so that no count of
words tells them apart."""

EXCEPTIONS = {
    "FileNotFoundError": "Python's name",
    "ModuleNotFoundError": "Python's name",
    "PackageNotFoundError": "Python's name",
    "in place": "idiom: instead of, or without a copy",
}
"""Identifier or phrase by the reason why it stays."""

_SKIPPED = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE),
    *(tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER),
}
_PART = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_WORD = re.compile("|".join(f"{word}s?" for word in REPLACED), re.IGNORECASE)
_EXCEPTION_OR_WORD = re.compile(rf"\b(?:{'|'.join(EXCEPTIONS)}|{_WORD.pattern})\b", re.IGNORECASE)


def sources(*folders: str) -> list[Path]:
    """Python files of folders of the repository."""
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def pages() -> list[Path]:
    """Pages written by hand: the README, how to contribute and docs/."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def code_lines(text: str) -> int:
    """Lines of Python without blanks, comments and docstrings."""
    strings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            strings.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _SKIPPED:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - strings)


def any_lines(text: str) -> int:
    """Lines of Python with `Any` as a name."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return len({token.start[0] for token in tokens if token.type == tokenize.NAME and token.string == "Any"})


def identifiers(text: str) -> list[str]:
    """Identifiers of Python that have a replaced word as a part, each once."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    names = {token.string for token in tokens if token.type == tokenize.NAME}
    return sorted(name for name in names if any(_WORD.fullmatch(part) for part in _PART.findall(name)))


def words(text: str) -> list[str]:
    """Exceptions and replaced words in the prose of a Markdown page."""
    return [match.lower() for part in paragraphs(text) for match in _EXCEPTION_OR_WORD.findall(part)]


def paragraphs(text: str) -> list[str]:
    """Prose of a Markdown page: paragraphs, list items and table cells, without code and the targets of links."""
    text = re.sub(r"^ *(```|~~~).*?^ *\1", "", text, flags=re.S | re.M)
    text = re.sub(r"`[^`]*`", "x", text).replace("**", "")
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"^ *([-*]|\d+\.) |^#+ .*$|^[-=| :]+$", "\n\n", text, flags=re.M)
    parts = [part for block in re.split(r"\n\s*\n", text) for part in re.split(r"(?m)^\||\|$|\|", block)]
    return [joined for part in parts if (joined := " ".join(part.split()))]


def long_sentences(text: str) -> list[str]:
    """Sentences of a Markdown page with more than `WORDS` words."""
    sentences = [each for part in paragraphs(text) for each in re.split(r"(?<=[.!?])[\"')]* ", part)]
    return [each for each in sentences if len(re.findall(r"\w\S*", each)) > WORDS]


def words_left() -> Iterator[tuple[str, str]]:
    """File and identifier or word for each replaced word that is left, exceptions included."""
    for path in sources(*PACKAGES, "benchmarks", "tests"):
        yield from ((str(path.relative_to(ROOT)), name) for name in identifiers(path.read_text()))
    for path in pages():
        yield from ((str(path.relative_to(ROOT)), word) for word in words(path.read_text()))


def sentences_left() -> Iterator[tuple[str, str]]:
    """Page and sentence for each sentence that is too long."""
    for path in pages():
        yield from ((str(path.relative_to(ROOT)), sentence) for sentence in long_sentences(path.read_text()))


def run(quick: bool) -> Report:
    """Count; there is nothing to leave out when `quick`."""
    del quick
    folders = (*PACKAGES, "benchmarks", "tests")
    code = {part: sum(code_lines(path.read_text()) for path in sources(part)) for part in folders}
    lines = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in sources(*folders)}
    large = {file: count for file, count in lines.items() if count > LINES}
    uses = Counter(word for _, word in words_left())
    sentences = Counter(page for page, _ in sentences_left())
    left = {word: count for word, count in uses.items() if word not in EXCEPTIONS}
    values = {
        **{f"code_lines_{part}": count for part, count in code.items()},
        "code_lines_packages": sum(code[part] for part in PACKAGES),
        f"files_above_{LINES}_lines": len(large),
        **{f"public_names_{part}": len(importlib.import_module(part).__all__) for part in PACKAGES[1:]},
        "any_lines": sum(any_lines(path.read_text()) for path in sources(*PACKAGES)),
        "words_left": sum(left.values()),
        f"sentences_above_{WORDS}_words": sentences.total(),
    }
    of_words = {word: sum(n for name, n in left.items() if word in name.lower()) for word in REPLACED}
    return Report(
        values,
        [
            *({"file": file, "lines": count} for file, count in large.items()),
            *({"word": word, "left": count, "instead": REPLACED[word]} for word, count in of_words.items() if count),
            *({"exception": word, "uses": uses[word], "why": why} for word, why in EXCEPTIONS.items() if uses[word]),
            *({"page": page, "long_sentences": count} for page, count in sentences.items()),
        ],
    )


if __name__ == "__main__":
    for file, text in (*words_left(), *sentences_left()):
        print(f"{file}: {text}")
