"""Biconjugate gradients that begin again: what they return is never worse than what they begin from."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmpm.setup._initial_stress import _bicgstab

N = 60


def solved(matrix, right, tolerance=1e-5, iterations=600):
    """The residual of the solution in float32, over the right side."""
    given = jnp.asarray(matrix, jnp.float32)
    atol = jnp.float32(tolerance * np.linalg.norm(right))
    solution, _ = _bicgstab(
        lambda u: given @ u, jnp.asarray(right, jnp.float32), M=lambda r: r, tol=0.0, atol=atol, maxiter=iterations
    )
    return np.linalg.norm(matrix @ np.asarray(solution, float) - right) / np.linalg.norm(right)


def matrix_of(rng, condition, askew):
    q, _ = np.linalg.qr(rng.normal(size=(N, N)))
    return (q * np.geomspace(1, 1 / condition, N)) @ q.T + askew * np.triu(rng.normal(size=(N, N)), 1)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_no_solution_is_worse_than_none(seed):
    """Rounding takes over where the condition is beyond float32: residuals of 1e4 came back without a new beginning."""
    rng = np.random.default_rng(seed)
    assert solved(matrix_of(rng, 1e6, 1e-3), rng.normal(size=N)) <= 1 + 1e-5


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_what_float32_resolves_is_solved(seed):
    rng = np.random.default_rng(seed)
    assert solved(matrix_of(rng, 10.0, 1e-3), rng.normal(size=N)) < 3e-5


def test_a_matrix_that_turns_every_vector_ends_at_the_last_iteration():
    turn = np.kron(np.eye(N // 2), [[0.0, 1.0], [-1.0, 0.0]])
    assert solved(turn, np.ones(N), iterations=50) == pytest.approx(1.0)
