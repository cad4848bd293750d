"""Derivatives by what grippers hold, for the threads of a block.

The transpose of ``lead`` and ``carry`` of ``runners.block_kernels``. A warp's derivatives by a
gripper are summed before they are added to it.

Shapes: W worlds, N particles, M nodes.
"""

import functools
from typing import Any

import warp as wp

from gendom.sim.mpm.adjoint.boundary import make_boundary_adjoint
from gendom.sim.mpm.adjoint.records import LAM, MASS, MU, make_bar_records, make_recorded
from gendom.sim.mpm.block import make_block, make_store
from gendom.sim.mpm.boundary import FOLLOWS
from gendom.sim.mpm.runners.held import make_held
from gendom.sim.mpm.runners.records import C, V, X
from gendom.sim.mpm.types import Namespace, make_types


@functools.cache
def make_held_adjoint(real: Any, *, resident: bool) -> Namespace:
    """Build ``carry_adjoint`` and ``lead_adjoint`` for one scalar type and kind of records."""
    types = make_types(real)
    Vectors = types.Vectors
    vec3 = types.vec3
    Matter, Scene, Grips, SceneBars = types.Matter, types.Scene, types.Grips, types.SceneBars
    recorded = make_recorded(real)
    bar_records = make_bar_records(real, resident=resident)
    Tape, BarRecords, Held = recorded.Struct, bar_records.Struct, make_held(real).Held
    boundary = make_boundary_adjoint(real, recorded, bar_records)
    bar = make_store(real, resident=resident)
    wide, vector = boundary.wide, make_store(real, resident=False).vector
    add_by_warp = make_block(real).add_by_warp
    pose_type = wp.types.matrix((4, 3), wp.float64)

    @wp.func
    def rows_of(centre_bar: vec3, V_bar: vec3, spin_bar: vec3, R_bar: vec3):
        """Derivatives by a gripper's pose, a row each."""
        return wp.matrix_from_rows(wide(centre_bar), wide(V_bar), wide(spin_bar), wide(R_bar))

    @wp.func
    def add_to_pose(grip_row: int, g: int, total: pose_type, bars: SceneBars):
        """Add the sum of a warp's derivatives by a gripper's pose."""
        add_by_warp(bars.centre, grip_row, g, total[0])
        add_by_warp(bars.velocity, grip_row, g, total[1])
        add_by_warp(bars.spin, grip_row, g, total[2])
        add_by_warp(bars.rotation, grip_row, g, total[3])

    @wp.func
    def carry_adjoint(
        w: int, lane: int, lanes: int, holding: int, grip_row: int, h: real, grips: Grips,
        records: BarRecords, held: Held, bars: SceneBars,
    ):  # fmt: skip
        """Derivatives by x and by grippers of what they hold firmly."""
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(lane, holding, lanes):
                if held.gripper[w, n] == g and held.share[w, n] == real(0.0):
                    i = held.record[w, n]
                    x_bar = bar.vector(records.of, w, X, i)
                    centre_bar, V_bar, spin_bar, R_bar = boundary.follow_adjoint(
                        w, g, held.number[w, n], grip_row, real(FOLLOWS), h,
                        bar.vector(records.of, w, V, i) + h * x_bar,
                        boundary.turned_adjoint(bar.matrix(records.of, w, C, i)), grips, bars,
                    )  # fmt: skip
                    bar.put_vector(records.of, w, X, i, x_bar - centre_bar)
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(grip_row, g, total, bars)

    @wp.func
    def lead_adjoint(
        w: int, lane: int, lanes: int, holding: int, grip_row: int, slot: int, layout: int, h: real,
        matter: Matter, scene: Scene, grips: Grips, tape: Tape, touches: int, touched: Vectors,
        records: BarRecords, held: Held, bars: SceneBars,
    ):  # fmt: skip
        """The same of what they hold in part, and by mass and moduli.

        Derivatives by u are known, those by the velocity that a particle is given follow.
        """
        for g in range(grips.closed.shape[1]):
            total = pose_type()
            for n in range(lane, holding, lanes):
                share = held.share[w, n]
                if held.gripper[w, n] == g and share > real(0.0):
                    i = held.record[w, n]
                    u = vector(tape.of, slot, 15, i) / matter.mass[w]
                    if touches == 1:
                        u += touched[w, tape.order[layout, i] // matter.section]
                    by_lam, by_mass, centre_bar, V_bar, spin_bar, R_bar = boundary.led_adjoint(
                        w, g, held.number[w, n], held.modulus[w, n], real(1.0) - share, grip_row,
                        vector(tape.of, slot, 0, i), u, h, scene.dx, matter,
                        bar.vector(records.of, w, V, i) / share, grips, bars,
                    )  # fmt: skip
                    x_bar = bar.vector(records.of, w, X, i)
                    bar.put_vector(records.of, w, X, i, x_bar - centre_bar)
                    records.sums[w, LAM, i] = records.sums[w, LAM, i] + by_lam
                    records.sums[w, MU, i] = records.sums[w, MU, i] + real(2.0) * by_lam
                    records.sums[w, MASS, i] = records.sums[w, MASS, i] + by_mass
                    total += rows_of(centre_bar, V_bar, spin_bar, R_bar)
            add_to_pose(grip_row, g, total, bars)

    return Namespace(carry_adjoint, lead_adjoint)
