"""Ground of several laws: each applies to the particles of its own zone; zones follow one another in the arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import ClassVar, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxmpm.grid import Particles
from jaxmpm.laws._gap import remembers_gap, update_with_gap
from jaxmpm.laws._parameter import Declared, declared, has_strength, with_parameters
from jaxmpm.protocols import History, Material, Tensor
from jaxmpm.support.check import Limit
from jaxmpm.support.pytrees import pytree
from jaxmpm.tensors import absent, placed, rows

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
        each = zip(values, self.counts, strict=True)
        return jnp.concatenate([jnp.broadcast_to(jnp.asarray(value), (count,)) for value, count in each])

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
        each = [law.steepest_softening for law in self.laws]
        if all(steepest is None for steepest in each):
            return None
        return self.per_particle([0.0 if steepest is None else steepest for steepest in each])

    def initial_history(self, particles: Particles) -> History:
        """The histories of all zones as one.

        Args:
            particles: of the ground.

        Returns:
            Array (N,) or a pytree of them, 0 in zones without history; None if no zone has one.

        Raises:
            ValueError: If zones have histories of different structures.
        """
        each = [law.initial_history(_of_zone(particles, own)) for law, own in self.zones]
        known = {jax.tree.structure(history): history for history in each if history is not None}
        if len(known) > 1:
            raise ValueError(
                f"zones of {_names(self)} have histories of different structures: give laws with the same history"
            )
        if not known:
            return None
        (like,) = known.values()
        filled = [jax.tree.map(lambda _: 0.0, like) if history is None else history for history in each]
        return jax.tree.map(lambda *parts: self.per_particle(parts), *filled)

    def reduced(self, factor: Array) -> Zoned:
        """The law with the strength of every zone that has some divided by `factor`; ValueError if none has."""
        strong = [has_strength(law) for law in self.laws]
        if not any(strong):
            raise ValueError(f"no zone of {_names(self)} has strength to divide: give one that has")
        pairs = zip(self.laws, strong, strict=True)
        return replace(self, laws=tuple(law.reduced(factor) if divided else law for law, divided in pairs))

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
    kinds = [each.FRICTIONAL for each in laws_of(law)]
    return law.per_particle(kinds) if isinstance(law, Zoned) and len(set(kinds)) > 1 else kinds[0]


@remembers_gap.register
def _(law: Zoned) -> bool:
    return any(map(remembers_gap, law.laws))


@update_with_gap.register
def _(
    law: Zoned,
    strain: Tensor,
    stress: Tensor,
    history: History,
    dt: Array | None,
    *,
    gap: Array | None,
    logarithmic: bool = False,
) -> tuple[Tensor, History, Array | None]:
    present = [k for k in range(6) if not (absent(strain[k]) and absent(stress[k]))]
    components, histories, gaps = [], [], []
    for part, own in law.zones:
        before = _of_zone((history, gap), own)
        after = update_with_gap(
            part,
            _of_zone(strain, own),
            _of_zone(stress, own),
            before[0] if _has_history(part, own, strain) else None,
            dt,
            gap=before[1] if remembers_gap(part) else None,
            logarithmic=logarithmic,
        )
        # All components of a zone at once: XLA on CPU takes ten times as long to concatenate them one by one.
        components.append(jnp.stack([after[0][k] for k in present]))
        histories.append(before[0] if after[1] is None else after[1])
        # A law without memory loses what the average over a cell gives its particles.
        gaps.append(jnp.zeros_like(before[1]) if after[2] is None and before[1] is not None else after[2])
    stress = placed(zip(present, rows(jnp.concatenate(components, axis=1)), strict=True))
    history, gap = (jax.tree.map(lambda *parts: jnp.concatenate(parts), *each) for each in (histories, gaps))
    return stress, history, gap


@declared.register
def _(law: Zoned) -> dict[str, Declared]:
    zones = [declared(part) for part in law.laws]
    numbers: dict[str, Declared] = {}
    for name in dict.fromkeys(name for known in zones for name in known):
        having = [known[name] for known in zones if name in known]
        value = law.per_particle([known[name].value if name in known else np.nan for known in zones])
        path = having[0].path if len({each.path for each in having}) == 1 else name
        numbers[name] = Declared(path, having[0].parameter, value)
    return numbers


@with_parameters.register
def _(law: Zoned, values: Mapping[str, ArrayLike]) -> Zoned:
    taken: set[str] = set()
    laws = []
    for part, own in law.zones:
        paths = {name: each.path for name, each in declared(part).items()}
        mine = {name: path for name, path in {**paths, **{path: path for path in paths.values()}}.items()
                if name in values}  # fmt: skip
        taken |= mine.keys()
        laws.append(with_parameters(part, {path: _of_zone(values[name], own) for name, path in mine.items()}))
    if unknown := sorted(values.keys() - taken):
        raise ValueError(f"{unknown} is a parameter of no zone of {_names(law)}: give some of {sorted(declared(law))}")
    return replace(law, laws=tuple(laws))


def _of_zone(tree: Tree, own: slice) -> Tree:
    """The particles of a zone in every array whose last axis runs over the particles of the ground."""
    return jax.tree.map(lambda leaf: leaf[..., own] if np.ndim(leaf) else leaf, tree)


def _has_history(law: Material, own: slice, like: Tensor) -> bool:
    """Whether a law has a history of its own particles."""
    count, dtype = own.stop - own.start, jnp.result_type(like[0])
    values = jax.ShapeDtypeStruct((count,), dtype)
    particles = Particles(jax.ShapeDtypeStruct((3, count), dtype), values, values)  # type: ignore[arg-type]
    return jax.eval_shape(law.initial_history, particles) is not None


def _names(law: Zoned) -> str:
    return " and ".join(type(part).__name__ for part in law.laws)
