"""The README and the pages of docs/: words in the README, links that lead nowhere, scene keys that no page explains."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path
from urllib.parse import urlsplit

from benchmarks.measure import ROOT, Report
from cooperative.scene import TABLES
from cooperative.scene.tables import keys, schema_of


def pages() -> list[str]:
    """The README, all pages of docs/ and the pages of the benchmarks' results, from the repository's root."""
    return [
        "README.md",
        *(str(p.relative_to(ROOT)) for folder in ("docs", "docs/notes") for p in sorted((ROOT / folder).glob("*.md"))),
        "benchmarks/RESULTS.md",
        *(str(p.relative_to(ROOT)) for p in sorted((ROOT / "benchmarks" / "pages").glob("*.md"))),
    ]


def page(path: str) -> str:
    """Text of a page."""
    return (ROOT / path).read_text()


def words(path: str) -> int:
    """Words of a page, blocks of code included."""
    return len(page(path).split())


def blocks(path: str, language: str) -> list[str]:
    """Fenced blocks of one language, which may stand in lists."""
    texts = re.findall(rf"^ *```{language}\n(.*?)^ *```", page(path), re.S | re.M)
    return [textwrap.dedent(block) for block in texts]


def broken_links(path: str) -> list[str]:
    """Links and figures of a page whose file, or heading in it, is not there. Addresses on the web are not followed."""
    text = re.sub(r"```.*?```", "", page(path), flags=re.S)
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        parts = urlsplit(target)
        if parts.scheme:
            continue
        file = (ROOT / path).parent / parts.path if parts.path else ROOT / path
        if not file.exists() or (parts.fragment and parts.fragment not in anchors(file)):
            broken.append(target)
    return broken


def anchors(file: Path) -> set[str]:
    """Names by which the headings of a page can be linked to: lower case, hyphens for spaces, no punctuation."""
    headings = re.findall(r"^#+ +(.*)$", file.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def undocumented_keys() -> list[str]:
    """Keys of scenes, as "[section] key", that docs/scenes.md does not explain in their own section: in a row of its
    table, or in that of the section whose keys it claims to share."""
    scenes = ROOT / "docs" / "scenes.md"
    parts = re.split(r"^## `\[+(\w+)\]+`$", scenes.read_text() if scenes.exists() else "", flags=re.M)
    by_section = dict(zip(parts[1::2], parts[2::2], strict=True))
    rows = {section: set(re.findall(r"^\| `(\w+)` \|", text, re.M)) for section, text in by_section.items()}
    for section, text in by_section.items():
        for other in re.findall(r"(?:Keys as in|any key of) `\[(\w+)\]`", text):
            rows[section] |= rows.get(other, set())
    return [
        f"[{section}] {key}"
        for section, table in TABLES.items()
        for key in keys(table)
        if key not in rows.get(section, ()) and key in schema_of(table)["properties"]
    ]


def run(quick: bool) -> Report:
    """Count; there is nothing to leave out when `quick`."""
    missing, broken = undocumented_keys(), {path: broken_links(path) for path in pages()}
    count = sum(len(keys(table)) for table in TABLES.values())
    values = {
        "readme_words": words("README.md"),
        "keys_documented": 1 - len(missing) / count,
        "links_broken": sum(map(len, broken.values())),
    }
    rows = [{"page": path, "words": words(path), "broken_links": broken[path]} for path in pages()]
    return Report(values, [*rows, *({"key_undocumented": key} for key in missing)])
