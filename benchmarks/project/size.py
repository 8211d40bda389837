"""How large the repository is.

`code_lines_*` are lines without blanks, comments and docstrings. `public_names_*` are the names that a package exports.
"""

from __future__ import annotations

import ast
import importlib
import io
import tokenize
from pathlib import Path

from benchmarks.measure import ROOT, Report

PACKAGES = ("jaxmpm", "kl", "cooperative")

_SKIPPED = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE),
    *(tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER),
}


def sources(folder: str) -> list[Path]:
    """Python files of a folder of the repository."""
    return sorted((ROOT / folder).rglob("*.py"))


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


def run(quick: bool) -> Report:
    """Count; there is nothing to leave out when `quick`."""
    del quick
    code = {
        folder: sum(code_lines(path.read_text()) for path in sources(folder))
        for folder in (*PACKAGES, "benchmarks", "tests")
    }
    values = {
        **{f"code_lines_{folder}": count for folder, count in code.items()},
        "code_lines_packages": sum(code[package] for package in PACKAGES),
        **{f"public_names_{package}": len(importlib.import_module(package).__all__) for package in PACKAGES},
    }
    return Report(values, [])
