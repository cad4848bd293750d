"""What moves the hand and compares, after a script that has `dt`, `advance` and `places`."""

from pathlib import Path

import numpy as np


def lift(about, dt, advance, places):
    """Lift the object, and say how far it is from GenDOM's in each frame.

    Args:
        about: Arrays of lift.npz.
        dt: Time step [s].
        advance: Function of where the hand was and is, [3] from its start [m]: one step.
        places: Function: [M, 3] where the points are that are compared [m].
    """
    hand, times = about["hand"], about["time"]
    shapes, step = [], 0
    for moment in about["frames"]:
        while (step + 0.5) * dt < moment:
            step += 1
            was, now = (
                np.array([np.interp(k * dt, times, hand[:, a] - hand[0, a]) for a in range(3)])
                for k in (step - 1, step)
            )
            advance(was, now)
        shapes.append(places())
        if not np.isfinite(shapes[-1]).all():
            raise SystemExit(f"it diverges before {moment:.1f} s")
    np.save(Path(__file__).parent / "positions.npy", shapes)
    off = np.linalg.norm(np.array(shapes) - about["gendom"], axis=2)
    worst = 1e3 * off.mean(axis=1).max()
    print(f"{len(off)} frames, mean distance {1e3 * off.mean():.2f} mm, worst frame's {worst:.2f}")
