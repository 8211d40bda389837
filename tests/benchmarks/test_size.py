"""How large the repository is: what counts as a line of code."""

import re

from benchmarks.project import size

CODE = '''"""Text of
two lines."""

import os  # a comment

VALUE = """a
b"""


def row(given, limit):
    """Say so."""
    boxes = given  # places
    return FileNotFoundError(boxes, limit, "told")
'''


def test_lines_of_code_leave_out_blanks_comments_and_docstrings():
    assert size.code_lines(CODE) == 6


def test_the_benchmark_counts_the_repository():
    values = size.run(quick=True).values
    parts = [values[f"code_lines_{part}"] for part in size.PACKAGES]
    assert min(parts) > 100
    assert values["code_lines_packages"] == sum(parts)
    assert {name for name in values if re.match("public_names", name)} == {
        f"public_names_{part}" for part in ("jaxmpm", "kl", "cooperative")
    }
