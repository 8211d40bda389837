"""What `cooperative` offers, and names that have left it for their rooms."""

from importlib import import_module

import pytest

import cooperative


def test_it_offers_what_a_script_needs_and_no_more():
    assert len(cooperative.__all__) <= 55


@pytest.mark.parametrize("room", cooperative.RELOCATED)
def test_a_relocated_name_is_that_of_its_room_and_warns(room):
    for name in cooperative.RELOCATED[room].split():
        with pytest.warns(DeprecationWarning, match=f"cooperative.{name} is cooperative.{room}.{name}"):
            relocated = getattr(cooperative, name)
        assert relocated is getattr(import_module(f"cooperative.{room}"), name)


def test_a_name_that_never_was_is_refused():
    with pytest.raises(AttributeError, match="nothing"):
        _ = cooperative.nothing
