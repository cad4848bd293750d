"""The neo-Hookean law, called through a small Warp kernel and compared with NumPy."""

import functools

import numpy as np
import pytest
import warp as wp

from gendom.materials import Material
from gendom.materials.laws import make_neo_hookean
from gendom.sim import open_device

MU, LAM = Material(E=1.0e5, nu=0.3).lame


@functools.cache
def stress_kernel():
    """A kernel in float64."""
    open_device("cpu")
    stress = make_neo_hookean(wp.float64).stress

    @wp.kernel(enable_backward=False, module="unique")
    def kernel(
        F: wp.array[wp.mat33d],
        mu: wp.float64,
        lam: wp.float64,
        P: wp.array[wp.mat33d],
    ):
        p = wp.tid()
        P[p] = stress(F[p], mu, lam)  # pyright: ignore[reportIndexIssue]

    return kernel


def stress_of(F, mu=MU, lam=LAM) -> np.ndarray:
    """P [n, 3, 3] [Pa]."""
    F = wp.array(np.ascontiguousarray(F), dtype=wp.mat33d, device="cpu")
    out = wp.zeros_like(F)
    wp.launch(stress_kernel(), dim=len(F), inputs=[F, mu, lam], outputs=[out], device="cpu")
    return out.numpy()


def kirchhoff_of(F):
    """tau = P F^T [n, 3, 3] [Pa]."""
    return stress_of(F) @ transposed(F)


def rotations(n, seed):
    """Random rotations [n, 3, 3]."""
    Q, R = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, 3, 3)))
    Q = Q * np.sign(np.diagonal(R, axis1=1, axis2=2))[:, None]
    return Q * np.sign(np.linalg.det(Q))[:, None, None]


def deformations(n, seed, *, low, high):
    """Random F [n, 3, 3] of positive determinant, singular values between low and high."""
    s = np.exp(np.random.default_rng(seed).uniform(np.log(low), np.log(high), size=(n, 3)))
    return rotations(n, seed + 1) * s[:, None] @ rotations(n, seed + 2)


def transposed(A):
    return np.swapaxes(A, 1, 2)


def test_rest_is_free_of_stress():
    """P(I) = 0, and P(Q) = 0 for a rotation."""
    assert np.array_equal(stress_of(np.eye(3)[None]), np.zeros((1, 3, 3)))
    assert np.abs(stress_of(rotations(8, seed=0))).max() < 1e-14 * MU * 100


def test_small_strains_are_linear_elasticity():
    """P -> 2 mu e + lam tr(e) I for any small gradient, rotation included; error as eps^2."""
    G = np.random.default_rng(3).normal(size=(6, 3, 3))
    e = (G + transposed(G)) / 2.0
    linear = 2.0 * MU * e + LAM * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(3)

    def error(eps):
        return np.linalg.norm(stress_of(np.eye(3) + eps * G) - eps * linear, axis=(1, 2))

    assert error(1e-3) / error(5e-4) == pytest.approx(4.0, rel=0.02)
    assert np.all(error(1e-3) < 0.05 * np.linalg.norm(1e-3 * linear, axis=(1, 2)))


def test_stress_turns_with_the_body():
    """Objectivity P(Q F) = Q P(F), and isotropy P(F Q) = P(F) Q."""
    F = deformations(12, seed=5, low=0.5, high=2.0)
    Q = rotations(12, seed=9)
    P = stress_of(F)
    scale = np.abs(P).max()
    assert np.abs(stress_of(Q @ F) - Q @ P).max() < 1e-12 * scale
    assert np.abs(stress_of(F @ Q) - P @ Q).max() < 1e-12 * scale


def test_stress_is_symmetric():
    """P F^T is symmetric, which keeps angular momentum."""
    tau = kirchhoff_of(deformations(12, seed=7, low=0.3, high=3.0))
    assert np.abs(tau - transposed(tau)).max() < 1e-12 * np.abs(tau).max()


def test_neo_hookean_matches_its_formula():
    """P F^T = mu (F F^T - I) + lam log(J) I at large strains."""
    F = deformations(20, seed=11, low=0.1, high=5.0)
    J = np.linalg.det(F)[:, None, None]
    expected = MU * (F @ transposed(F) - np.eye(3)) + LAM * np.log(J) * np.eye(3)
    assert np.allclose(kirchhoff_of(F), expected, rtol=1e-12, atol=1e-9)
