"""What a law of the user's own takes from outside counts in the checksum by which a folder knows it."""

import pytest

from cooperative.scene._words import source_checksum
from tests.cooperative.campaign.test_campaign_value import class_of_a_cell

OUTSIDE = """
import functools
SHARE, UNUSED, TABLE = 0.2, 1, {"a": (1.0, float("inf"))}

def logged(function):
    return functools.wraps(function)(lambda *given: function(*given))

@logged
def half(x):
    return x / 2

def made(factor):
    class Weak:
        def left(self):
            return factor * sum(SHARE * half(x) for x in TABLE["a"])
    return Weak

Weak = made(3.0)
"""


@pytest.mark.parametrize(
    ("change", "same"),
    [
        (("UNUSED, TABLE = 0.2, 1", "UNUSED, TABLE = 0.2, 2"), True),
        (("TABLE = 0.2", "TABLE = 0.3"), False),
        (("(1.0, ", "(2.0, "), False),
        (("x / 2", "x / 3"), False),
        (("made(3.0)", "made(4.0)"), False),
    ],
)
def test_a_class_is_known_by_the_values_and_functions_outside_it(change, same):
    """What a law takes from its module or the function around it makes another law when it changes."""
    changed = OUTSIDE.replace(*change)
    assert changed != OUTSIDE
    one, other = class_of_a_cell(OUTSIDE, "<cell 3>"), class_of_a_cell(changed, "<cell 4>")
    assert (source_checksum(one) == source_checksum(other)) is same
