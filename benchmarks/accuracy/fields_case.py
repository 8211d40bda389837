"""One method of making random fields, timed in a process of its own: `python -m benchmarks.accuracy.fields_case JSON`.

A method is set up for a lattice, timed, and its covariance compared with the exact one over all pairs of seven points
per axis. The last line printed is a JSON object.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.fft

import kl
from benchmarks.measure import peak_memory_mb, timed
from kl.axis._fredholm import axis_modes

BATCH = 100
PROBES = 7

Made = tuple[Callable[[], Any], Callable[[], Any], int, dict[str, Any]]


def covariance_of(lengths: list[float]) -> tuple[kl.SquaredExponential, ...]:
    """Squared exponential on every axis."""
    return tuple(kl.SquaredExponential(length) for length in lengths)


def lattice(extent: list[float], cell: float) -> tuple[Any, ...]:
    """Centres of the cells along each axis (m)."""
    return tuple(np.arange(cell / 2, size, cell, dtype=np.float32) for size in extent)


def expansion_case(case: dict[str, Any], solver: Any, **truncation: Any) -> Made:
    """An expansion: set-up, a batch on the lattice (memory reused), and the error of its covariance."""
    lengths, extent = case["lengths"], case["extent"]
    axes = tuple(map(jnp.asarray, lattice(extent, case["cell"])))

    def setup() -> Any:
        return jax.block_until_ready(
            kl.expand(covariance_of(lengths), (0.0,) * len(extent), tuple(extent), solver=solver, **truncation)
        )

    expansion = setup()
    count = case.get("batch", BATCH)
    coefficients = kl.monte_carlo(jax.random.key(0), count, expansion.modes)
    buffer = [kl.field_on_lattice(expansion, coefficients, axes)]

    def batch() -> Any:
        buffer[0] = kl.field_on_lattice(expansion, coefficients, axes, out=buffer[0]).block_until_ready()

    captured = kl.captured_variance(expansion, pair_probes=PROBES)
    return (
        setup,
        batch,
        count,
        {
            "modes": expansion.modes,
            "variance_mean": captured.mean,
            "variance_worst": captured.worst,
            "error_worst": captured.correlation_error,
            "error_rms": captured.correlation_error_rms,
            "error_rescaled": captured.rescaled_error,
        },
    )


def haar(case: dict[str, Any]) -> Made:
    """Haar wavelet-Galerkin of one level on every axis, nearly all the variance that it holds."""
    level = case["parameter"]
    energy = 1.0
    for correlation, size in zip(covariance_of(case["lengths"]), case["extent"], strict=True):
        energy *= float(axis_modes(correlation, kl.axis.Haar(level), 0.0, size).fractions.sum())
    return expansion_case(case, kl.axis.Haar(level), energy=min(0.9999, energy * 0.9999))


def nystrom(case: dict[str, Any]) -> Made:
    """Gauss-Legendre Nystrom of one order on every axis, 99.99 % of the variance."""
    return expansion_case(case, kl.axis.Nystrom(case["parameter"]), energy=0.9999)


def truncated(case: dict[str, Any]) -> Made:
    """The default solver, truncated by energy."""
    return expansion_case(case, None, energy=case["parameter"])


def untruncated(case: dict[str, Any]) -> Made:
    """Kronecker roots of the lattice's covariance, from white noise."""
    axes = lattice(case["extent"], case["cell"])

    def setup() -> Any:
        return jax.block_until_ready(kl.field.exact_lattice(covariance_of(case["lengths"]), axes))

    roots = setup()
    count = case.get("batch", BATCH)
    shape = tuple(map(len, axes))
    key = jax.random.key(0)

    def batch() -> Any:
        return kl.field.exact_field(roots, jax.random.normal(key, (count, *shape))).block_until_ready()

    made, exact = jnp.ones(()), jnp.ones(())
    for root, x, length in zip(roots.roots, axes, case["lengths"], strict=True):
        chosen = np.linspace(0, len(x) - 1, PROBES).astype(int)
        target = np.exp(-(((x[chosen][:, None] - x[chosen]) / length) ** 2))
        made, exact = jnp.kron(made, (root @ root)[chosen][:, chosen]), jnp.kron(exact, target)
    return setup, batch, count, _errors(np.asarray(made - exact))


def dense(case: dict[str, Any]) -> Made:
    """Eigendecomposition of the whole covariance matrix, in float64 as it needs."""
    axes = lattice(case["extent"], case["cell"])

    def setup() -> Any:
        matrix = np.ones((1, 1))
        for x, length in zip(axes, case["lengths"], strict=True):
            x = x.astype(np.float64)
            matrix = np.kron(matrix, np.exp(-(((x[:, None] - x) / length) ** 2)))
        shares, vectors = np.linalg.eigh(matrix)
        return vectors * np.sqrt(np.maximum(shares, 0)), matrix

    root, matrix = setup()
    root32 = root.astype(np.float32)
    noise = np.random.default_rng(0).standard_normal((root.shape[1], BATCH), np.float32)
    chosen = np.linspace(0, len(matrix) - 1, 500).astype(int)
    error = root32[chosen] @ root32[chosen].T - matrix[np.ix_(chosen, chosen)]
    return setup, lambda: root32 @ noise, BATCH, {**_errors(error), "modes": len(matrix)}


def circulant(case: dict[str, Any]) -> Made:
    """Circulant embedding by FFT (Dietrich and Newsam 1997, doi:10.1137/S1064827592240555), `parameter` times padded.

    Negative eigenvalues of the embedding are set to 0; the error is that of the covariance that remains.
    """
    axes = lattice(case["extent"], case["cell"])
    sizes = [scipy.fft.next_fast_len(math.ceil(case["parameter"] * len(x)), real=True) for x in axes]

    def lines() -> Any:
        for size, length in zip(sizes, case["lengths"], strict=True):
            steps = np.arange(size)
            yield np.exp(-((np.minimum(steps, size - steps) * case["cell"] / length) ** 2))

    def setup() -> Any:
        base = np.ones(())
        for line in lines():
            base = np.multiply.outer(base, line)
        shares = scipy.fft.fftn(base).real
        return np.sqrt(np.maximum(shares, 0) / base.size).astype(np.float32), base

    root, base = setup()
    inside = tuple(slice(len(x)) for x in axes)
    generator = np.random.default_rng(0)
    remaining = scipy.fft.ifftn(root.astype(np.float64) ** 2 * base.size).real
    error = (remaining - base)[inside]

    def batch() -> Any:
        # Real and imaginary parts are two independent realisations.
        noise = generator.standard_normal((*root.shape, 2), np.float32).view(np.complex64)[..., 0]
        made = scipy.fft.fftn(noise * root)[inside]
        return np.ascontiguousarray(made.real), np.ascontiguousarray(made.imag)

    return setup, batch, 2, _errors(error)


def randomization(case: dict[str, Any]) -> Made:
    """GSTools' randomization method with `parameter` modes (Hesse et al. 2014, doi:10.1016/j.envsoft.2014.01.013).

    Its covariance is right on average over seeds; the error is that of one seed's wave vectors, drawn from the same
    spectrum, over the pairs of probes.
    """
    import gstools

    axes = lattice(case["extent"], case["cell"])
    lengths = np.array(case["lengths"])
    modes = case["parameter"]

    def setup() -> Any:
        model = gstools.Gaussian(dim=len(lengths), var=1.0, len_scale=list(lengths * math.sqrt(math.pi) / 2))
        return gstools.SRF(model, mode_no=modes, seed=1)

    field = setup()
    waves = np.random.default_rng(0).standard_normal((modes, len(lengths))) * np.sqrt(2) / lengths
    probes = np.stack(
        np.meshgrid(*(np.linspace(0, size, PROBES) for size in case["extent"]), indexing="ij"), axis=-1
    ).reshape(-1, len(lengths))
    phases = probes @ waves.T
    made = (np.cos(phases) @ np.cos(phases).T + np.sin(phases) @ np.sin(phases).T) / modes
    lags = (probes[:, None] - probes) / lengths
    error = made - np.exp(-(lags**2).sum(-1))
    return setup, lambda: field.structured(axes, seed=2), 1, {**_errors(error), "modes": modes}


def points(case: dict[str, Any]) -> Made:
    """Scattered points (`parameter` of them) at 99.9 % of the variance, one realisation at a time."""
    lengths, extent = case["lengths"], case["extent"]

    def setup() -> Any:
        return jax.block_until_ready(kl.expand(covariance_of(lengths), (0.0,) * len(extent), tuple(extent)))

    expansion = setup()
    unit = np.random.default_rng(0).uniform(size=(len(extent), case["parameter"]))
    where = jnp.asarray(unit * np.array(extent)[:, None], jnp.float32)
    coefficients = kl.monte_carlo(jax.random.key(0), 1, expansion.modes)[0]
    captured = kl.captured_variance(expansion, pair_probes=PROBES)

    def batch() -> Any:
        return kl.field_at(expansion, coefficients, where).block_until_ready()

    return (
        setup,
        batch,
        1,
        {
            "modes": expansion.modes,
            "error_worst": captured.correlation_error,
            "error_rms": captured.correlation_error_rms,
        },
    )


METHODS = {
    "haar": haar,
    "nystrom": nystrom,
    "truncated": truncated,
    "untruncated": untruncated,
    "dense": dense,
    "circulant": circulant,
    "randomization": randomization,
    "points": points,
}


def _errors(error: Any) -> dict[str, float]:
    return {"error_worst": float(np.abs(error).max()), "error_rms": float(np.sqrt(np.mean(np.square(error))))}


def main() -> None:
    """Run the case given as JSON and print its figures."""
    case = json.loads(sys.argv[1])
    jax.block_until_ready(jnp.zeros(8) + 1)
    before = peak_memory_mb()
    start = time.perf_counter()
    setup, batch, count, figures = METHODS[case["method"]](case)
    first = time.perf_counter() - start
    repeats = case.get("repeats", 11)
    setup_time, batch_time = timed(setup, 3 if first > 5 else 41), timed(batch, repeats)
    print(
        json.dumps(
            {
                "method": case["method"],
                "parameter": case.get("parameter"),
                "setup_s": setup_time.scaled(1.0),
                "realisation_s": batch_time.scaled(1 / count),
                "memory_mb": peak_memory_mb() - before,
                **figures,
            }
        )
    )


if __name__ == "__main__":
    main()
