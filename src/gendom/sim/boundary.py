"""What acts on grid nodes: gravity, damping, walls, the table's contact and friction, grippers.

Each function has its transpose beside it, which carries derivatives of a loss from a node's new
velocity back to its momentum and mass and to the parameters. Whether a node is held, slides or
sticks, and when grippers open and close, is not differentiated.

Shapes: W worlds, G grippers, K path knots.
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.columns import CELL_BITS, CELL_MASK, Columns

OPEN = 0
CLOSED = 1


@functools.cache
def make_boundary(real: Any) -> SimpleNamespace:
    """Build the types and functions for one scalar type.

    Returns:
        Namespace with the structs ``Scene``, ``Paths``, ``Grips`` and ``SceneBars``, and with
        ``place_gripper``, ``update_node`` and the transpose of each.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mask = CELL_MASK

    @wp.struct
    class Scene:
        """What surrounds W bodies."""

        dx: real
        z0: real  # height of node level 0, and of the table [m]
        gravity: wp.array(dtype=vec3)  # [W] [m/s^2]
        damping: wp.array(dtype=real)  # [W] [1/s]
        table: int
        friction: wp.array(dtype=real)  # [W]
        walls: int
        box_lower: vec3
        box_upper: vec3

    @wp.struct
    class Paths:
        """Grippers as a user gave them."""

        time: wp.array3d(dtype=wp.float64)  # [W, G, K] [s]
        position: wp.array3d(dtype=wp.vec3d)  # [W, G, K] [m]
        spin: wp.array3d(dtype=wp.vec3d)  # [W, G, K] [rad/s] from this knot on
        hold_from: wp.array2d(dtype=wp.float64)  # [W, G] [s]
        hold_until: wp.array2d(dtype=wp.float64)  # [W, G] [s]
        radius: wp.array2d(dtype=real)  # [W, G] [m]

    @wp.struct
    class Grips:
        """Grippers at one moment, a row for each world and substep."""

        centre: wp.array2d(dtype=vec3)  # [rows, G] [m]
        velocity: wp.array2d(dtype=vec3)  # [rows, G] [m/s]
        spin: wp.array2d(dtype=vec3)  # [rows, G] [rad/s]
        closed: wp.array2d(dtype=wp.int32)  # [rows, G]

    @wp.struct
    class SceneBars:
        """Derivatives by scene and grippers, summed up."""

        friction: wp.array(dtype=wp.float64)  # [W]
        damping: wp.array(dtype=wp.float64)  # [W]
        gravity: wp.array(dtype=wp.vec3d)  # [W]
        path: wp.array3d(dtype=wp.vec3d)  # [W, G, K]
        # of one substep
        centre: wp.array2d(dtype=wp.vec3d)  # [W, G]
        velocity: wp.array2d(dtype=wp.vec3d)  # [W, G]
        keep: wp.array(dtype=wp.float64)  # [W] by the share of velocity that damping leaves

    @wp.func
    def wide(a: vec3):
        return wp.vec3d(wp.float64(a[0]), wp.float64(a[1]), wp.float64(a[2]))

    @wp.func
    def narrow(a: wp.vec3d):
        return vec3(real(a[0]), real(a[1]), real(a[2]))

    @wp.func
    def knot_before(w: int, g: int, t: wp.float64, paths: Paths):
        """The knot that starts the segment of time t, and the share of the segment gone by."""
        last = paths.time.shape[2] - 1
        lo = int(0)
        hi = int(last)
        while hi - lo > 1:
            mid = (lo + hi) // 2
            if paths.time[w, g, mid] <= t:
                lo = mid
            else:
                hi = mid
        span = paths.time[w, g, hi] - paths.time[w, g, lo]
        u = wp.float64(0.0)
        if span > wp.float64(0.0):
            u = wp.clamp((t - paths.time[w, g, lo]) / span, wp.float64(0.0), wp.float64(1.0))
        return lo, u

    @wp.func
    def path_point(w: int, g: int, t: wp.float64, paths: Paths):
        """Position at time t [s] of gripper g on its piecewise linear path, and the knot before."""
        knot, u = knot_before(w, g, t, paths)
        a = paths.position[w, g, knot]
        return a + u * (paths.position[w, g, knot + 1] - a), knot

    @wp.func
    def path_point_back(
        w: int, g: int, t: wp.float64, bar: wp.vec3d, paths: Paths, bars: SceneBars
    ):
        """Transpose of ``path_point`` in the knots' positions."""
        knot, u = knot_before(w, g, t, paths)
        bars.path[w, g, knot] = bars.path[w, g, knot] + (wp.float64(1.0) - u) * bar
        bars.path[w, g, knot + 1] = bars.path[w, g, knot + 1] + u * bar

    @wp.func
    def place_gripper(
        row: int, w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, grips: Grips
    ):
        """Gripper g of world w in the substep from t to t + dt [s]."""
        here, knot = path_point(w, g, t, paths)
        there, end = path_point(w, g, t + dt, paths)
        # each segment turns it for as long as the substep has part in it
        turned = wp.vec3d()
        for k in range(knot, end + 1):
            until = wp.min(t + dt, paths.time[w, g, k + 1])
            inside = wp.max(until - wp.max(t, paths.time[w, g, k]), wp.float64(0.0))
            turned += inside * paths.spin[w, g, k]
        spin = turned / dt
        grips.centre[row, g] = narrow(here)
        grips.velocity[row, g] = narrow((there - here) / dt)
        grips.spin[row, g] = narrow(spin)
        closed = int(OPEN)
        if t >= paths.hold_from[w, g] and t < paths.hold_until[w, g]:
            closed = int(CLOSED)
        grips.closed[row, g] = closed

    @wp.func
    def place_gripper_back(
        w: int, g: int, t: wp.float64, dt: wp.float64, paths: Paths, bars: SceneBars
    ):
        """Transpose of ``place_gripper`` in the path's positions."""
        moved = bars.velocity[w, g] / dt
        path_point_back(w, g, t, bars.centre[w, g] - moved, paths, bars)
        path_point_back(w, g, t + dt, moved, paths, bars)

    @wp.func
    def node_place(layout: int, n: int, scene: Scene, columns: Columns):
        """Place of node n of a layout [m]."""
        cell = columns.cell[layout, n]
        return vec3(
            real(columns.bounds[layout, 0] + (cell >> CELL_BITS)) * scene.dx,
            real(columns.bounds[layout, 1] + (cell & mask)) * scene.dx,
            scene.z0 + real(columns.level[layout, n]) * scene.dx,
        )

    @wp.func
    def holds(row: int, w: int, g: int, at: vec3, scene: Scene, paths: Paths, grips: Grips):
        """Whether gripper g holds a node."""
        # a particle is rigid when its whole stencil is held: one cell further
        reach = paths.radius[w, g] + scene.dx
        near = wp.length_sq(at - grips.centre[row, g]) < reach * reach
        return near and grips.closed[row, g] == CLOSED

    @wp.func
    def update_node(
        w: int,
        row: int,
        layout: int,
        n: int,
        q: vec4,
        dt: real,
        keep: real,
        scene: Scene,
        paths: Paths,
        grips: Grips,
        columns: Columns,
    ):
        """Velocity of a node after gravity, damping, table, walls and grippers.

        Damping takes the same share of every impulse of the substep: were gravity's left out, a
        body at rest would carry too little stress. ``row`` is that of the grippers' placement,
        ``keep`` the share of velocity that damping leaves.
        """
        v = keep * (vec3(q[0], q[1], q[2]) / q[3] + dt * scene.gravity[w])
        at = node_place(layout, n, scene, columns)
        if scene.walls == 1:
            for a in range(3):
                if at[a] <= scene.box_lower[a]:
                    v[a] = wp.max(v[a], real(0.0))
                if at[a] >= scene.box_upper[a]:
                    v[a] = wp.min(v[a], real(0.0))
        if scene.table == 1 and columns.level[layout, n] <= 0 and v[2] < real(0.0):
            friction = scene.friction[w]
            slip = wp.sqrt(v[0] * v[0] + v[1] * v[1])
            left = real(0.0)
            if slip > -friction * v[2]:
                left = real(1.0) + friction * v[2] / slip
            v = vec3(left * v[0], left * v[1], real(0.0))
        for g in range(grips.closed.shape[1]):
            if holds(row, w, g, at, scene, paths, grips):
                v = grips.velocity[row, g] + wp.cross(grips.spin[row, g], at - grips.centre[row, g])
        return v

    @wp.func
    def update_node_back(
        w: int,
        row: int,
        layout: int,
        n: int,
        q: vec4,
        bar: vec3,
        dt: real,
        keep: real,
        scene: Scene,
        paths: Paths,
        grips: Grips,
        columns: Columns,
        bars: SceneBars,
    ):
        """Transpose of ``update_node``: derivative by momentum and mass from that by velocity.

        Returns those by ``keep`` and by gravity too, which most nodes have, for the caller to sum
        up; those by friction and grippers are added to ``bars``.
        """
        at = node_place(layout, n, scene, columns)
        holder = int(-1)
        for g in range(grips.closed.shape[1]):
            if holds(row, w, g, at, scene, paths, grips):
                holder = g
        result = vec4()
        keep_bar = wp.float64(0.0)
        gravity_bar = wp.vec3d()
        if holder >= 0:
            about = wp.cross(grips.spin[row, holder], bar)  # -(d/dcentre) of spin x (at - centre)
            wp.atomic_add(bars.velocity, w, holder, wide(bar))
            wp.atomic_add(bars.centre, w, holder, wide(about))
        else:
            p = vec3(q[0], q[1], q[2]) / q[3]
            fallen = p + dt * scene.gravity[w]
            v = keep * fallen
            open_axis = vec3(real(1.0), real(1.0), real(1.0))
            if scene.walls == 1:
                for a in range(3):
                    if at[a] <= scene.box_lower[a] and v[a] < real(0.0):
                        v[a] = real(0.0)
                        open_axis[a] = real(0.0)
                    if at[a] >= scene.box_upper[a] and v[a] > real(0.0):
                        v[a] = real(0.0)
                        open_axis[a] = real(0.0)
            b = bar
            if scene.table == 1 and columns.level[layout, n] <= 0 and v[2] < real(0.0):
                friction = scene.friction[w]
                slip = wp.sqrt(v[0] * v[0] + v[1] * v[1])
                b = vec3()
                if slip > -friction * v[2]:
                    left = real(1.0) + friction * v[2] / slip
                    along = bar[0] * v[0] + bar[1] * v[1]
                    turn = -friction * v[2] * along / (slip * slip * slip)
                    b = vec3(
                        left * bar[0] + turn * v[0],
                        left * bar[1] + turn * v[1],
                        friction * along / slip,
                    )
                    wp.atomic_add(bars.friction, w, wp.float64(along * v[2] / slip))
            b = wp.cw_mul(b, open_axis)
            keep_bar = wp.float64(wp.dot(b, fallen))
            b = keep * b
            gravity_bar = wide(dt * b)
            b = b / q[3]
            result = vec4(b[0], b[1], b[2], -wp.dot(b, p))
        return result, keep_bar, gravity_bar

    return SimpleNamespace(
        Scene=Scene,
        Paths=Paths,
        Grips=Grips,
        SceneBars=SceneBars,
        place_gripper=place_gripper,
        place_gripper_back=place_gripper_back,
        update_node=update_node,
        update_node_back=update_node_back,
    )
