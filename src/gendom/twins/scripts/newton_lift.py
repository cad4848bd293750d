"""Lift the object in Newton, and compare it with GenDOM's simulator: python lift.py"""

from itertools import combinations
from pathlib import Path

import newton
import numpy as np
import warp as wp
from driver import lift

here = Path(__file__).parent
about = {name: value[()] for name, value in np.load(here / "lift.npz").items()}
rope = about["kind"] == "rope"
damping, friction = float(about["damping"]), float(about["friction"])

builder = newton.ModelBuilder()
builder.default_shape_cfg.mu = friction
builder.default_shape_cfg.ke = 1e5
if rope:
    rod = newton.Rod(
        [wp.vec3(*x) for x in about["nodes"]],
        radius=float(about["radius"]),
        stretch_rigidity=float(about["EA"]),
        shear_rigidity=float(about["EA"]),
        bend_rigidity=float(about["EI"]),
        twist_rigidity=float(about["GJ"]),
    )
    edge = float(about["nodes"][1, 0] - about["nodes"][0, 0])
    bodies, _ = builder.add_rod(
        rod=rod,
        bend_damping=damping * float(about["EI"]) / edge,
        twist_damping=damping * float(about["GJ"]) / edge,
    )
    for k, body in enumerate(bodies):
        # capsules overlap at their ends: a segment has the mass of its cylinder
        mass = 0.0 if k < about["held"] else float(about["mass"])
        share = mass / builder.body_mass[body]
        builder.body_mass[body] = mass
        builder.body_inv_mass[body] = 1.0 / mass if mass else 0.0
        inertia = share * np.array(builder.body_inertia[body]).reshape(3, 3)
        builder.body_inertia[body] = wp.mat33(inertia)
        inverse = np.linalg.inv(inertia) if mass else np.zeros((3, 3))
        builder.body_inv_inertia[body] = wp.mat33(inverse)
    # neighbours' capsules overlap; a lifted rope touches itself nowhere else
    shapes = [shape for body in bodies for shape in builder.body_shapes[body]]
    for first, second in combinations(shapes, 2):
        builder.add_shape_collision_filter_pair(first, second)
    held = np.array(bodies[: int(about["held"])])
else:
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0),
        vertices=[wp.vec3(*x) for x in about["rest"]],
        indices=about["triangles"].ravel().tolist(),
        density=float(about["mass_per_area"]),
        tri_ke=float(about["mu"]),
        tri_ka=float(about["lam"]),
        tri_kd=0.0,
        edge_ke=float(about["side_hinge"]),
        edge_kd=damping * float(about["side_hinge"]),
        particle_radius=max(float(about["radius"]), 5e-4),
    )
    ends = about["rest"][np.array(builder.edge_indices)[:, 2:]]
    diagonal = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 1.2 * about["spacing"]
    hinges = np.where(diagonal, about["diagonal_hinge"], about["side_hinge"])
    builder.edge_bending_properties = [(float(k), damping * float(k)) for k in hinges]
    held = about["held"]
    for v in held:
        builder.particle_mass[v] = 0.0
        builder.particle_flags[v] &= ~int(newton.ParticleFlags.ACTIVE)
builder.add_ground_plane()
builder.color(include_bending=not rope)
model = builder.finalize()
model.soft_contact_mu = friction
model.soft_contact_ke = 1e4
solver = newton.solvers.SolverVBD(
    model, iterations=int(about["iterations"]), particle_enable_self_contact=False
)
states, control, dt = [model.state(), model.state()], model.control(), float(about["step"])
pipeline = newton.CollisionPipeline(model)
contacts = pipeline.contacts()


def array(state):
    """Poses of segments, or places of vertices."""
    return state.body_q if rope else state.particle_q


def advance(_, offset):
    """One step, with what the hand holds in its place."""
    for state in states:
        x = array(state).numpy()
        x[held, :3] = start[held, :3] + offset
        array(state).assign(x)
    states[0].clear_forces()
    pipeline.collide(states[0], contacts)
    solver.step(*states, control, contacts, dt)
    states.reverse()


def places():
    """[M, 3] middles of segments, or vertices [m]."""
    return array(states[0]).numpy()[bodies if rope else slice(None), :3].copy()


start = array(states[0]).numpy().copy()  # on a CPU it is a view
lift(about, dt, advance, places)
