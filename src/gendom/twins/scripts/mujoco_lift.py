"""Lift the object in MuJoCo, and compare it with GenDOM's simulator: python lift.py"""

from pathlib import Path

import mujoco
import numpy as np
from driver import lift

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

start = data.mocap_pos[0].copy()


def advance(_, now):
    """One step, with the hand in its place."""
    data.mocap_pos[0] = start + now
    mujoco.mj_step(model, data)


def places():
    """[V, 3] vertices [m]."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    return data.flexvert_xpos.copy()


lift(about, model.opt.timestep, advance, places)
