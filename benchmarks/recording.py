"""Pictures lost while two cameras of 640 x 480 at 30 Hz are recorded, and what it costs.

    python benchmarks/recording.py [SECONDS]

The cameras are software devices of the RealSense SDK that send a noisy table in real time; a robot
at rest is recorded beside them.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, cast

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from gendom.hardware.contracts import Tick
from gendom.hardware.recording import record_motion
from gendom.perception import Camera, Pictures
from gendom.robot import XARM7, JointMotion
from software_camera import SoftwareCamera, connected

WIDTH, HEIGHT, RATE = 640, 480, 30.0


def camera(name: str) -> Camera:
    K = np.array([[385.0, 0, 319.5], [0, 385, 239.5], [0, 0, 1]])
    return Camera(name=name, width=WIDTH, height=HEIGHT, K=K, T_world_camera=np.eye(4))


class Arm:
    """A robot at rest that reports 100 times a second."""

    arm = XARM7

    def play(self, motion, *, on_tick) -> None:
        began = time.monotonic()
        while (t := time.monotonic() - began) < motion.end:
            q = motion.at(t)
            on_tick(Tick(time=t, command=q, measured=q, age=0.0, stamp=time.time()))
            time.sleep(0.01)

    def stop(self) -> None:
        raise SystemExit("a camera failed")


def show(software: SoftwareCamera, seen: list[Pictures], over: threading.Event) -> None:
    """Send pictures in real time; a late one goes out at once, as from a camera."""
    began, number = time.monotonic(), 0
    while not over.is_set():
        number += 1
        time.sleep(max(0.0, began + number / RATE - time.monotonic()))
        software.show(time.time(), number, seen[number % len(seen)])


def _scene(seed: int) -> Pictures:
    """A table seen from the side: depth with the noise of a D435i, colour with a camera's grain."""
    rng = np.random.default_rng(seed)
    z = np.linspace(1500.0, 600.0, HEIGHT)[:, None] * np.ones(WIDTH)
    depth = z + rng.normal(size=z.shape) * 2e-6 * z**2
    depth[rng.random(z.shape) < 0.03] = 0.0
    grey = np.linspace(90.0, 160.0, WIDTH)[None, :, None] * np.ones((HEIGHT, 1, 3))
    colour = grey + rng.normal(size=grey.shape) * 3.0
    return Pictures(depth.astype(np.uint16), colour.astype(np.uint8))


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    seen = [_scene(k) for k in range(8)]
    softwares = [SoftwareCamera(camera(name)) for name in ("left", "right")]
    cameras = [connected(software) for software in softwares]
    over = threading.Event()
    threads = [threading.Thread(target=show, args=(s, seen, over), daemon=True) for s in softwares]
    for thread in threads:
        thread.start()
    still = JointMotion(time=np.array([0.0, seconds]), q=np.stack([XARM7.home] * 2))
    with tempfile.TemporaryDirectory() as folder:
        before = os.times()
        found = record_motion(
            cast(Any, Arm()), cameras, still, Path(folder) / "lift", description=""
        )
        after = os.times()
        files = sum(p.stat().st_size for p in Path(folder).rglob("*.db3"))
    over.set()
    for thread in threads:
        thread.join()
    for one in cameras:
        one.disconnect()
    cpu = after.user + after.system - before.user - before.system
    print(
        json.dumps(
            {
                "seconds": seconds,
                "pictures": sum(r.pictures for r in found.values()),
                "missing": sum(r.missing for r in found.values()),
                "cpu_seconds": round(cpu, 1),
                "megabytes": round(1e-6 * files),
                "load": round(os.getloadavg()[0], 1),
            }
        )
    )


if __name__ == "__main__":
    main()
