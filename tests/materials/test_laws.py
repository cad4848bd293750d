"""Stress and return mapping, called through a small Warp kernel and compared with NumPy."""

import functools

import numpy as np
import pytest
import warp as wp

from gendom.materials import Material
from gendom.materials.laws import LAWS, make_law
from gendom.sim import open_device

MU, LAM = Material(E=1.0e5, nu=0.3).lame


@functools.cache
def compiled(name, *, plastic):
    """Kernels of one law in float64: stress and return mapping."""
    open_device("cpu")
    law = make_law(name, wp.float64, plastic=plastic)
    stress, return_map = law.stress, law.return_map

    @wp.kernel(enable_backward=False, module="unique")
    def stress_kernel(
        F: wp.array[wp.mat33d],
        mu: wp.float64,
        lam: wp.float64,
        P: wp.array[wp.mat33d],
    ):
        p = wp.tid()
        P[p] = stress(F[p], mu, lam)  # pyright: ignore[reportIndexIssue]

    @wp.kernel(enable_backward=False, module="unique")
    def return_kernel(
        F: wp.array[wp.mat33d],
        mu: wp.float64,
        yield_stress: wp.float64,
        result: wp.array[wp.mat33d],
    ):
        p = wp.tid()
        result[p] = return_map(F[p], mu, yield_stress)  # pyright: ignore[reportIndexIssue]

    return stress_kernel, return_kernel


def launch(kernel, F, a, b) -> np.ndarray:
    """The kernel's answer [n, 3, 3] for F [n, 3, 3] and its two numbers."""
    F = wp.array(np.ascontiguousarray(F), dtype=wp.mat33d, device="cpu")
    out = wp.zeros_like(F)
    wp.launch(kernel, dim=len(F), inputs=[F, a, b], outputs=[out], device="cpu")
    return out.numpy()


def stress_of(name, F, mu=MU, lam=LAM) -> np.ndarray:
    """P [n, 3, 3] [Pa]."""
    return launch(compiled(name, plastic=False)[0], F, mu, lam)


def kirchhoff_of(name, F):
    """tau = P F^T [n, 3, 3] [Pa]."""
    return stress_of(name, F) @ transposed(F)


def yielded(F, yield_stress, mu=MU) -> np.ndarray:
    """F [n, 3, 3] after the von Mises return."""
    return launch(compiled("neo-hookean", plastic=True)[1], F, mu, yield_stress)


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


def hencky_deviator(F):
    """Deviatoric part of the logarithms of the singular values [n, 3]."""
    eps = np.log(np.linalg.svd(F, compute_uv=False))
    return eps - eps.mean(axis=1, keepdims=True)


@pytest.mark.parametrize("name", LAWS)
def test_rest_is_free_of_stress(name):
    """P(I) = 0, and P(Q) = 0 for a rotation."""
    assert np.array_equal(stress_of(name, np.eye(3)[None]), np.zeros((1, 3, 3)))
    assert np.abs(stress_of(name, rotations(8, seed=0))).max() < 1e-14 * MU * 100


@pytest.mark.parametrize("name", LAWS)
def test_small_strains_are_linear_elasticity(name):
    """P -> 2 mu e + lam tr(e) I for any small gradient, rotation included; error as eps^2."""
    G = np.random.default_rng(3).normal(size=(6, 3, 3))
    e = (G + transposed(G)) / 2.0
    linear = 2.0 * MU * e + LAM * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(3)

    def error(eps):
        return np.linalg.norm(stress_of(name, np.eye(3) + eps * G) - eps * linear, axis=(1, 2))

    assert error(1e-3) / error(5e-4) == pytest.approx(4.0, rel=0.02)
    assert np.all(error(1e-3) < 0.05 * np.linalg.norm(1e-3 * linear, axis=(1, 2)))


@pytest.mark.parametrize("name", LAWS)
def test_stress_turns_with_the_body(name):
    """Objectivity P(Q F) = Q P(F), and isotropy P(F Q) = P(F) Q."""
    F = deformations(12, seed=5, low=0.5, high=2.0)
    Q = rotations(12, seed=9)
    P = stress_of(name, F)
    scale = np.abs(P).max()
    assert np.abs(stress_of(name, Q @ F) - Q @ P).max() < 1e-12 * scale
    assert np.abs(stress_of(name, F @ Q) - P @ Q).max() < 1e-12 * scale


@pytest.mark.parametrize("name", LAWS)
def test_stress_is_symmetric(name):
    """P F^T is symmetric, which keeps angular momentum."""
    tau = kirchhoff_of(name, deformations(12, seed=7, low=0.3, high=3.0))
    assert np.abs(tau - transposed(tau)).max() < 1e-12 * np.abs(tau).max()


def test_neo_hookean_matches_its_formula():
    """P F^T = mu (F F^T - I) + lam log(J) I at large strains."""
    F = deformations(20, seed=11, low=0.1, high=5.0)
    J = np.linalg.det(F)[:, None, None]
    expected = MU * (F @ transposed(F) - np.eye(3)) + LAM * np.log(J) * np.eye(3)
    assert np.allclose(kirchhoff_of("neo-hookean", F), expected, rtol=1e-12, atol=1e-9)


def test_fixed_corotated_rotation_is_that_of_the_svd():
    """P F^T = 2 mu (F - R) F^T + lam J (J - 1) I with R = U V^T, singular values 0.02 to 20."""
    F = deformations(60, seed=13, low=0.02, high=20.0)
    U, _, Vt = np.linalg.svd(F)
    J = np.linalg.det(F)[:, None, None]
    expected = 2.0 * MU * (F - U @ Vt) @ transposed(F) + LAM * J * (J - 1.0) * np.eye(3)
    error = np.abs(kirchhoff_of("fixed-corotated", F) - expected).max(axis=(1, 2))
    assert np.all(error < 1e-11 * np.abs(expected).max(axis=(1, 2)))


def test_return_ends_on_the_yield_surface():
    """|2 mu dev(eps)| = yield stress after the return of any F beyond it, principal axes kept."""
    F = deformations(40, seed=17, low=0.3, high=3.0)
    y = 0.2 * MU
    beyond = 2.0 * MU * np.linalg.norm(hencky_deviator(F), axis=1) > y
    assert beyond.sum() > 30
    F = F[beyond]
    R = yielded(F, y)
    after, before = hencky_deviator(R), hencky_deviator(F)
    assert np.allclose(2.0 * MU * np.linalg.norm(after, axis=1), y, rtol=1e-9)
    # radial: the deviator only shrinks, and F and its return share both sets of principal axes
    assert np.allclose(
        after / np.linalg.norm(after, axis=1, keepdims=True),
        before / np.linalg.norm(before, axis=1, keepdims=True),
        atol=1e-8,
    )
    for A in (R @ np.linalg.inv(F), np.linalg.inv(F) @ R):
        assert np.abs(A - transposed(A)).max() < 1e-8


def test_return_keeps_the_volume():
    """det F is the same before and after plastic flow."""
    F = deformations(40, seed=19, low=0.3, high=3.0)
    R = yielded(F, 0.1 * MU)
    assert np.abs(R - F).max() > 0.1
    assert np.allclose(np.linalg.det(R), np.linalg.det(F), rtol=1e-9)


def test_nothing_flows_below_the_yield_stress():
    """F comes back bit for bit when |2 mu dev(eps)| < yield stress, also at large volume change."""
    F = deformations(20, seed=23, low=0.9, high=1.1) * np.linspace(0.5, 2.0, 20)[:, None, None]
    y = 2.0 * MU * 1.01 * np.linalg.norm(hencky_deviator(F), axis=1).max()
    assert np.array_equal(yielded(F, y), F)
    assert not np.array_equal(yielded(F, 0.5 * y), F)


def test_unknown_law():
    """The error lists the laws there are."""
    with pytest.raises(ValueError, match=r"'rubber'.*neo-hookean, fixed-corotated"):
        make_law("rubber", wp.float64, plastic=False)
