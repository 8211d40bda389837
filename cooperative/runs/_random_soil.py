"""The random parameters of a scene's soil and its water, their expansions, and which coefficients are whose.

Parameters that correlate share an expansion and are made from independent fields of it; their borehole values condition
all of them together, since a value of one informs the others. These values hold but for a factor that a sample may
multiply fields and values by alike, as an uncertain cone factor does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np

import kl
from cooperative.scene import Campaign, CrossCorrelation, RandomField
from jaxmpm.support import check
from jaxmpm.support.values import by_value
from kl.marginal import Marginal

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lowest corner and edges (d,) m."""
BESIDE = 0.5
"""Distance (m) beyond ground or layer up to which a borehole value is at its edge: elevations differ by survey."""
UNLIKELY = 5.0
"""Deviations of a borehole value from the median beyond which value and distribution hardly belong together."""
ROUNDING = 2e-5
"""Of the share of the variance that modes hold, with eigenvalues in single precision on two machines."""
REMEDY = (
    "delete what was measured (`sqlite3 campaign.db \"delete from campaign where name = 'measured'\"`); "
    "its samples are then those of this machine"
)


@by_value
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
        measured: fields and their borehole values, less the trend, where a sample's own mean shifts the scores of
            these; none where all means are known.
    """

    names: tuple[str, ...]
    expansion: kl.Expansion | kl.field.Waves
    box: Box
    root: np.ndarray | None
    conditioning: kl.field.Conditioning | None
    layer: int | None = None
    indices: np.ndarray | None = None
    measured: tuple[tuple[str, RandomField, np.ndarray], ...] = ()

    def coefficients(
        self, sample: jax.Array | np.ndarray, marginals: Mapping[str, Marginal] = MappingProxyType({})
    ) -> dict[str, jax.Array | np.ndarray]:
        """The coefficients (M,) of each parameter's field.

        Args:
            sample: (modes,) of the sample.
            marginals: of the sample by parameter, of those whose mean is uncertain.
        """
        vector = sample if self.indices is None else jnp.asarray(sample)[self.indices]
        conditioning = self.conditioning
        if conditioning is not None:
            if self.measured:
                scores = [
                    marginals.get(name, field.distribution).standardise(jnp.asarray(at))
                    for name, field, at in self.measured
                ]
                conditioning = replace(conditioning, mean=conditioning.gain @ jnp.concatenate(scores))
            vector = kl.conditioned(conditioning, vector)
        if self.root is None:
            return {self.names[0]: vector}
        fields = jnp.asarray(vector).reshape(len(self.names), -1)
        return dict(zip(self.names, jnp.asarray(self.root, fields.dtype) @ fields, strict=True))

    def inside(self, points: jax.Array) -> jax.Array:
        """The points (d, N) m, those beyond the box shifted to its faces.

        The middle of a particle's box that the surface cuts may lie above the ground's highest point, and points of
        other layers beyond a layer's own box.
        """
        corner, extent = (jnp.asarray(bounds, points.dtype)[:, None] for bounds in self.box)
        return jnp.clip(points, corner, corner + extent)


@by_value
@dataclass(frozen=True)
class RandomSoil:
    """All that is random in a campaign's soil: the same for every grid.

    Args:
        groups: of parameters that share an expansion.
        others: coefficients beside those of fields, which come last: the score of a water level.
        uncertain: fields whose mean and coefficient of variation each sample draws, with the layer at which they stop;
            the first coefficients of a sample, two for each, are their scores.
        factors: 1 where a factor multiplies whole fields, whose score is the next coefficient; else 0.
    """

    groups: tuple[Group, ...]
    others: int = 0
    uncertain: tuple[tuple[int | None, str, RandomField], ...] = ()
    factors: int = 0

    @property
    def modes(self) -> int:
        """Number of a sample's coefficients."""
        return self.of_fields + self.others

    @property
    def of_fields(self) -> int:
        """Number of them that are of fields."""
        modes = sum(len(group.names) * group.expansion.modes for group in self.groups)
        return modes + 2 * len(self.uncertain) + self.factors

    def scores(self, sample: jax.Array | np.ndarray, layer: int | None) -> dict[str, jax.Array]:
        """Scores (2,) of mean and coefficient of variation of each uncertain field that stops at a layer.

        Args:
            sample: (modes,) of the sample.
            layer: number of the one at which the fields stop, None for those that go through all.
        """
        pairs = jnp.asarray(sample)[: 2 * len(self.uncertain)].reshape(-1, 2)
        return {name: score for (stops, name, _), score in zip(self.uncertain, pairs, strict=True) if stops == layer}

    def marginal(
        self, field: RandomField | float, name: str, sample: jax.Array | np.ndarray, stops: int | None
    ) -> Marginal:
        """The marginal of a parameter in a layer, that of the sample where its mean is uncertain.

        Args:
            field: of the parameter there, or its number where it does not vary.
            name: of the parameter.
            sample: (modes,) of the sample.
            stops: number of the layer at which the field stops, None where it goes through all.
        """
        if not isinstance(field, RandomField):
            return kl.Normal(field, 0.0)
        scores = self.scores(sample, stops).get(name)
        return field.marginal_of(scores) if scores is not None and field.uncertain else field.distribution

    def factor(self, field: RandomField | float, sample: jax.Array | np.ndarray) -> jax.Array | None:
        """What multiplies a parameter everywhere in a layer, measured values included; None for nothing.

        Args:
            field: of the parameter there, or its number where it does not vary.
            sample: (modes,) of the sample.
        """
        if not isinstance(field, RandomField) or field.factor_cov == 0:
            return None
        return field.factor(jnp.asarray(sample)[2 * len(self.uncertain)])

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of modes of each group's expansion."""
        return tuple(group.expansion.modes for group in self.groups)

    @property
    def expansions(self) -> Mapping[str, kl.Expansion | kl.field.Waves]:
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
        groups = [group for group in self.groups if group.layer == layer]
        scores = self.scores(sample, layer)
        marginals = {name: field.marginal_of(scores[name]) for stops, name, field in self.uncertain if stops == layer}
        return {name: values for group in groups for name, values in group.coefficients(sample, marginals).items()}

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
    campaign.require()
    site, correlated = campaign.site, campaign.cross_correlation
    through = {name for name in campaign.varying if site.spans(name)}
    if correlated is not None and not through.isdisjoint(correlated.parameters):
        through |= {*correlated.parameters}
    fields = {name: field for name, field in campaign.varying.items() if name in through}
    parts = [_part(campaign, None, fields, (site.shape.corner, site.shape.extent))] if fields else []
    for number in range(len(site.layers)):
        if fields_there := campaign.varying_in(number):
            parts.append(_part(campaign, number, fields_there, site.box_of(number)))
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
    site, numerics = campaign.site, campaign.grids["refined"]
    points = np.array([row[:-1] for row in field.boreholes], float).T
    number = site.layer_of(points, numerics) if layer is None else np.full(points.shape[1], layer)
    if number is None:
        return tuple(site.depth(points, field, 0).tolist())
    depths = [
        site.depth(point[:, None], field, int(at), numerics)[0] for point, at in zip(points.T, number, strict=True)
    ]
    return tuple(map(float, depths))


@lru_cache(maxsize=8)
def _random_soil(
    parts: tuple[Part, ...], correlated: CrossCorrelation | None, counts: tuple[int, ...] | None
) -> RandomSoil:
    members = [(part, names) for part in parts for names in _members(part, correlated)]
    if counts is not None and len(counts) != len(members):
        raise ValueError(f"measured are {len(counts)} numbers of terms for {len(members)} expansions: {REMEDY}")
    groups, gathered = [], check.Gathered()
    for (part, names), count in zip(members, counts or (None,) * len(members), strict=True):
        with gathered.of():
            groups.append(_group(part, names, correlated, count))
    gathered.raise_all()
    uncertain = tuple((part[0], name, field) for part in parts for name, field in part[1] if field.uncertain)
    factors = int(any(field.factor_cov > 0 for part in parts for _, field in part[1]))
    first = 2 * len(uncertain) + factors
    return RandomSoil(
        tuple(groups if len(groups) < 2 and not first else _placed(groups, first)),
        uncertain=uncertain,
        factors=factors,
    )


def _members(part: Part, correlated: CrossCorrelation | None) -> list[tuple[str, ...]]:
    """The parameters of each group of a part."""
    names = [name for name, _ in part[1]]
    together = () if correlated is None or correlated.parameters[0] not in names else correlated.parameters
    members = [(name,) for name in names if name not in together] + ([together] if together else [])
    return sorted(members, key=lambda group: min(map(names.index, group)))


def _placed(groups: list[Group], first: int) -> list[Group]:
    """The groups with their indices among a sample's coefficients, from `first` on, those of most variance first.

    A design that spreads its first dimensions best serves all groups alike.
    """
    shares = [np.tile(np.asarray(group.expansion.fractions, float), len(group.names)) for group in groups]
    rank = np.argsort(np.argsort(-np.concatenate(shares), kind="stable"), kind="stable")
    ends = np.cumsum([0, *(share.size for share in shares)])
    return [
        replace(group, indices=first + rank[start:end])
        for group, start, end in zip(groups, ends[:-1], ends[1:], strict=True)
    ]


def _group(part: Part, names: tuple[str, ...], correlated: CrossCorrelation | None, count: int | None) -> Group:
    layer, fields, box, depths = part[0], MappingProxyType(dict(part[1])), part[2], dict(part[3])
    try:
        expansion = _expansion(fields[names[0]], box, count)
        root = None if correlated is None or names != correlated.parameters else correlated.gaussian_root(fields)
        conditioned = [(name, fields[name]) for name in names if fields[name].boreholes is not None]
        # Borehole values over what the trend multiplies the mean by.
        measured = tuple(
            (name, field, np.asarray(field.boreholes)[:, -1] / field.grown(np.array(depths[name])))
            for name, field in conditioned
        )
        conditioning = _conditioning(names, measured, expansion, box, root)
        shifted = measured if any(field.uncertain for _, field in conditioned) else ()
        return Group(names, expansion, box, root, conditioning, layer, measured=shifted)
    except ValueError as error:
        raise ValueError(f"random {' and '.join(names)}: {error}") from error


def _expansion(field: RandomField, box: Box, count: int | None) -> kl.Expansion | kl.field.Waves:
    """Of as many modes as hold the field's energy, or of `count` if these hold it but for rounding."""
    expansion = field.expansion(*box)
    if count is None or count == expansion.modes:
        return expansion
    if isinstance(expansion, kl.field.Waves):
        raise ValueError(f"measured are {count} terms, and form = 'elliptic' has {expansion.modes}: {REMEDY}")
    counted = field.expansion(*box, modes=count, solver=expansion.solvers)
    energies = np.cumsum(np.asarray(counted.fractions, float))
    if energies[-1] < field.energy - ROUNDING or (count > 1 and energies[-2] > field.energy + ROUNDING):
        raise ValueError(
            f"measured are {count} terms where energy = {field.energy:g} takes {expansion.modes}: {REMEDY}"
        )
    return counted


def _conditioning(
    names: tuple[str, ...],
    measured: tuple[tuple[str, RandomField, np.ndarray], ...],
    expansion: kl.Expansion | kl.field.Waves,
    box: Box,
    root: np.ndarray | None,
) -> kl.field.Conditioning | None:
    """What the borehole values of these parameters, less the trend, imply for their coefficients together."""
    weights = dict(zip(names, np.eye(1) if root is None else root, strict=True))
    rows, scores, errors = [], [], []
    for name, field, values in measured:
        data = np.asarray(field.boreholes)
        score = np.asarray(field.distribution.standardise(jnp.asarray(values)), float)
        if not np.isfinite(score).all():
            worst = data[int(np.argmin(np.isfinite(score)))]
            raise ValueError(
                f"the borehole value {worst[-1]:g} at {worst[:-1].tolist()} m cannot occur in {field.distribution}"
            )
        if (far := np.abs(score)).max() > UNLIKELY:
            worst = data[int(np.argmax(far))]
            check.warn(
                f"the borehole value {worst[-1]:g} of {name} at {worst[:-1].tolist()} m lies {far.max():.2g} deviations"
                f" from the median of {field.distribution}, more than {UNLIKELY:g}: compare units, mean, cov and trend"
            )
        (corner, extent), at = (np.array(side)[:, None] for side in box), data[:, :-1].T
        near = np.clip(at, corner, corner + extent)
        if (outside := (np.abs(near - at) > BESIDE).any(axis=0)).any():
            worst = data[int(np.argmax(outside))]
            raise ValueError(
                f"the borehole value {worst[-1]:g} at {worst[:-1].tolist()} m lies outside the ground, which reaches "
                f"from {list(box[0])} to {np.add(*box).tolist()} m (values outside: {int(outside.sum())} of "
                f"{len(data)}): correct their positions, or leave them out, as jaxmpm site --section does"
            )
        modes = np.asarray(kl.field.mode_matrix(expansion, np.where(np.abs(near - at) <= BESIDE, near, at)))
        rows.append(np.kron(weights[name][None], modes))
        scores.append(score)
        errors.append(np.full(len(score), field.borehole_error))
    if not rows:
        return None
    matrix = np.concatenate(rows)
    return kl.field.condition_on(
        matrix.astype(expansion.fractions.dtype), np.concatenate(scores), error=np.concatenate(errors)
    )
