"""The scene in a plain MLS-MPM on a dense grid, in Taichi: what one would write first.

Quadratic B-splines, one affine matrix C a particle that also advances F and spreads the stress,
neo-Hookean. The forward program keeps one state and clears, updates and reads the whole grid in
every substep. The program with gradients keeps the states of all substeps, runs the grid of each
a second time on the way back and lets Taichi differentiate each stage.
"""

from typing import Any

import numpy as np
from scene import Scene
from worker import serve


class TaichiRope:
    """The loss of its gradient is the mean height at the end, as in GenDOM's."""

    def __init__(self, scene: Scene, dtype: str, threads: int, gradient: bool):
        import taichi as ti  # pyright: ignore[reportMissingImports]

        self.version, self.sync = ".".join(map(str, ti.__version__)), ti.sync
        real = ti.f32 if dtype == "float32" else ti.f64
        ti.init(
            arch=ti.cpu,
            default_fp=real,
            cpu_max_num_threads=threads,
            offline_cache=False,
            log_level=ti.WARN,
        )
        self.scene, self.dtype, self.gradient = scene, dtype, gradient
        self.state, self.loss, self.log_E, stages = _program(scene, real, gradient)
        self.clear, self.p2g, self.update, self.g2p, self.height = stages
        self.x = scene.x

    def reset(self) -> None:
        x, _, _, F = self.state
        for field in self.state:
            field.fill(0.0)
        start = np.zeros((*x.shape, 3))
        start[0] = self.scene.x
        x.from_numpy(start.astype(self.dtype))
        identity = np.zeros((*F.shape, 3, 3))
        identity[0] = np.eye(3)
        F.from_numpy(identity.astype(self.dtype))

    def run(self) -> None:
        n = self.scene.substeps
        if not self.gradient:
            for s in range(n):
                self._substep(s, 0, 0)
            self.sync()
            self.x = self.state[0].to_numpy()[0]
            return
        for s in range(n):
            self._substep(s, s, s + 1)
        self.loss[None] = 0.0
        for field in (*self.state, self.log_E):
            field.grad.fill(0.0)
        self.loss.grad[None] = 1.0
        self.height(n)
        self.height.grad(n)
        for s in reversed(range(n)):
            self._gather(s, s, s + 1)
            self.g2p.grad(s, s + 1)
            self.update.grad(s)
            self.p2g.grad(s, s + 1)
        self.sync()

    def _gather(self, s: int, now: int, then: int) -> None:
        self.clear()
        self.p2g(now, then)
        self.update(s)

    def _substep(self, s: int, now: int, then: int) -> None:
        self._gather(s, now, then)
        self.g2p(now, then)

    def figures(self) -> dict[str, float]:
        if not self.gradient:
            return {"tip": self.scene.tip(self.x)}
        found = {
            "tip": self.scene.tip(self.state[0].to_numpy()[-1]),
            "loss_by_log_E": float(self.log_E.grad[None]),
        }
        h = 1e-3 if self.dtype == "float64" else 3e-2
        ends = []
        for shift in (h, -h):
            self.reset()
            self.log_E[None] = np.log(self.scene.E) + shift
            for s in range(self.scene.substeps):
                self._substep(s, s, s + 1)
            ends.append(self.state[0].to_numpy()[-1, :, 2].mean(dtype=float))
        self.log_E[None] = np.log(self.scene.E)
        found["loss_by_log_E_differences"] = (ends[0] - ends[1]) / (2.0 * h)
        return found


def _program(scene: Scene, real: Any, gradient: bool):
    """Fields and kernels for one scene; its numbers become constants of the kernels."""
    import taichi as ti  # pyright: ignore[reportMissingImports]

    N, n = len(scene.x), scene.cells
    dx, dt, nu = scene.dx, scene.substep, scene.nu
    mass = scene.density * scene.volume
    spread = 4.0 * dt * scene.volume / dx**2
    gravity = [float(g) for g in scene.gravity]
    centre = [float(c) for c in scene.grip_centre]
    speed = [float(u) for u in scene.grip_velocity]
    reach = scene.grip_radius + dx

    kept = scene.substeps + 1 if gradient else 1
    x = ti.Vector.field(3, real, shape=(kept, N), needs_grad=gradient)
    v = ti.Vector.field(3, real, shape=(kept, N), needs_grad=gradient)
    C = ti.Matrix.field(3, 3, real, shape=(kept, N), needs_grad=gradient)
    F = ti.Matrix.field(3, 3, real, shape=(kept, N), needs_grad=gradient)
    momentum = ti.Vector.field(3, real, shape=(n, n, n), needs_grad=gradient)
    velocity = ti.Vector.field(3, real, shape=(n, n, n), needs_grad=gradient)
    node_mass = ti.field(real, shape=(n, n, n), needs_grad=gradient)
    log_E = ti.field(real, shape=(), needs_grad=gradient)
    loss = ti.field(real, shape=(), needs_grad=gradient)
    log_E[None] = np.log(scene.E)

    @ti.func
    def weights(at):
        return [0.5 * (1.5 - at) ** 2, 0.75 - (at - 1.0) ** 2, 0.5 * (at - 0.5) ** 2]

    @ti.kernel
    def clear():
        for i in ti.grouped(node_mass):
            node_mass[i] = 0.0
            momentum[i] = ti.Vector.zero(real, 3)
            if ti.static(gradient):
                node_mass.grad[i] = 0.0
                momentum.grad[i] = ti.Vector.zero(real, 3)
                velocity.grad[i] = ti.Vector.zero(real, 3)

    @ti.kernel
    def p2g(now: ti.i32, then: ti.i32):
        for p in range(N):
            E = ti.exp(log_E[None])
            mu = E / (2.0 * (1.0 + nu))
            lam = 2.0 * mu * nu / (1.0 - 2.0 * nu)
            eye = ti.Matrix.identity(real, 3)
            F_new = (eye + dt * C[now, p]) @ F[now, p]
            F[then, p] = F_new
            tau = mu * (F_new @ F_new.transpose() - eye) + lam * ti.log(F_new.determinant()) * eye
            affine = mass * C[now, p] - spread * tau
            base = ti.cast(x[now, p] / dx - 0.5, ti.i32)
            at = x[now, p] / dx - ti.cast(base, real)
            w = weights(at)
            for o in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                share = w[o[0]][0] * w[o[1]][1] * w[o[2]][2]
                away = (ti.cast(o, real) - at) * dx
                momentum[base + o] += share * (mass * v[now, p] + affine @ away)
                node_mass[base + o] += share * mass

    @ti.kernel
    def update(s: ti.i32):
        for i in ti.grouped(node_mass):
            u = ti.Vector.zero(real, 3)
            # lighter nodes move nobody, but the square of their mass underflows in float32
            if node_mass[i] > 1e-10 * mass:
                u = momentum[i] / node_mass[i] + dt * ti.Vector(gravity)
                held = ti.Vector(centre) + s * dt * ti.Vector(speed)
                if (dx * ti.cast(i, real) - held).norm_sqr() < reach * reach:
                    u = ti.Vector(speed)
            velocity[i] = u

    @ti.kernel
    def g2p(now: ti.i32, then: ti.i32):
        for p in range(N):
            base = ti.cast(x[now, p] / dx - 0.5, ti.i32)
            at = x[now, p] / dx - ti.cast(base, real)
            w = weights(at)
            v_new = ti.Vector.zero(real, 3)
            C_new = ti.Matrix.zero(real, 3, 3)
            for o in ti.static(ti.grouped(ti.ndrange(3, 3, 3))):
                share = w[o[0]][0] * w[o[1]][1] * w[o[2]][2]
                u = velocity[base + o]
                v_new += share * u
                C_new += 4.0 / dx * share * u.outer_product(ti.cast(o, real) - at)
            v[then, p] = v_new
            C[then, p] = C_new
            x[then, p] = x[now, p] + dt * v_new

    @ti.kernel
    def height(last: ti.i32):
        for p in range(N):
            loss[None] += x[last, p][2] / N

    return (x, v, C, F), loss, log_E, (clear, p2g, update, g2p, height)


if __name__ == "__main__":
    serve(TaichiRope)
