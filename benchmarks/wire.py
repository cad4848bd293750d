"""E I of a wire that hangs in a loop, by a plane elastica, without GenDOM.

    python benchmarks/wire.py benchmarks/recordings/wire_white_loop.npz

Fits E I and the directions of both ends to the mean of a `gendom-static/1` file's repeats. With the
force n(s) in the wire and its direction f(s), E I f'' = n_x sin f - n_z cos f and n_z' = w
(Love (1927), "A treatise on the mathematical theory of elasticity", chapter 19).
"""

import argparse
import json

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import least_squares

GRAVITY = 9.80665


def main() -> None:
    parser = argparse.ArgumentParser(description="E I of a hanging wire")
    parser.add_argument("file")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with np.load(given.file) as read:
        points = read["loops"].mean(axis=0)[:, [0, 2]].astype(float)
        about = json.loads(str(read["meta"]))["object"]
    length, weight = about["length"], about["mass_per_length"] * GRAVITY
    steps = np.diff(points, axis=0)
    chords = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    at = np.linspace(0.0, length, len(points))

    def off(unknown: np.ndarray) -> np.ndarray:
        EI, ends = np.exp(unknown[0]), unknown[1:]

        def slopes(s, y, n):
            bends = (n[0] * np.sin(y[2]) - (n[1] + weight * s) * np.cos(y[2])) / EI
            return np.stack([np.cos(y[2]), np.sin(y[2]), y[3], bends])

        def held(a, b, n):
            return np.array([*(a[:2] - points[0]), a[2] - ends[0],
                             *(b[:2] - points[-1]), b[2] - ends[1]])  # fmt: skip

        s = np.linspace(0.0, length, 400)
        x, z = (np.interp(s, at, p) for p in points.T)
        f = np.unwrap(np.arctan2(np.gradient(z, s), np.gradient(x, s)))
        guess = np.stack([x, z, f, np.gradient(f, s)])
        found = solve_bvp(
            slopes, held, s, guess, p=[0.01, -0.5 * weight * length], tol=1e-5, max_nodes=20_000
        )
        if not found.success:
            return np.full(points.size, 0.1)
        return (found.sol(at)[:2].T - points).ravel()

    first = [np.log(1.2e-4), chords[0] + 0.5, chords[-1] - 0.5]
    best = least_squares(off, first, x_scale=[0.1, 0.3, 0.3], diff_step=1e-3)
    rms = np.sqrt(np.mean(off(best.x) ** 2))
    if given.json:
        print(json.dumps({"EI": float(np.exp(best.x[0])), "rms": float(rms)}))
        return
    print(f"E I {np.exp(best.x[0]):.3g} N m^2, points {1e3 * rms:.2g} mm off (a coordinate)")


if __name__ == "__main__":
    main()
