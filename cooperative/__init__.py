"""Campaigns: screen samples on a rough grid, refine the ranked ones, estimate how likely the slope runs out.

from cooperative import open_store, rank_samples, next_refined, published, consequences
"""

from cooperative.consequences import Consequences, SlopeGeometry, consequences
from cooperative.estimators import Estimate, published, wilson_interval
from cooperative.ranking import Ranking, next_refined, rank_samples, stopping_rank
from cooperative.store import (
    DamagedFile,
    Rows,
    Sample,
    Store,
    open_store,
    read_rows,
    read_sample,
    read_store,
    sample_path,
    scene_digest,
    write_aside,
    write_sample,
)

__all__ = [
    "Consequences",
    "DamagedFile",
    "Estimate",
    "Ranking",
    "Rows",
    "Sample",
    "SlopeGeometry",
    "Store",
    "consequences",
    "next_refined",
    "open_store",
    "published",
    "rank_samples",
    "read_rows",
    "read_sample",
    "read_store",
    "sample_path",
    "scene_digest",
    "stopping_rank",
    "wilson_interval",
    "write_aside",
    "write_sample",
]
