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

OPEN = 0
CLOSED = 1


@functools.cache
def make_boundary(real: Any) -> SimpleNamespace:
    """Build the functions for one scalar type.

    Returns:
        Namespace with ``place_gripper``, ``update_node`` and the transpose of each:
        ``place_gripper_back``, ``update_node_back``.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)

    @wp.func
    def knot_before(w: int, g: int, t: wp.float64, path_time: wp.array3d(dtype=wp.float64)):
        """The knot that starts the segment of time t, and the share of the segment gone by."""
        last = path_time.shape[2] - 1
        lo = int(0)
        hi = int(last)
        while hi - lo > 1:
            mid = (lo + hi) // 2
            if path_time[w, g, mid] <= t:
                lo = mid
            else:
                hi = mid
        span = path_time[w, g, hi] - path_time[w, g, lo]
        u = wp.float64(0.0)
        if span > wp.float64(0.0):
            u = wp.clamp((t - path_time[w, g, lo]) / span, wp.float64(0.0), wp.float64(1.0))
        return lo, u

    @wp.func
    def path_point(
        w: int,
        g: int,
        t: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
    ):
        """Position at time t [s] of gripper g on its piecewise linear path, and the knot before."""
        knot, u = knot_before(w, g, t, path_time)
        a = path_position[w, g, knot]
        return a + u * (path_position[w, g, knot + 1] - a), knot

    @wp.func
    def place_gripper(
        row: int,
        w: int,
        g: int,
        t: wp.float64,
        dt: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        path_position: wp.array3d(dtype=wp.vec3d),
        path_spin: wp.array3d(dtype=wp.vec3d),
        hold_from: wp.array2d(dtype=wp.float64),
        hold_until: wp.array2d(dtype=wp.float64),
        centre_out: wp.array2d(dtype=vec3),
        velocity_out: wp.array2d(dtype=vec3),
        spin_out: wp.array2d(dtype=vec3),
        closed_out: wp.array2d(dtype=wp.int32),
    ):
        here, knot = path_point(w, g, t, path_time, path_position)
        there, _ = path_point(w, g, t + dt, path_time, path_position)
        velocity = (there - here) / dt
        spin = path_spin[w, g, knot]
        last = path_time.shape[2] - 1
        if t < path_time[w, g, 0] or t >= path_time[w, g, last]:
            spin = wp.vec3d()
        centre_out[row, g] = vec3(real(here[0]), real(here[1]), real(here[2]))
        velocity_out[row, g] = vec3(real(velocity[0]), real(velocity[1]), real(velocity[2]))
        spin_out[row, g] = vec3(real(spin[0]), real(spin[1]), real(spin[2]))
        closed = int(OPEN)
        if t >= hold_from[w, g] and t < hold_until[w, g]:
            closed = int(CLOSED)
        closed_out[row, g] = closed

    @wp.func
    def path_point_back(
        w: int,
        g: int,
        t: wp.float64,
        bar: wp.vec3d,
        path_time: wp.array3d(dtype=wp.float64),
        path_bar: wp.array3d(dtype=wp.vec3d),
    ):
        """Transpose of ``path_point`` in the knots' positions."""
        knot, u = knot_before(w, g, t, path_time)
        path_bar[w, g, knot] = path_bar[w, g, knot] + (wp.float64(1.0) - u) * bar
        path_bar[w, g, knot + 1] = path_bar[w, g, knot + 1] + u * bar

    @wp.func
    def place_gripper_back(
        w: int,
        g: int,
        t: wp.float64,
        dt: wp.float64,
        path_time: wp.array3d(dtype=wp.float64),
        centre_bar: wp.vec3d,
        velocity_bar: wp.vec3d,
        path_bar: wp.array3d(dtype=wp.vec3d),
    ):
        """Transpose of ``place_gripper`` in the path's positions."""
        path_point_back(w, g, t, centre_bar - velocity_bar / dt, path_time, path_bar)
        path_point_back(w, g, t + dt, velocity_bar / dt, path_time, path_bar)

    @wp.func
    def update_node(
        w: int,
        row: int,
        q: vec4,
        i: int,
        j: int,
        k: int,
        dt: real,
        dx: real,
        z0: real,
        gravity: vec3,
        keep: real,
        table: int,
        friction: real,
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),
        grip_velocity: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
    ):
        """Velocity of a node after gravity, damping, table, walls and grippers.

        Damping takes the same share of every impulse of the substep: were gravity's left out, a
        body at rest would carry too little stress. ``row`` is that of the grippers' placement.
        """
        v = keep * (vec3(q[0], q[1], q[2]) / q[3] + dt * gravity)
        at = vec3(real(i) * dx, real(j) * dx, z0 + real(k) * dx)
        if walls == 1:
            for a in range(3):
                if at[a] <= box_lower[a]:
                    v[a] = wp.max(v[a], real(0.0))
                if at[a] >= box_upper[a]:
                    v[a] = wp.min(v[a], real(0.0))
        if table == 1 and k <= 0 and v[2] < real(0.0):
            slip = wp.sqrt(v[0] * v[0] + v[1] * v[1])
            left = real(0.0)
            if slip > -friction * v[2]:
                left = real(1.0) + friction * v[2] / slip
            v = vec3(left * v[0], left * v[1], real(0.0))
        for g in range(grip_closed.shape[1]):
            if grip_closed[row, g] == CLOSED:
                # a particle is rigid when its whole stencil is held: one cell further
                reach = grip_radius[w, g] + dx
                r = at - grip_centre[row, g]
                if wp.length_sq(r) < reach * reach:
                    v = grip_velocity[row, g] + wp.cross(grip_spin[row, g], r)
        return v

    @wp.func
    def update_node_back(
        w: int,
        row: int,
        q: vec4,
        bar: vec3,
        i: int,
        j: int,
        k: int,
        dt: real,
        dx: real,
        z0: real,
        gravity: vec3,
        keep: real,
        table: int,
        friction: real,
        walls: int,
        box_lower: vec3,
        box_upper: vec3,
        grip_centre: wp.array2d(dtype=vec3),
        grip_spin: wp.array2d(dtype=vec3),
        grip_closed: wp.array2d(dtype=wp.int32),
        grip_radius: wp.array2d(dtype=real),
        centre_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        velocity_bar: wp.array2d(dtype=wp.vec3d),  # [W, G]
        friction_bar: wp.array(dtype=wp.float64),  # [W]
        keep_bar: wp.array(dtype=wp.float64),  # [W]
        gravity_bar: wp.array(dtype=wp.vec3d),  # [W]
    ):
        """Transpose of ``update_node``: derivative by momentum and mass from that by velocity."""
        at = vec3(real(i) * dx, real(j) * dx, z0 + real(k) * dx)
        holder = int(-1)
        for g in range(grip_closed.shape[1]):
            if grip_closed[row, g] == CLOSED:
                reach = grip_radius[w, g] + dx
                if wp.length_sq(at - grip_centre[row, g]) < reach * reach:
                    holder = g
        result = vec4()
        if holder >= 0:
            about = wp.cross(grip_spin[row, holder], bar)  # -(d/dcentre) of spin x (at - centre)
            wp.atomic_add(
                velocity_bar,
                w,
                holder,
                wp.vec3d(wp.float64(bar[0]), wp.float64(bar[1]), wp.float64(bar[2])),
            )
            wp.atomic_add(
                centre_bar,
                w,
                holder,
                wp.vec3d(wp.float64(about[0]), wp.float64(about[1]), wp.float64(about[2])),
            )
        else:
            v = keep * (vec3(q[0], q[1], q[2]) / q[3] + dt * gravity)
            open_axis = vec3(real(1.0), real(1.0), real(1.0))
            if walls == 1:
                for a in range(3):
                    if at[a] <= box_lower[a] and v[a] < real(0.0):
                        v[a] = real(0.0)
                        open_axis[a] = real(0.0)
                    if at[a] >= box_upper[a] and v[a] > real(0.0):
                        v[a] = real(0.0)
                        open_axis[a] = real(0.0)
            b = bar
            if table == 1 and k <= 0 and v[2] < real(0.0):
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
                    wp.atomic_add(friction_bar, w, wp.float64(along * v[2] / slip))
            b = wp.cw_mul(b, open_axis)
            p = vec3(q[0], q[1], q[2]) / q[3]
            wp.atomic_add(keep_bar, w, wp.float64(wp.dot(b, p + dt * gravity)))
            b = keep * b
            wp.atomic_add(
                gravity_bar,
                w,
                wp.vec3d(wp.float64(dt * b[0]), wp.float64(dt * b[1]), wp.float64(dt * b[2])),
            )
            b = b / q[3]
            result = vec4(b[0], b[1], b[2], -wp.dot(b, p))
        return result

    return SimpleNamespace(
        place_gripper=place_gripper,
        place_gripper_back=place_gripper_back,
        update_node=update_node,
        update_node_back=update_node_back,
    )
