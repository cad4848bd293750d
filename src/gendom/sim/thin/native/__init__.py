"""The thin engine's native code, and how kernels call it."""

# Types inside kernels are Warp's, made at run time; a type checker cannot follow them.
# pyright: reportInvalidTypeForm=false, reportReturnType=false

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from gendom.sim.native import functions_of, module_options
from gendom.sim.thin.types import make_types

MODULE_OPTIONS = module_options(
    __name__,
    "surroundings.h", "hold.h", "contact_lists.h", "contact.h", "rod.h", "registers.h",
    "interleaved.h", "shell.h",
)  # fmt: skip
"""Options of every Warp module of the engine."""


def options_in_shared(real: Any, row_length: int) -> dict[str, Any]:
    """Those of a kernel whose blocks keep in shared memory what lives no longer than a step, in
    rows of so many numbers."""
    texts = MODULE_OPTIONS["extra_build_options"]
    built = wp.ModuleBuildOptions(
        extra_cpu_preamble=texts.extra_cpu_preamble,
        extra_cuda_preamble=f"#define ROW_LENGTH {row_length}\n{texts.extra_cuda_preamble}",
    )
    fast = real == wp.float32  # divisions and roots to two units in the last place, a third faster
    return MODULE_OPTIONS | {"extra_build_options": built, "fast_math": fast}


@functools.cache
def make_native(real: Any, kind: str, held: int) -> SimpleNamespace:
    """Declare the native functions of steps for one scalar type and one kind of body, ``rod`` or
    ``shell``; the headers say what they do. ``held``: points of a rod in a thread's registers."""
    types = make_types(real)
    ThinModel, ModelAdjoint = types.ThinModel, types.ModelAdjoint
    vec3, quat = types.vec3, types.quat
    rows, number = wp.array3d(dtype=real), "float" if real == wp.float32 else "double"

    @wp.func_native("gendom::block_sync();")
    def block_sync(): ...

    @wp.func_native("return gendom::block_any(value);")
    def block_any(value: int) -> int: ...

    @wp.func_native(f"return gendom::{kind}_forces(model, w, state, row, next, dt);")
    def forces(model: ThinModel, w: int, state: rows, row: int, next: int, dt: real) -> real: ...

    @wp.func_native(f"gendom::{kind}_forces_adjoint(model, adjoint, w, state, row, dt);")
    def forces_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, w: int, state: rows, row: int, dt: real
    ): ...

    @wp.func_native(f"gendom::{kind}_gather_adjoint(model, adjoint, w);")
    def gather_adjoint(model: ThinModel, adjoint: ModelAdjoint, w: int): ...

    @wp.func_native(f"gendom::{kind}_move(model, w, state, row, next, dt, kick);")
    def move(model: ThinModel, w: int, state: rows, row: int, next: int, dt: real, kick: real): ...

    @wp.func_native(f"gendom::{kind}_move_adjoint(model, adjoint, w, state, row, dt, kick);")
    def move_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, w: int, state: rows, row: int, dt: real, kick: real
    ): ...

    @wp.func_native(f"return gendom::{kind}_stretch(model, state, row);")
    def mean_stretch(model: ThinModel, state: rows, row: int) -> real: ...

    @wp.func_native("gendom::hold(model, w, g, gendom::to_pose(centre, turned), state, next);")
    def hold(
        model: ThinModel, w: int, g: int, centre: vec3, turned: quat, state: rows, next: int
    ): ...

    @wp.func_native("gendom::put_pose(index, centre, turned);")
    def put_pose(index: int, centre: vec3, turned: quat): ...

    @wp.func_native(f"gendom::hold(model, w, g, gendom::pose_of<{number}>(index), state, next);")
    def hold_ahead(model: ThinModel, w: int, g: int, index: int, state: rows, next: int): ...

    @wp.func_native("gendom::begin_shared(model, w);")
    def begin_shared(model: ThinModel, w: int): ...

    @wp.func_native("gendom::hold_adjoint(model, adjoint, w, g, turned);")
    def hold_adjoint(model: ThinModel, adjoint: ModelAdjoint, w: int, g: int, turned: quat): ...

    # a rod in registers

    Registers, Holds = (wp.types.vector(k * max(held, 1), of) for k, of in ((19, real), (1, int)))

    @wp.func_native("return gendom::begin(model, w, state, row, closed, own);")
    def begin(
        model: ThinModel, w: int, state: rows, row: int, closed: int, own: wp.ref[Registers]
    ) -> Holds: ...

    @wp.func_native("gendom::store(state, row, own);")
    def store(state: rows, row: int, own: wp.ref[Registers]): ...

    @wp.func_native("return gendom::shares_of(model, w, dt, kick);")
    def shares_of(model: ThinModel, w: int, dt: real, kick: real) -> vec3: ...

    @wp.func_native(
        "return gendom::step_in_registers(model, w, own, holds, ahead, apart, dt, kick, shares);"
    )
    def step_in_registers(
        model: ThinModel, w: int, own: wp.ref[Registers], holds: Holds, ahead: int, apart: int,
        dt: real, kick: real, shares: vec3,
    ) -> real: ...  # fmt: skip

    # rods side by side

    of_row = f"gendom::rows_of<{number}>(state, row)"

    @wp.func_native(f"return gendom::interleaved<{number}>::lanes;")
    def lanes() -> int: ...

    @wp.func_native("gendom::load_lanes(model, w, count, state);")
    def load_lanes(model: ThinModel, w: int, count: int, state: rows): ...

    @wp.func_native(f"gendom::copy_lane<false>(model, w, l, {of_row}, 0, gendom::state_rows);")
    def store_lane(model: ThinModel, w: int, l: int, state: rows, row: int): ...

    @wp.func_native(f"gendom::copy_lane<true>(model, w, l, {of_row}, 0, gendom::state_rows);")
    def load_lane(model: ThinModel, w: int, l: int, state: rows, row: int): ...

    @wp.func_native("gendom::set_step(model, w, l, dt, kick);")
    def set_step(model: ThinModel, w: int, l: int, dt: real, kick: real): ...

    @wp.func_native("gendom::set_pose(model, w, l, g, centre, turned);")
    def set_pose(model: ThinModel, w: int, l: int, g: int, centre: vec3, turned: quat): ...

    @wp.func_native(f"gendom::step_interleaved<{number}>(model, w);")
    def step_interleaved(model: ThinModel, w: int): ...

    @wp.func_native(f"return gendom::worst_stretch<{number}>(model, w, l);")
    def worst_stretch(model: ThinModel, w: int, l: int) -> real: ...

    # contact of a body with itself; kernels with rods in registers have no shared memory for it

    lists = held == 0

    @wp.func_native(lists * f"gendom::rebuild_lists(model, w, {of_row}.from(c), far);" + ";")
    def rebuild_lists(model: ThinModel, w: int, state: rows, row: int, c: int, far: real): ...

    @wp.func_native(lists * "gendom::keep_list(model, w, state, row, c);" + ";")
    def keep_list(model: ThinModel, w: int, state: rows, row: int, c: int): ...

    @wp.func_native("gendom::resolve(model, w, state, row, dt);")
    def resolve(model: ThinModel, w: int, state: rows, row: int, dt: real): ...

    @wp.func_native("gendom::resolve_adjoint(model, adjoint, w, kept, at, state, row, c, dt);")
    def resolve_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, w: int, kept: rows, at: int, state: rows, row: int,
        c: int, dt: real,
    ): ...  # fmt: skip

    return SimpleNamespace(**vars(functions_of(locals())), Registers=Registers)
