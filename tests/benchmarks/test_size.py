"""How large the repository is: what counts as a line of code, as a word that is left and as a long sentence."""

import json
import re
import subprocess
import sys

from benchmarks.measure import ROOT
from benchmarks.project import size

CODE = '''"""Text of
two lines."""

import os  # a comment

VALUE: Any = """a
b"""


def found_row(kept, limit):
    """Say so."""
    moved_boxes = kept  # places
    return FileNotFoundError(moved_boxes, limit, "told", Any)
'''

PAGE = """# A found heading

A crew was used in place of `said`, [kept](found.md) here. Second.

```python
told = 1
```

| what | why |
|---|---|
| a | PLACES and so on |

- one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen
  sixteen seventeen eighteen nineteen twenty one two three four five six seven eight nine ten
  eleven.
"""


def test_lines_of_code_leave_out_blanks_comments_and_docstrings():
    assert size.code_lines(CODE) == 6
    assert size.any_lines(CODE) == 2


def test_identifiers_count_by_their_parts_and_strings_do_not():
    assert size.identifiers(CODE) == ["FileNotFoundError", "found_row", "kept", "moved_boxes"]
    assert size.identifiers("displace = unfound = replaced = 1") == []


def test_prose_counts_without_code_headings_and_links():
    assert size.words(PAGE) == ["crew", "in place", "kept", "places"]
    (sentence,) = size.long_sentences(PAGE)
    assert sentence.startswith("one two")
    assert sentence.endswith("eleven.")


def test_the_benchmark_counts_the_repository():
    command = [sys.executable, "-m", "benchmarks", "size", "--json"]
    answer = json.loads(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)
    values = answer["values"]
    parts = [values[f"code_lines_{part}"] for part in size.PACKAGES]
    assert min(parts) > 100
    assert values["code_lines_packages"] == sum(parts)
    assert values["files_above_350_lines"] == sum("lines" in row for row in answer["rows"])
    assert values["words_left"] >= max((row["left"] for row in answer["rows"] if "left" in row), default=0)
    assert all(row["why"] for row in answer["rows"] if "exception" in row)
    assert {name for name in values if re.match("public_names", name)} == {
        f"public_names_{part}" for part in ("jaxmpm", "kl", "cooperative")
    }
