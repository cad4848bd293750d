"""The scene in Genesis: its MPM solver, elastic material, neo-Hookean.

Genesis samples particles itself, so they are placed on the scene's lattice afterwards. It holds
particles where they are but has nothing that carries them: the lift runs in the frame of the
rising gripper, where the rope starts with the gripper's velocity reversed.
"""

import os

import numpy as np
from scene import Scene
from worker import serve


class GenesisRope:
    """Its gradient is by the initial velocities: Genesis has none by E."""

    def __init__(self, scene: Scene, dtype: str, threads: int, gradient: bool):
        os.environ["QD_NUM_THREADS"] = str(threads)
        import genesis as gs  # pyright: ignore[reportMissingImports]
        import torch

        torch.set_num_threads(threads)
        self.version = gs.__version__
        self.torch, self.spec, self.gradient = torch, scene, gradient
        self.real = getattr(torch, dtype)
        gs.init(backend=gs.cpu, precision=dtype[-2:], logging_level="error")
        per_step = scene.substeps // scene.frames
        size = scene.cells * scene.dx
        self.scene = gs.Scene(
            sim_options=gs.options.SimOptions(
                dt=per_step * scene.substep,
                substeps=per_step,
                gravity=tuple(float(g) for g in scene.gravity),
                requires_grad=gradient,
            ),
            mpm_options=gs.options.MPMOptions(
                particle_size=scene.volume ** (1.0 / 3.0),
                grid_density=1.0 / scene.dx,
                lower_bound=(0.0, 0.0, 0.0),
                upper_bound=(size, size, size),
            ),
            show_viewer=False,
        )
        # any block of as many particles will do: a sheet as long and wide as the lattice has
        # sections and particles in each
        sections = len(np.unique(np.round(scene.x[:, 0] / scene.dx, 6)))
        edge = scene.volume ** (1.0 / 3.0)
        self.rope = self.scene.add_entity(
            material=gs.materials.MPM.Elastic(
                E=scene.E, nu=scene.nu, rho=scene.density, model="neohooken", sampler="regular"
            ),
            morph=gs.morphs.Box(
                pos=(size / 2.0, size / 2.0, size / 2.0),
                size=(sections * edge, len(scene.x) / sections * edge, edge),
            ),
        )
        self.scene.build()
        if self.rope.n_particles != len(scene.x):
            raise ValueError(f"Genesis sampled {self.rope.n_particles} of {len(scene.x)} particles")
        # held particles stop the nodes around them when their turn comes: they come last
        held = np.linalg.norm(scene.x - scene.grip_centre, axis=1) < scene.grip_radius
        self.order = np.argsort(held, kind="stable")
        self.held = held[self.order]
        self.start = scene.x[self.order]
        self.x = scene.x
        self.v = None

    def reset(self, faster: float = 0.0) -> None:
        """Back to the start; free particles rise ``faster`` by so much [m/s]."""
        torch = self.torch
        self.scene.reset()
        v = np.where(self.held[:, None], 0.0, -self.spec.grip_velocity)
        v[~self.held, 2] += faster
        if self.gradient:
            self.v = torch.tensor(v, dtype=self.real, requires_grad=True)
            self.rope.set_position(torch.tensor(self.start, dtype=self.real))
            self.rope.set_velocity(self.v)
        else:
            self.rope.set_particles_pos(torch.as_tensor(self.start))
            self.rope.set_particles_vel(torch.as_tensor(v))
        self.rope.set_free(torch.as_tensor(~self.held))

    def run(self) -> None:
        self._lift()
        if self.gradient:
            state = self.rope.get_state()
            state.pos[..., 2].mean().backward()
            x = state.pos.detach().reshape(-1, 3)
        else:
            x = self.rope.get_particles_pos()
        self.x = np.asarray(x.cpu())

    def _lift(self) -> None:
        for _ in range(self.spec.frames):
            self.scene.step(update_visualizer=False, refresh_visualizer=False)

    def figures(self) -> dict[str, float]:
        s = self.spec
        x = np.empty_like(s.x)
        x[self.order] = self.x + s.substeps * s.substep * s.grip_velocity
        found = {"tip": s.tip(x)}
        if self.gradient and self.v is not None and self.v.grad is not None:
            found["loss_by_speed"] = float(self.v.grad.reshape(-1, 3)[~self.held, 2].sum())
            h, ends = 1e-3, []
            for faster in (h, -h):
                self.reset(faster)
                self._lift()
                ends.append(float(self.rope.get_state().pos[..., 2].mean()))
            found["loss_by_speed_differences"] = (ends[0] - ends[1]) / (2.0 * h)
        return found


if __name__ == "__main__":
    serve(GenesisRope)
