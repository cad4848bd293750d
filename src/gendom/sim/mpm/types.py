"""What kernels take: structs of arrays, made for one scalar type.

Shapes: W worlds, N particles, G grippers, K path knots, rows: one a world or one a recorded
substep. A name with ``_bar`` is the derivative of a loss by that quantity.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.paths import make_path_type

OK, GRID_FULL, INVERTED, DIVERGED, NOTHING_HELD = range(5)
"""Statuses of a world; the last one: a gripper closed on nothing."""


@functools.cache
def make_types(real: Any) -> SimpleNamespace:
    """The types for ``wp.float32`` or ``wp.float64``: vectors, matrices, and the structs below.

    ``compensates`` says whether positions keep what rounding leaves out.
    """
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    symmetric = wp.types.vector(6, real)  # xx, yy, zz, xy, xz, yz

    @wp.struct
    class Model:
        """What W bodies consist of, and what surrounds them."""

        mu: wp.array2d(dtype=real)  # [W, N] [Pa]
        lam: wp.array2d(dtype=real)  # [W, N] [Pa]
        mass: wp.array(dtype=real)  # [W] of a particle [kg]
        damping: wp.array(dtype=real)  # [W] viscous over elastic stress in slow motion [s]
        drag: wp.array(dtype=real)  # [W] see ``internal_forces``; 0: no air
        volume: real  # of a particle [m^3]
        sheet: int  # 1: a cloth, 0: a rope
        section: int  # particles that share a cross-section; they follow each other
        beyond: real  # see ``boundary.BEYOND``
        grip_stiffness: real  # see ``boundary.STIFFNESS``
        contact_radius: real  # height of a section's centre above the table at rest [m]
        lattice: wp.array3d(dtype=wp.int32)  # [N, 3, 2]
        frame: wp.array2d(dtype=real)  # [6, N] rest frame's upper triangle but for a rotation [1/m]
        dx: real  # edge of a cell of the grid [m]
        gravity: wp.array(dtype=vec3)  # [W] [m/s^2]
        velocity_damping: wp.array(dtype=real)  # [W] [1/s]
        table: int  # at height 0
        friction: wp.array(dtype=real)  # [W]

    @wp.struct
    class Substep:
        """A substep of one world, as one of the threads sees it that take it."""

        w: int  # world
        thread: int
        threads: int
        N: int
        h: real  # length [s]
        age: int  # substeps before it in all
        gone: int  # and in a recording
        mass: real
        gravity: vec3
        dx: real
        inv_dx: real
        keep_velocity: real  # share of velocity that damping leaves
        layout: int  # of the grid
        slot: int  # row of the grid's momentum, and of the tape
        row: int  # row of the grid's velocity
        grip_row: int  # of the grippers' poses
        holding: int  # particles that grippers hold

    @wp.struct
    class Grid:
        """L layouts of the sparse grid and the values on their M nodes, see ``grid``."""

        bounds: wp.array2d(dtype=wp.int32)  # [L, 4] lowest and highest cell in x, y
        low: wp.array3d(dtype=wp.int32)  # [L, X, Y] lowest node of the column
        high: wp.array3d(dtype=wp.int32)  # [L, X, Y] highest node of the column
        start: wp.array3d(dtype=wp.int32)  # [L, X, Y] node k is number start + k
        count: wp.array(dtype=wp.int32)  # [L] nodes in use
        # a row for each world; of momentum also one for each recorded substep
        momentum: wp.array2d(dtype=vec4)  # [rows, M] and mass
        velocity: wp.array2d(dtype=vec4)  # [rows, M] and mass
        velocity_bar: wp.array2d(dtype=vec4)  # [rows, M] for the reverse; then by momentum and mass
        tally: wp.array2d(dtype=wp.int32)  # [rows, M] scratch

    @wp.struct
    class Grips:
        """Where grippers are at the end of a substep, and what they hold."""

        closed: wp.array2d(dtype=wp.int32)  # [rows, G]
        centre: wp.array2d(dtype=vec3)  # [rows, G] [m]
        orientation: wp.array2d(dtype=mat33)  # [rows, G]
        velocity: wp.array2d(dtype=vec3)  # [rows, G] [m/s]
        spin: wp.array2d(dtype=vec3)  # [rows, G] [rad/s]
        # from the substep on in which a gripper closed
        since: wp.array2d(dtype=wp.int32)  # [W, G] number of that substep; -1: not yet
        until: wp.array2d(dtype=wp.int32)  # [W, G] number of that in which it opened; -1: not yet
        count: wp.array2d(dtype=wp.int32)  # [W, G] particles held
        particle: wp.array3d(dtype=wp.int32)  # [W, G, N] which
        weight: wp.array3d(dtype=real)  # [W, G, N] how firmly, above 0, at most 1
        place: wp.array3d(dtype=vec3)  # [W, G, N] where in the gripper's frame [m]
        free: wp.array2d(dtype=real)  # [W, N] share of a particle that no gripper holds
        held_by: wp.array2d(dtype=wp.int32)  # [W, N] gripper times N, and place in its list
        # the same of stored particles, and a list of those held, in any order, see ``gripped``
        stored_free: wp.array2d(dtype=real)  # [W, N]
        driven: wp.array2d(dtype=vec3)  # [W, N] velocity that its gripper would give it [m/s]
        held: wp.array(dtype=wp.int32)  # [W] how many
        held_index: wp.array2d(dtype=wp.int32)  # [W, N] of the stored particle
        held_gripper: wp.array2d(dtype=wp.int32)  # [W, N]
        held_number: wp.array2d(dtype=wp.int32)  # [W, N] among what that gripper holds
        held_share: wp.array2d(dtype=real)  # [W, N] that no gripper holds
        held_place: wp.array2d(dtype=vec3)  # [W, N] in the gripper's frame [m]
        held_modulus: wp.array2d(dtype=real)  # [W, N] of pressure waves [Pa]

    @wp.struct
    class State:
        """Particles between launches, or derivatives by them."""

        x: wp.array2d(dtype=vec3)  # [W, N] [m]
        v: wp.array2d(dtype=vec3)  # [W, N] [m/s]
        C: wp.array2d(dtype=mat33)  # [W, N] [1/s]
        Z: wp.array2d(dtype=symmetric)  # [W, N] filtered stress, of bodies with damping [Pa]
        low: wp.array2d(dtype=vec3)  # [W, N] what rounding leaves out of x, in float32 [m]
        sums: wp.array3d(dtype=real)  # [W, 4, N] derivatives by each particle's parameters

    @wp.struct
    class Records:
        """The same in a launch or on a tape, in an order of their own, see ``particles``."""

        of: wp.array3d(dtype=real)  # [rows, components, N], or [1, ...] in shared memory
        moduli: wp.array3d(dtype=real)  # [W, 2, N] mu, lam
        order: wp.array2d(dtype=wp.int32)  # [W, N] particle of each record; recorded: [L, N]
        place: wp.array2d(dtype=wp.int32)  # [W, N] record of each particle; recorded: [L, N]
        near: wp.array3d(dtype=wp.int32)  # [W, 6, N] records of its neighbours
        layout_of: wp.array(dtype=wp.int32)  # [rows] recorded: layout of each substep
        sums: wp.array3d(dtype=real)  # as of ``State``
        # scratch
        spare: wp.array3d(dtype=real)  # [W, components + 4, N]
        spare_order: wp.array2d(dtype=wp.int32)  # [W, N]

    @wp.struct
    class Clock:
        """Where W worlds stand in the frame that they are in."""

        dt: wp.array(dtype=wp.float64)  # [W] [s]
        step: wp.array(dtype=wp.int32)  # [W] substeps done
        age: wp.array(dtype=wp.int32)  # [W] substeps done in all
        travel: wp.array(dtype=real)  # [W] distance since the grid was rebuilt [m]
        status: wp.array(dtype=wp.int32)  # [W]
        failed_particle: wp.array(dtype=wp.int32)  # [W] or gripper
        frame: wp.array(dtype=wp.int32)  # [W] of a ``FramePlan``

    @wp.struct
    class FramePlan:
        """T frames that W worlds go through, each at its own pace."""

        time: wp.array(dtype=wp.float64)  # [T + 1] where each begins, and the last one's end [s]
        steps: wp.array2d(dtype=wp.int32)  # [T, W] equal substeps of each
        dt: wp.array2d(dtype=wp.float64)  # [T, W] their length; 0 where there are none [s]
        particles: wp.array(dtype=wp.int32)  # [P] whose positions are recorded where a frame ends
        x: wp.array3d(dtype=vec3)  # [T, W, P] [m]

    @wp.struct
    class ConditionsAdjoint:
        """Derivatives by conditions and grippers, summed up."""

        friction: wp.array(dtype=wp.float64)  # [W]
        velocity_damping: wp.array(dtype=wp.float64)  # [W]
        damping: wp.array(dtype=wp.float64)  # [W]
        gravity: wp.array(dtype=wp.vec3d)  # [W]
        position: wp.array3d(dtype=wp.vec3d)  # [W, G, K]
        turn: wp.array3d(dtype=wp.vec3d)  # [W, G, K] by a rotation of each knot, in world axes
        radius: wp.array2d(dtype=wp.float64)  # [W, G]
        weight: wp.array3d(dtype=real)  # [W, G, N]
        place: wp.array3d(dtype=vec3)  # [W, G, N]
        # by the poses of ``Grips`` in one substep, until they are added to the paths'
        centre: wp.array2d(dtype=wp.vec3d)  # [W, G]
        rotation: wp.array2d(dtype=wp.vec3d)
        velocity: wp.array2d(dtype=wp.vec3d)
        spin: wp.array2d(dtype=wp.vec3d)
        touched: wp.array2d(dtype=vec3)  # [W, sections] scratch: velocity changed by the table

    compensates, Paths = real == wp.float32, make_path_type(real)
    return SimpleNamespace(**locals())
