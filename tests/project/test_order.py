"""Nothing follows the order of a set, which is another one in each process."""

import ast

import pytest

from tests import ROOT

FILES = sorted(path for package in ("jaxmpm", "kl", "cooperative") for path in (ROOT / package).rglob("*.py"))


def is_set(node: ast.expr) -> bool:
    """Whether an expression is a set by how it is written."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub | ast.BitAnd | ast.BitOr | ast.BitXor):
        sides = node.left, node.right
        return any(is_set(side) or is_called(side, "keys") for side in sides)
    return isinstance(node, ast.Set | ast.SetComp) or is_called(node, "set", "frozenset")


def is_called(node: ast.expr, *names: str) -> bool:
    if not isinstance(node, ast.Call):
        return False
    return getattr(node.func, "attr", None) in names or getattr(node.func, "id", None) in names


def loops_over_sets(text: str) -> list[int]:
    """Lines of loops and lists over a set; a set that is made of one has no order either."""
    inside = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.For | ast.ListComp | ast.DictComp)]
    iterated = [(n.iter,) if isinstance(n, ast.For) else tuple(g.iter for g in n.generators) for n in inside]
    return [each.lineno for iters in iterated for each in iters if is_set(each)]


def test_a_loop_over_a_set_is_seen():
    assert loops_over_sets(
        "for a in b.keys() - c.keys():\n    pass\nd = [e for e in set(f)]\nfor g in sorted({1}): pass"
    ) == [1, 3]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_loop_follows_the_order_of_a_set(path):
    assert loops_over_sets(path.read_text()) == []
