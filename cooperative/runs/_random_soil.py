"""The random parameters of a scene's soil, their expansions, and which coefficients are whose.

Samples are here as the campaign's estimator draws and sees them.

Parameters that correlate share an expansion and are made from independent fields of it; their borehole values condition
all of them together, since a value of one tells of the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np

import kl
from cooperative.estimate import Phases, Sampling
from cooperative.scene import Campaign, CrossCorrelation, Given, RandomField
from cooperative.store import Rows

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lowest corner and edges (d,) m."""
ROUNDING = 2e-5
"""Of the share of the variance that modes hold, with eigenvalues in single precision on two machines."""
REMEDY = "delete the folder's measured.json, or its field_modes.json, whose samples are then those of this machine"


@dataclass(frozen=True)
class Group:
    """Parameters of one expansion.

    Args:
        names: theirs.
        expansion: of its fields.
        box: that is expanded on.
        root: (P, P), what makes their P fields correlated, None for one.
        conditioning: of all their coefficients, None without borehole values.
        layer: number of the one at which their fields stop, None where they go through all.
        indices: (P M,) which of a sample's coefficients these are, None for all of them in their order.
    """

    names: tuple[str, ...]
    expansion: kl.Expansion
    box: Box
    root: np.ndarray | None
    conditioning: kl.field.Conditioning | None
    layer: int | None = None
    indices: np.ndarray | None = None

    def coefficients(self, sample: jax.Array | np.ndarray) -> dict[str, jax.Array | np.ndarray]:
        """The coefficients (M,) of each parameter's field, of the sample's (modes,)."""
        own = sample if self.indices is None else jnp.asarray(sample)[self.indices]
        if self.conditioning is not None:
            own = kl.conditioned(self.conditioning, own)
        if self.root is None:
            return {self.names[0]: own}
        fields = jnp.asarray(own).reshape(len(self.names), -1)
        return dict(zip(self.names, jnp.asarray(self.root, fields.dtype) @ fields, strict=True))

    def inside(self, points: jax.Array) -> jax.Array:
        """The points (d, N) m, those beyond the box shifted to its faces.

        The middle of a particle's box that the surface cuts may lie above the ground's highest point, and points of
        other layers beyond a layer's own box.
        """
        corner, extent = (jnp.asarray(each, points.dtype)[:, None] for each in self.box)
        return jnp.clip(points, corner, corner + extent)


@dataclass(frozen=True)
class RandomSoil:
    """All that is random in a campaign's soil: the same for every grid.

    Args:
        groups: of parameters that share an expansion.
        others: coefficients beside those of fields, which come last: the score of a water level.
    """

    groups: tuple[Group, ...]
    others: int = 0

    @property
    def modes(self) -> int:
        """Number of a sample's coefficients."""
        return self.of_fields + self.others

    @property
    def of_fields(self) -> int:
        """Number of them that are of fields."""
        return sum(len(group.names) * group.expansion.modes for group in self.groups)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of modes of each group's expansion."""
        return tuple(group.expansion.modes for group in self.groups)

    @property
    def expansions(self) -> Mapping[str, kl.Expansion]:
        """The expansion of the field of each parameter that goes through all layers."""
        return {name: group.expansion for group in self.groups if group.layer is None for name in group.names}

    def coefficients(
        self, sample: jax.Array | np.ndarray, layer: int | None = None
    ) -> dict[str, jax.Array | np.ndarray]:
        """The coefficients (M,) of each parameter's field, of a sample's (modes,).

        Of the fields that go through all layers, or that stop at one.

        Raises:
            ValueError: another number of them.
        """
        if np.shape(sample) != (self.modes,):
            raise ValueError(f"coefficients of shape {np.shape(sample)}: give ({self.modes},), one for each mode")
        sample = sample[: self.of_fields]
        mine = [group for group in self.groups if group.layer == layer]
        return {name: own for group in mine for name, own in group.coefficients(sample).items()}

    def groups_of(self, parameter: str) -> Mapping[int | None, Group]:
        """The groups that a parameter is of, by the layer at which their fields stop."""
        return {group.layer: group for group in self.groups if parameter in group.names}


def random_soil(campaign: Campaign) -> RandomSoil:
    """What is random in the campaign's soil.

    Fields over the whole box of the ground, and over the box of a layer at which they stop.

    Args:
        campaign: the campaign.

    Raises:
        ValueError: fields that cannot be expanded, or borehole values that lie outside or contradict each other.
    """
    site, correlated = campaign.site, campaign.cross_correlation
    through = {name for name in campaign.random if site.spans(name)}
    if correlated is not None and not through.isdisjoint(correlated.parameters):
        through |= {*correlated.parameters}
    fields = {name: field for name, field in campaign.random.items() if name in through}
    parts = [_part(campaign, None, fields, (site.shape.corner, site.shape.extent))] if fields else []
    for number, layer in enumerate(site.layers):
        if layer.own:
            own = {name: field for name, field in layer.random.items() if name in layer.own}
            parts.append(_part(campaign, number, own, site.box_of(number)))
    soil = _random_soil(tuple(parts), correlated, campaign.measured.terms)
    return soil if site.level is None else replace(soil, others=1)


Part = tuple[int | None, tuple[tuple[str, RandomField], ...], Box, tuple[tuple[str, tuple[float, ...]], ...]]
"""The layer at which fields stop, these fields by parameter, the box that holds them, and the depth (m) of each of
their borehole values, as the trend counts it, by parameter."""


def _part(campaign: Campaign, layer: int | None, fields: Mapping[str, RandomField], box: Box) -> Part:
    depths = {name: _borehole_depths(campaign, layer, field) for name, field in fields.items()}
    return layer, tuple(fields.items()), box, tuple(depths.items())


def _borehole_depths(campaign: Campaign, layer: int | None, field: RandomField) -> tuple[float, ...]:
    """Depth (m) of borehole values as the trend counts it, in the layer in which each lies, or that of the field."""
    if field.boreholes is None:
        return ()
    site, numerics = campaign.site, campaign.refined
    points = np.array([row[:-1] for row in field.boreholes], float).T
    number = site.layer_of(points, numerics) if layer is None else np.full(points.shape[1], layer)
    if number is None:
        return tuple(site.depth(points, field, 0).tolist())
    each = [site.depth(point[:, None], field, int(at), numerics)[0] for point, at in zip(points.T, number, strict=True)]
    return tuple(map(float, each))


@lru_cache(maxsize=8)
def _random_soil(
    parts: tuple[Part, ...], correlated: CrossCorrelation | None, counts: tuple[int, ...] | None
) -> RandomSoil:
    members = [(part, names) for part in parts for names in _members(part, correlated)]
    if counts is not None and len(counts) != len(members):
        raise ValueError(f"measured are {len(counts)} numbers of terms for {len(members)} expansions: {REMEDY}")
    groups = [
        _group(part, names, correlated, count)
        for (part, names), count in zip(members, counts or (None,) * len(members), strict=True)
    ]
    return RandomSoil(tuple(groups if len(groups) == 1 else _placed(groups)))


def _members(part: Part, correlated: CrossCorrelation | None) -> list[tuple[str, ...]]:
    """The parameters of each group of a part."""
    names = [name for name, _ in part[1]]
    together = () if correlated is None or correlated.parameters[0] not in names else correlated.parameters
    members = [(name,) for name in names if name not in together] + ([together] if together else [])
    return sorted(members, key=lambda group: min(map(names.index, group)))


def _placed(groups: list[Group]) -> list[Group]:
    """The groups with their indices among a sample's coefficients, those of most variance first.

    A design that spreads its first dimensions best serves all groups alike.
    """
    shares = [np.tile(np.asarray(group.expansion.fractions, float), len(group.names)) for group in groups]
    rank = np.argsort(np.argsort(-np.concatenate(shares), kind="stable"), kind="stable")
    ends = np.cumsum([0, *(share.size for share in shares)])
    return [
        replace(group, indices=rank[start:end]) for group, start, end in zip(groups, ends[:-1], ends[1:], strict=True)
    ]


def _group(part: Part, names: tuple[str, ...], correlated: CrossCorrelation | None, count: int | None) -> Group:
    layer, fields, box, depths = part[0], MappingProxyType(dict(part[1])), part[2], dict(part[3])
    try:
        expansion = _expansion(fields[names[0]], box, count)
        root = None if correlated is None or names != correlated.parameters else correlated.gaussian_root(fields)
        return Group(names, expansion, box, root, _conditioning(names, fields, expansion, root, depths), layer)
    except ValueError as error:
        raise ValueError(f"random {' and '.join(names)}: {error}") from error


def _expansion(field: RandomField, box: Box, count: int | None) -> kl.Expansion:
    """Of as many modes as hold the field's energy, or of `count` if these hold it but for rounding."""
    expand = partial(kl.expand, field.covariance, *box, bedding=field.bedding)
    own = expand(energy=field.energy)
    if count is None or count == own.modes:
        return own
    counted = expand(modes=count, solver=own.solvers)
    held = np.cumsum(np.asarray(counted.fractions, float))
    if held[-1] < field.energy - ROUNDING or (count > 1 and held[-2] > field.energy + ROUNDING):
        raise ValueError(f"measured are {count} terms where energy = {field.energy:g} takes {own.modes}: {REMEDY}")
    return counted


def _conditioning(
    names: tuple[str, ...],
    fields: Mapping[str, RandomField],
    expansion: kl.Expansion,
    root: np.ndarray | None,
    depths: Mapping[str, tuple[float, ...]],
) -> kl.field.Conditioning | None:
    """What the borehole values of these parameters, at these depths (m), say of their coefficients together."""
    weights = np.eye(1) if root is None else root
    rows, scores, errors = [], [], []
    for weight, name in zip(weights, names, strict=True):
        field = fields[name]
        if field.boreholes is None:
            continue
        data = np.asarray(field.boreholes)
        points = data[:, :-1].T
        values = data[:, -1] / field.grown(np.array(depths[name]))
        score = np.asarray(field.distribution.standardise(jnp.asarray(values)), float)
        if not np.isfinite(score).all():
            worst = data[int(np.argmin(np.isfinite(score)))]
            raise ValueError(
                f"the borehole value {worst[-1]:g} at {worst[:-1].tolist()} m cannot occur in {field.distribution}"
            )
        modes = np.asarray(kl.field.mode_matrix(expansion, points))
        rows.append(np.kron(weight[None], modes))
        scores.append(score)
        errors.append(np.full(len(score), field.borehole_error))
    if not rows:
        return None
    matrix = np.concatenate(rows)
    return kl.field.condition_on(
        matrix.astype(expansion.axes[0].fractions.dtype), np.concatenate(scores), error=np.concatenate(errors)
    )


def coefficients_of(campaign: Campaign, soil: RandomSoil) -> np.ndarray:
    """Coefficients of the scene's samples (samples, modes), by the design that it asks for.

    Args:
        campaign: the campaign.
        soil: its random soil.
    """
    plan = campaign.plan
    return np.asarray(plan.coefficients(jax.random.key(plan.seed), plan.samples, soil.modes))


def sampling_of(campaign: Campaign) -> Sampling:
    """The first phase as the campaign's estimator sees it; random fields are expanded when first asked for.

    Args:
        campaign: the campaign.
    """
    return Sampling(
        campaign.plan.samples,
        campaign.run.failure_displacement,
        campaign.plan.screening_stop,
        modes=lambda: int(random_soil(campaign).modes),
        draw=lambda: coefficients_of(campaign, random_soil(campaign)),
    )


def samples_of(campaign: Campaign) -> int | None:
    """Samples of the first phase; None where the estimator of a script, which alone knows, is not here.

    Args:
        campaign: the campaign.
    """
    if isinstance(campaign.estimator, Given):
        return None
    return campaign.estimator.rough_runs(sampling_of(campaign))


def phases_of(campaign: Campaign, rough: Rows, refined: Rows) -> Phases:
    """Both phases by the rows of both grids, for the campaign's estimator.

    Args:
        campaign: the campaign.
        rough: rows of the rough grid.
        refined: rows of the refined grid.
    """
    return Phases.known(campaign.estimator, sampling_of(campaign), rough.results, refined.results)
