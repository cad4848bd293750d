"""Lift the object in MuJoCo, and compare it with GenDOM's simulator: python lift.py [--view]"""

import sys
import time
from pathlib import Path

import mujoco
import numpy as np

here = Path(__file__).parent
about = np.load(here / "lift.npz")
model = mujoco.MjModel.from_xml_path(str(here / "scene.xml"))

# What MJCF cannot say: the mass of each vertex, and how stiff each hinge is in bending.
model.body_mass[model.flex_vertbodyid] = about["masses"]
model.flex_bending[:] = about["bending"]
data = mujoco.MjData(model)
mujoco.mj_setConst(model, data)
mujoco.mj_resetData(model, data)
mujoco.mj_forward(model, data)

start, hand, times = data.mocap_pos[0].copy(), about["hand"], about["time"]
viewer = None
if "--view" in sys.argv:
    import mujoco.viewer

    viewer = mujoco.viewer.launch_passive(model, data)

shapes = []
for moment in about["frames"]:
    while data.time < moment - 0.5 * model.opt.timestep:
        now = data.time + model.opt.timestep
        data.mocap_pos[0] = start + [
            np.interp(now, times, hand[:, a] - hand[0, a]) for a in range(3)
        ]
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    shapes.append(data.flexvert_xpos.copy())
    if viewer is not None:
        viewer.sync()
        time.sleep(0.1)

shapes = np.array(shapes)
np.save(here / "positions.npy", shapes)
off = np.linalg.norm(shapes - about["gendom"], axis=2)
worst = 1e3 * off.mean(axis=1).max()
print(f"{len(off)} frames, mean distance {1e3 * off.mean():.2f} mm, worst frame's {worst:.2f}")
