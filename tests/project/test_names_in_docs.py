"""Names that docstrings and comments mention exist: modules, functions, arguments, members and files."""

import ast
import builtins
import importlib
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

from tests import ROOT

PACKAGES = ("jaxmpm", "kl")
MODULES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]

# Names in files and texts, which no Python object has.
FOREIGN = {
    "Steps": "a group of VTKHDF",
    "nvcc": "CUDA's compiler",
    "r_u": "an argument of `section` and `terrain`, which a ground of a user's own may take too",
    "_": "a character",
    **dict.fromkeys(
        ("gstools.CovModel", "anis", "len_scale", "rescale", "var", "Gaussian", "Linear"), "a word of GSTools"
    ),
}

SPAN = re.compile(r"`([^`\n]+)`")
NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
FILE = re.compile(r"\b(?:benchmarks|cooperative|docs|jaxmpm|kl|tests)/[\w/.-]+\.(?:cc|h|json|md|py|toml)\b")


def names(text: str) -> list[str]:
    """Dotted names in backticks: `name`, `module.name`, and what is called in `name(...)`."""
    dotted = []
    for span in SPAN.findall(text):
        match = NAME.match(span)
        if match and span[match.end() :][:1] in ("", "(") and (span[match.end() :] + ")")[-1] == ")":
            dotted.append(match.group())
    return dotted


def documented(path: Path) -> list[tuple[str, set[str]]]:
    """Each docstring of a module, with the arguments and variables of the functions around it; and each comment."""
    source = path.read_text()
    texts: list[tuple[str, set[str]]] = []

    def visit(node: ast.AST, around: set[str]) -> None:
        own = around
        if isinstance(node, ast.FunctionDef):
            inner = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
            own = around | inner | {each.arg for each in ast.walk(node) if isinstance(each, ast.arg)}
        if isinstance(node, ast.ClassDef):
            inner = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
            fields = [each.target for each in node.body if isinstance(each, ast.AnnAssign)]
            own = around | inner | {each.id for each in fields if isinstance(each, ast.Name)}
        for each in ast.iter_child_nodes(node):
            if (
                isinstance(each, ast.Expr)
                and isinstance(each.value, ast.Constant)
                and isinstance(each.value.value, str)
            ):
                texts.append((each.value.value, own))
            visit(each, own)

    tree = ast.parse(source)
    visit(tree, set())
    if ast.get_docstring(tree):
        texts[0] = (texts[0][0], {each.arg for each in ast.walk(tree) if isinstance(each, ast.arg)})
    everywhere = {each.id for each in ast.walk(tree) if isinstance(each, ast.Name)}
    comments = [t.string for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT]
    return texts + [(comment, everywhere) for comment in comments]


@cache
def members(package: str) -> set[str]:
    """Global names of all modules of a package, and the members of their classes."""
    known: set[str] = set()
    for module in (
        importlib.import_module(module_of(path)) for path in MODULES if path.parts[len(ROOT.parts)] == package
    ):
        known |= vars(module).keys()
        for thing in vars(module).values():
            if isinstance(thing, type) and thing.__module__.partition(".")[0] == package:
                known |= set(dir(thing)) | {
                    name for base in thing.__mro__ for name in vars(base).get("__annotations__", ())
                }
    return known


def has(thing: object, name: str) -> bool:
    bases = getattr(thing, "__mro__", ())
    return hasattr(thing, name) or any(name in vars(base).get("__annotations__", ()) for base in bases)


def resolves(name: str, module: str, around: set[str]) -> bool:
    """Whether a name is an argument nearby, a name of its module, one of its package, or can be imported."""
    first, *rest = name.split(".")
    if name in FOREIGN or first in around:
        return True
    package = module.partition(".")[0]
    thing = getattr(importlib.import_module(module), first, None)
    if thing is None and not rest:
        return first in members(package) or importable(first) or hasattr(builtins, first)
    if thing is None:
        thing = getattr(importlib.import_module(package), first, None)
    if thing is None:
        return importable(name)
    for part in rest:
        if not has(thing, part):
            return importable(name)
        thing = getattr(thing, part, None)
    return True


def importable(name: str) -> bool:
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:end]))
        except ImportError:
            continue
        for part in parts[end:]:
            if not has(thing, part):
                return False
            thing = getattr(thing, part, None)
        return True
    return False


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_names_in_docstrings_and_comments_exist():
    for path in MODULES:
        texts = documented(path)
        assert not {n for text, near in texts for n in names(text) if not resolves(n, module_of(path), near)}, path
        assert not [file for text, _ in texts for file in FILE.findall(text) if not (ROOT / file).exists()], path


def test_dotted_names_of_the_packages_in_docs_exist():
    for path in sorted((ROOT / "docs").glob("*.md")):
        mentioned = [name for name in names(path.read_text()) if name.partition(".")[0] in PACKAGES]
        assert not [name for name in mentioned if not importable(name)], path


@pytest.mark.parametrize(
    "name",
    ["jaxmpm.primitives", "jaxmpm.stencil.scatter", "jaxmpm.averages", "not_a_function", "kl.axis.Haar.depth", "never"],
)
def test_a_name_that_is_gone_is_seen(name):
    assert not resolves(name, "jaxmpm.transfer._transfers", {"position"})


@pytest.mark.parametrize("name", ["jaxmpm.transfer.p2g", "p2g", "position", "position.at", "Term.row", "numpy", "abs"])
def test_a_name_that_exists_is_resolved(name):
    assert resolves(name, "jaxmpm.transfer._transfers", {"position"})


def test_names_are_those_in_backticks():
    text = "`solve(..., axes=axes)`, `kl.plots`, `a @ b`, `**values`, plain, `(d, N)` and `x[0]`"
    assert names(text) == ["solve", "kl.plots"]
