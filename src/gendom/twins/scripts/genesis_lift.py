"""Lift the object in Genesis, and compare it with GenDOM's simulator: python lift.py"""

from pathlib import Path

import genesis as gs
import numpy as np
from driver import lift

here = Path(__file__).parent
about = {name: value[()] for name, value in np.load(here / "lift.npz").items()}
rope, dt, friction = about["kind"] == "rope", float(about["step"]), float(about["friction"])
# neighbours are looked for in cells: small ones in a small room, or a step takes half a second
reach, cell = 3.0 * float(np.abs(about["rest"]).max()), 2.0 * float(about.get("spacing", 0.01))

gs.init(backend=gs.cpu, precision="64", logging_level="warning")
scene = gs.Scene(
    sim_options=gs.options.SimOptions(dt=dt, gravity=(0.0, 0.0, -9.80665)),
    rigid_options=gs.options.RigidOptions(enable_self_collision=False),
    pbd_options=gs.options.PBDOptions(
        max_stretch_solver_iterations=6,
        max_bending_solver_iterations=3,
        particle_size=0.2 * float(about.get("spacing", 0.01)),
        hash_grid_cell_size=cell,
        lower_bound=(-reach, -reach, 0.0),
        upper_bound=(reach, reach, reach),
    ),
    show_viewer=False,
)
scene.add_entity(gs.morphs.Plane(), material=gs.materials.Rigid(friction=max(friction, 0.01)))
if rope:
    body = scene.add_entity(
        # its default of 0.1 kg m^2 is far more than a segment has
        gs.morphs.MJCF(file=str(here / "rope.xml"), default_armature=None),
        material=gs.materials.Rigid(friction=max(friction, 0.01)),
    )
else:
    body = scene.add_entity(
        gs.morphs.Mesh(file=str(here / "sheet.obj"), file_meshes_are_zup=True),
        material=gs.materials.PBD.Cloth(
            rho=float(about["mass_per_area"]),
            static_friction=friction,
            kinetic_friction=friction,
            stretch_compliance=float(about["stretch_compliance"]),
            bending_compliance=float(about["bending_compliance"]),
            air_resistance=0.0,
        ),
    )
scene.build()


def array(tensor):
    """On the host."""
    return tensor.detach().cpu().numpy()


def places():
    """[M, 3] middles of segments, in order, or vertices in the twin's order [m]."""
    if not rope:
        return array(body.get_particles_pos()).reshape(-1, 3)[same]
    found = []
    for k in range(len(about["rest"])):
        x, q = (array(of).reshape(-1) for of in (links[k].get_pos(), links[k].get_quat()))
        w, axis = q[0], q[1:]
        along = np.array([half, 0.0, 0.0])
        found.append(x + along + 2.0 * np.cross(axis, np.cross(axis, along) + w * along))
    return np.array(found)


same = slice(None)
if rope:
    half = float(about["rest"][0, 0])
    links = [body.get_link(f"s{k}") for k in range(len(about["rest"]))]
else:
    first = places()
    far = np.linalg.norm(first[None] - about["rest"][:, None], axis=2)
    same = far.argmin(axis=1)
    held = same[about["held"]].tolist()
    body.fix_particles(held)
print(f"off at first by {1e3 * np.abs(places() - about['rest']).max():.3f} mm")


def advance(was, now):
    """One step, with the hand in its place."""
    if rope:
        body.set_dofs_position(was, [0, 1, 2], zero_velocity=False)
        body.set_dofs_velocity((now - was) / dt, [0, 1, 2])
    else:
        body.set_particles_pos(about["rest"][about["held"]] + now, held)
    scene.step()


lift(about, dt, advance, places)
