"""Kernels of the search for equilibria: relaxation with kinetic damping, and tangent stiffness.

A search uses the time steps of the simulation, without damping and air; forces, table, grippers
and contact are the same. Velocities are set to 0 whenever the kinetic energy has passed a maximum,
so that the total energy only decreases. While grippers move, velocities are set to 0 every few
steps, and the body follows without momentum. Source: Barnes (1999), "Form finding and analysis of
tension structures by dynamic relaxation".
"""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportReturnType=false, reportAssignmentType=false, reportGeneralTypeIssues=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.paths import make_path_type
from gendom.sim.thin.native import MODULE_OPTIONS
from gendom.sim.thin.stepping import make_stepping
from gendom.sim.thin.types import make_types

EVERY = 4
"""Steps between evaluations of the kinetic energy."""

FOLLOWS = 16
"""Steps after which velocities are set to 0 while grippers move."""

SMOOTH = 8
"""Single steps from rest after each maximum: they damp the remaining fast vibrations."""

CONTACT_SMOOTH = 128
"""The same with self-contact, where more are needed: impulses at contacts are coupled."""

TURN_ROWS = 6
"""Row of a rod's derivatives by rotations of directions, see ``native/rod_adjoint.h``."""


@functools.cache
def make_relaxing(real: Any, kind: str) -> SimpleNamespace:
    """Build the kernels for one scalar type and one kind of body, ``rod`` or ``shell``.

    Returns:
        Namespace with ``relax``, ``balance`` (elastic forces) and ``tangent`` (their derivatives).
    """
    types, step = make_types(real), make_stepping(real, kind)
    meet, any_of, forces, move = step.meet, step.any_of, step.forces, step.move
    hold_all, meet_itself, mean_stretch = step.hold_all, step.meet_itself, step.mean_stretch
    forces_adjoint, gather_adjoint = step.forces_adjoint, step.gather_adjoint
    Paths = make_path_type(real)
    Body, Bars = types.Body, types.Bars

    @wp.func_native(f"return gendom::{kind}_kinetic(body, w, state, row);")
    def kinetic(body: Body, w: int, state: wp.array3d(dtype=real), row: int) -> real: ...

    @wp.func_native(f"gendom::{kind}_rest(body, w, state, row);")
    def rest(body: Body, w: int, state: wp.array3d(dtype=real), row: int): ...

    @wp.func_native("gendom::mark(body, w, state, marks);")
    def mark(body: Body, w: int, state: wp.array3d(dtype=real), marks: wp.array3d(dtype=real)): ...

    @wp.func_native(f"return gendom::{kind}_unbalanced(body, w, state, marks, dt, kick);")
    def unbalanced(
        body: Body, w: int, state: wp.array3d(dtype=real), marks: wp.array3d(dtype=real), dt: real,
        kick: real,
    ) -> real: ...  # fmt: skip

    @wp.func_native(f"gendom::{kind}_elastic(body, w, forces, row);")
    def elastic(body: Body, w: int, forces: wp.array3d(dtype=real), row: int): ...

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def relax(
        first: int,  # world
        lanes: int,  # threads of a world
        body: Body,
        paths: Paths,
        begin: wp.array(dtype=wp.float64),  # [W] start of the grippers' movement [s]
        end: wp.array(dtype=wp.float64),  # [W]
        moves: wp.array(dtype=wp.int32),  # [W] number of steps of that movement
        steps: wp.array(dtype=wp.int32),  # [W] at most, moves included; 0: nothing is done
        dt: wp.array(dtype=real),  # [W] [s]
        least: wp.array(dtype=real),  # [W] tolerance for the unbalanced acceleration [m/s^2]
        limit: real,  # of the squared stretch of an edge
        mean_limit: real,  # of the mean stretch
        state: wp.array3d(dtype=real),
        marks: wp.array3d(dtype=real),  # [W, 3, P] points when they were last at rest [m]
        left: wp.array(dtype=real),  # [W] unbalanced acceleration when last at rest
        taken: wp.array(dtype=wp.int32),  # [W] steps, added
        stopped: wp.array(dtype=wp.int32),  # [W] 1: stretched beyond a limit
    ):
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        if steps[w] <= 0:
            return
        h = dt[w]
        span = end[w] - begin[w]
        bad = int(0)
        done = int(0)
        rested = int(1)
        smooth = int(0)
        before = real(0.0)
        rest(body, w, state, w)
        meet()
        for k in range(steps[w]):
            if not forces(body, w, state, w, w, h) <= limit:
                bad = 1
            meet()
            kick = h
            if rested == 1:
                kick = real(0.5) * h
                mark(body, w, state, marks)
            move(body, w, state, w, w, h, kick)
            meet()
            t = end[w]
            if k + 1 < moves[w]:
                t = begin[w] + wp.float64(k + 1) / wp.float64(moves[w]) * span
            hold_all(body, w, begin[w], t, paths, state, w)
            if body.contact == 1:
                meet_itself(body, w, state, w, h)
            done += 1
            small = int(0)
            if rested == 1 and k >= moves[w]:
                residual = unbalanced(body, w, state, marks, h, kick)
                left[w] = residual
                if residual <= least[w]:
                    small = 1
            rested = 0
            if k < moves[w]:
                if (k + 1) % FOLLOWS == 0 or k + 1 == moves[w]:
                    rested = 1
            elif smooth > 0:
                smooth -= 1
                rested = 1
            elif (k + 1) % EVERY == 0:
                energy = kinetic(body, w, state, w)
                if energy < before:
                    rested = 1
                    smooth = SMOOTH + CONTACT_SMOOTH * body.contact
                else:
                    before = energy
            if rested == 1:
                meet()
                rest(body, w, state, w)
                before = real(0.0)
                meet()
            if small == 1:
                break
        if not mean_stretch(body, state, w) <= mean_limit:
            bad = 1
        meet()
        rest(body, w, state, w)
        if any_of(bad) != 0:
            stopped[w] = 1
        if lane == 0:
            taken[w] = taken[w] + done

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def balance(
        first: int, lanes: int, body: Body, state: wp.array3d(dtype=real),
        out: wp.array3d(dtype=real),  # [1, C, P]
    ):  # fmt: skip
        w = first + wp.tid() // lanes
        forces(body, w, state, w, w, real(1.0))
        meet()
        elastic(body, w, out, w - first)

    @wp.kernel(module="unique", module_options=MODULE_OPTIONS)
    def tangent(
        first: int,
        lanes: int,
        body: Body,
        state: wp.array3d(dtype=real),
        colour: wp.array(dtype=wp.int32),  # [P] of each point in a row, -1: no point
        colours: int,
        bars: Bars,  # 0 but for the model's, of any value
        out: wp.array3d(dtype=real),  # [colours C, C, P]
    ):
        """Derivatives of forces and torques by points and rotations.

        They are found by probing the transpose of the forces with one component of all points of
        one colour at a time; points of the same colour share no neighbour.
        """
        w = first + wp.tid() // lanes
        lane = wp.tid() % lanes
        P = state.shape[2]
        C = out.shape[1]
        for probe in range(colours * C):
            component = probe % C
            for i in range(lane, P, lanes):
                one = real(0.0)
                if colour[i] == probe // C:
                    one = real(1.0)
                bars.scratch[w, component, i] = one
            meet()
            forces_adjoint(body, bars, w, state, w, real(1.0))
            meet()
            gather_adjoint(body, bars, w)
            meet()
            for c in range(C):
                source = c
                if c >= 3:
                    source = TURN_ROWS + c - 3
                for i in range(lane, P, lanes):
                    out[probe, c, i] = bars.state[w, source, i]
                    bars.state[w, source, i] = real(0.0)
            for i in range(lane, P, lanes):
                bars.scratch[w, component, i] = real(0.0)
            meet()

    return SimpleNamespace(relax=relax, balance=balance, tangent=tangent)
