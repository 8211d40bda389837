"""What `cooperative` offers."""

import pytest

import cooperative


def test_it_offers_what_a_script_needs_and_no_more():
    assert len(cooperative.__all__) <= 37


def test_a_name_that_never_was_is_refused():
    with pytest.raises(AttributeError, match="nothing"):
        _ = cooperative.nothing
