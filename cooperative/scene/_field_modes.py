"""How many modes a campaign's random soil has, kept in its folder.

An expansion takes as many modes as hold its share of the variance. Eigenvalues are rounded otherwise on another
machine, where one mode more or less may hold it; samples of the one would not be samples of the other. So the count of
the machine on which a campaign began stands for all that go on with it, work for it or read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cooperative.scene._campaign import Campaign, FieldModes
from cooperative.scene._kept import Kept
from cooperative.scene._schema import FIELD_MODES
from cooperative.scene._text import tables_of

KEPT = Kept("field_modes", FIELD_MODES, FieldModes, "numbers of modes")


def with_kept_field_modes(campaign: Campaign, folder: Path) -> Campaign:
    """The scene with the numbers of modes that its folder keeps, if it does. Raises ValueError where the file is
    damaged."""
    found = KEPT.there(folder)
    return campaign if found is None else with_field_modes(campaign, found.counts)


def keep_field_modes(campaign: Campaign, folder: Path, counts: Sequence[int]) -> Campaign:
    """Have the campaign's folder keep so many modes of each expansion, unless it keeps some. The scene with them."""
    KEPT.once(folder, lambda: FieldModes(tuple(counts)))
    return with_field_modes(campaign, counts)


def with_field_modes(campaign: Campaign, counts: Sequence[int]) -> Campaign:
    """The scene with so many modes of each expansion, in its text too, so that whoever reads the text has them. A scene
    whose text has them already keeps its own."""
    if KEPT.table in tables_of(campaign.text):
        return campaign
    found = FieldModes(tuple(counts))
    return replace(campaign, text=KEPT.in_text(campaign.text, found), field_modes=found)
