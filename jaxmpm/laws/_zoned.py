"""Ground of several laws: each applies to the particles of its own zone; zones follow one another in the arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import Any, ClassVar, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.tree_util import PyTreeDef
from jax.typing import ArrayLike

from jaxmpm.grid import Particles
from jaxmpm.laws._base import stiffened
from jaxmpm.laws._gap import remembers_gap, update_with_gap
from jaxmpm.laws._parameter import Declared, declared, has_strength, with_parameters
from jaxmpm.laws._saturated import drained, excess_pressure, flooded
from jaxmpm.laws._undrained import at_time
from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.support.check import Limit
from jaxmpm.support.pytrees import pytree
from jaxmpm.support.tracing import array, host, on_host
from jaxmpm.tensors import CARRIED, absent, placed, rows

Tree = TypeVar("Tree")


@pytree
@dataclass(frozen=True)
class Zoned:
    """Laws of several zones, in the order of the particles: the first `counts[0]` of them follow the first law.

    A law updates the stress of its own particles alone, with their gap and history. A parameter that several laws have
    goes by one name and is one value per particle (N,) of the ground.

    Args:
        laws: each a `Material` that is not zoned; each parameter is a number or one value per particle of the zone.
        counts: particles of each zone; static.
    """

    PARAMETERS: ClassVar[Mapping[str, Limit]] = {}

    laws: tuple[Material, ...]
    counts: tuple[int, ...] = field(metadata={"static": True})

    @property
    def zones(self) -> Iterator[tuple[Material, slice]]:
        """Each law and the slice of its particles."""
        ends = accumulate(self.counts, initial=0)
        return zip(self.laws, (slice(*pair) for pair in pairwise(ends)), strict=True)

    def per_particle(self, values: Sequence[ArrayLike]) -> Array:
        """One value per particle (N,) from one for each zone, a number or (n,)."""
        on_cpu, numbers = on_host(tuple(values)), host(*values)
        pairs = zip(on_cpu, self.counts, strict=True)
        spread = [numbers.broadcast_to(numbers.asarray(value), (count,)) for value, count in pairs]
        return array(numbers.concatenate(spread), jnp.result_type(*values))

    @property
    def FRICTIONAL(self) -> bool:
        """Whether the strength of a zone depends on the mean stress."""
        return any(law.FRICTIONAL for law in self.laws)

    @property
    def bulk(self) -> Array:
        """Elastic bulk modulus K (N,) Pa."""
        return self.per_particle([law.bulk for law in self.laws])

    @property
    def shear(self) -> Array:
        """Elastic shear modulus G (N,) Pa."""
        return self.per_particle([law.shear for law in self.laws])

    @property
    def p_wave_modulus(self) -> Array:
        """Modulus of the fastest elastic wave (N,) Pa."""
        return self.per_particle([law.p_wave_modulus for law in self.laws])

    @property
    def steepest_softening(self) -> Array | None:
        """Largest loss of strength per unit of plastic shear strain (N,) Pa, 0 without; None if no zone softens."""
        slopes = [law.steepest_softening for law in self.laws]
        if all(steepest is None for steepest in slopes):
            return None
        return self.per_particle([0.0 if steepest is None else steepest for steepest in slopes])

    def initial_history(self, particles: Particles) -> History:
        """The histories of all zones as one.

        Args:
            particles: of the ground.

        Returns:
            Array (N,) or a pytree of them, 0 in zones without history; a tuple of such, one for each structure, where
            zones have histories of different structures; None if no zone has one.
        """
        histories = [law.initial_history(_of_zone(particles, span)) for law, span in self.zones]
        kinds = {jax.tree.structure(history): history for history in histories if history is not None}
        return _one([self._filled(histories, kind, like) for kind, like in kinds.items()])

    def _filled(self, histories: Sequence[History], kind: PyTreeDef, like: History) -> History:
        """Histories of one structure, 0 in zones whose history has another or that have none."""
        none = jax.tree.map(lambda _: 0.0, like)
        filled = [history if jax.tree.structure(history) == kind else none for history in histories]
        return jax.tree.map(lambda *parts: self.per_particle(parts), *filled)

    def history_at_rest(self, history: History, stress: Tensor) -> History:
        """The history as each zone has it that is at rest under a stress (Pa)."""
        if history is None:
            return None

        def at_rest(part: Material, span: slice, before: History) -> History:
            return part.history_at_rest(before, _of_zone(stress, span))

        return self._by_zone(history, stress, at_rest)

    def _by_zone(
        self, history: History, like: Tensor, function: Callable[[Material, slice, History], History]
    ) -> History:
        """The history after a function of the law, the particles and the history of each zone."""
        after = []
        for law, span, index, before in self._histories(history, like):
            new = function(law, span, None if index is None else before[index])
            after.append(tuple(new if i == index else value for i, value in enumerate(before)))
        return _one([jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *kind) for kind in zip(*after, strict=True)])

    def _histories(
        self, history: History, like: Tensor
    ) -> Iterator[tuple[Material, slice, int | None, tuple[History, ...]]]:
        """Law and particles of each zone, and its histories of all structures, of which the index tells its own."""
        structures = [_structure(law, span, like) for law, span in self.zones]
        kinds = list(dict.fromkeys(known_structure for known_structure in structures if known_structure is not None))
        parts = () if history is None else (history,) if len(kinds) == 1 else history
        for (law, span), structure in zip(self.zones, structures, strict=True):
            yield law, span, None if structure is None else kinds.index(structure), _of_zone(parts, span)

    def reduced(self, factor: Array) -> Zoned:
        """The law with the strength of every zone that has some divided by `factor`; ValueError if none has."""
        strong = [has_strength(law) for law in self.laws]
        if not any(strong):
            raise ValueError(f"no zone of {_names(self)} has strength to divide: give one that has")
        pairs = zip(self.laws, strong, strict=True)
        return replace(self, laws=tuple(law.reduced(factor) if divided else law for law, divided in pairs))

    def stiffened(self, bulk: Array, shear: Array, pressure: Array) -> Zoned:
        """The law with other moduli (Pa) in every zone, see `jaxmpm.laws.stiffened`."""
        parts = ((law, _of_zone((bulk, shear, pressure), span)) for law, span in self.zones)
        return replace(self, laws=tuple(stiffened(law, *numbers) for law, numbers in parts))

    def update(
        self, strain_increment: Tensor, stress: Tensor, history: History, dt: Array | None = None
    ) -> tuple[Tensor, History]:
        """Stress (Pa) and history after a strain increment within dt (s), of each zone by its own law."""
        return update_with_gap(self, strain_increment, stress, history, dt, gap=None)[:2]


def laws_of(law: Material) -> tuple[Material, ...]:
    """The laws of all zones.

    Args:
        law: zoned or not.

    Returns:
        The law of each zone, or the law itself.
    """
    return law.laws if isinstance(law, Zoned) else (law,)


def in_total_stress(law: Material) -> bool:
    """Whether a law's strength is undrained, that is of total stress without a known pore pressure.

    Args:
        law: of one zone, or zoned.

    Returns:
        Whether it is.
    """
    return has_strength(law) and not law.FRICTIONAL


def frictional(law: Material) -> bool | Array:
    """Whether strength depends on the mean stress.

    Args:
        law: of the scene.

    Returns:
        A bool, or one per particle (N,) where zones differ.
    """
    kinds = [zone.FRICTIONAL for zone in laws_of(law)]
    return law.per_particle(kinds) if isinstance(law, Zoned) and len(set(kinds)) > 1 else kinds[0]


def softened(law: Material, strain: Array) -> Array | None:
    """Share of the strength of undrained soil that a plastic shear strain leaves.

    Args:
        law: of the scene.
        strain: of each particle (N,).

    Returns:
        (N,), 1 for soil with friction and where nothing softens; None if no undrained soil softens.
    """

    def share(law: Any, strain: Array) -> Array | None:
        if law.FRICTIONAL or getattr(law, "softening", None) is None:
            return None
        remaining: Array = law.softening.strength(law.strength, strain) / law.strength
        return remaining

    if not isinstance(law, Zoned):
        return share(law, strain)
    shares = [share(part, strain[span]) for part, span in law.zones]
    if all(zone_share is None for zone_share in shares):
        return None
    return law.per_particle([1.0 if zone_share is None else zone_share for zone_share in shares])


@remembers_gap.register
def _(law: Zoned) -> bool:
    return any(map(remembers_gap, law.laws))


@flooded.register
def _(law: Zoned, pressure: Array) -> Zoned:
    return replace(law, laws=tuple(flooded(part, pressure[span]) for part, span in law.zones))


@drained.register
def _(law: Zoned) -> Zoned:
    return replace(law, laws=tuple(map(drained, law.laws)))


@excess_pressure.register
def _(law: Zoned, history: History, like: Tensor) -> Array | None:
    pressures = [
        None if index is None else excess_pressure(part, histories[index], like)
        for part, _, index, histories in law._histories(history, like)
    ]
    if all(pressure is None for pressure in pressures):
        return None
    return law.per_particle([0.0 if pressure is None else pressure for pressure in pressures])


@update_with_gap.register
def _(
    law: Zoned,
    strain: Tensor,
    stress: Tensor,
    history: History,
    dt: Array | None,
    *,
    gap: Array | None,
    received: Array | None = None,
    logarithmic: bool = False,
) -> tuple[Tensor, History, Array | None]:
    present = [k for k in range(6) if not (absent(strain[k]) and absent(stress[k]))]
    components, gaps = [], []

    def updated(part: Material, span: slice, before: History) -> History:
        opened = _of_zone(gap, span)
        after = update_with_gap(
            part,
            _of_zone(strain, span),
            _of_zone(stress, span),
            before,
            dt,
            gap=opened if remembers_gap(part) else None,
            received=_of_zone(received, span),
            logarithmic=logarithmic,
        )
        # All components of a zone at once: XLA on CPU takes ten times as long to concatenate them one by one.
        components.append(jnp.stack([after[0][k] for k in present]))
        # A law without memory loses what the average over a cell gives its particles.
        gaps.append(jnp.zeros_like(opened) if after[2] is None and opened is not None else after[2])
        return after[1]

    history = law._by_zone(
        history, placed((k, stress[k] if absent(strain[k]) else strain[k]) for k in present), updated
    )
    stress = placed(zip(present, rows(jnp.concatenate(components, axis=1)), strict=True))
    return stress, history, jax.tree.map(lambda *parts: jnp.concatenate(parts), *gaps)


@at_time.register
def _(law: Zoned, time: Array) -> Zoned:
    return replace(law, laws=tuple(at_time(part, time) for part in law.laws))


def weakens_until(law: Material) -> Array | None:
    """Time (s) at which the last loss of strength over time ends; None without such a loss.

    Args:
        law: of the scene.

    Returns:
        ().
    """
    losses = [loss for part in laws_of(law) if (loss := getattr(part, "loss", None)) is not None]
    return jnp.max(jnp.stack([jnp.max(loss.duration) for loss in losses])) if losses else None


@declared.register
def _(law: Zoned) -> dict[str, Declared]:
    zones = [declared(part) for part in law.laws]
    numbers: dict[str, Declared] = {}
    for name in dict.fromkeys(name for zone in zones for name in zone):
        having = [zone[name] for zone in zones if name in zone]
        value = law.per_particle([zone[name].value if name in zone else np.nan for zone in zones])
        path = having[0].path if len({number.path for number in having}) == 1 else name
        numbers[name] = Declared(path, having[0].parameter, value)
    return numbers


@with_parameters.register
def _(law: Zoned, values: Mapping[str, ArrayLike]) -> Zoned:
    taken: set[str] = set()
    laws = []
    for part, span in law.zones:
        varied = declared(part).keys() & values.keys()
        taken |= varied
        laws.append(with_parameters(part, {name: _of_zone(values[name], span) for name in varied}))
    if unknown := sorted(values.keys() - taken):
        raise ValueError(f"{unknown} is a parameter of no zone of {_names(law)}: give some of {sorted(declared(law))}")
    return replace(law, laws=tuple(laws))


def _of_zone(tree: Tree, span: slice) -> Tree:
    """The particles of a zone in every array whose last axis runs over the particles of the ground."""
    return jax.tree.map(lambda leaf: leaf[..., span] if np.ndim(leaf) else leaf, tree)


def _structure(law: Material, span: slice, like: Tensor) -> PyTreeDef | None:
    """Structure of the history of a law's own particles, None without, of the dimension and precision of a tensor."""
    count, dtype = span.stop - span.start, jnp.result_type(like[0])
    dimension = next(d for d in (3, 2, 1) if not any(absent(like[k]) for k in CARRIED[d]))
    values = jax.ShapeDtypeStruct((count,), dtype)
    particles = Particles(jax.ShapeDtypeStruct((dimension, count), dtype), values, values)  # type: ignore[arg-type]
    history = jax.eval_shape(law.initial_history, particles)
    return None if history is None else jax.tree.structure(history)


def _one(parts: Sequence[History]) -> History:
    """None of no parts, the part of one, and a tuple of several."""
    return (parts[0] if len(parts) == 1 else tuple(parts)) if parts else None


def _names(law: Zoned) -> str:
    return " and ".join(type(part).__name__ for part in law.laws)
