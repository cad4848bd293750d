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
    "surroundings.h", "hold.h", "contact_lists.h", "contact.h", "rod.h", "shell.h",
)  # fmt: skip
"""Options of every Warp module of the engine."""


@functools.cache
def make_native(real: Any, kind: str) -> SimpleNamespace:
    """Declare the native functions of steps for one scalar type and one kind of body, ``rod`` or
    ``shell``; the headers say what they do."""
    types = make_types(real)
    ThinModel, ModelAdjoint = types.ThinModel, types.ModelAdjoint
    vec3, quat = types.vec3, types.quat
    rows = wp.array3d(dtype=real)

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

    @wp.func_native("gendom::hold(model, w, g, centre, turned, state, next);")
    def hold(
        model: ThinModel, w: int, g: int, centre: vec3, turned: quat, state: rows, next: int
    ): ...

    @wp.func_native("gendom::hold_adjoint(model, adjoint, w, g, turned);")
    def hold_adjoint(model: ThinModel, adjoint: ModelAdjoint, w: int, g: int, turned: quat): ...

    # contact of a body with itself

    @wp.func_native("gendom::rebuild_lists(model, w, state, row, c, far);")
    def rebuild_lists(model: ThinModel, w: int, state: rows, row: int, c: int, far: real): ...

    @wp.func_native("gendom::keep_list(model, w, state, row, c);")
    def keep_list(model: ThinModel, w: int, state: rows, row: int, c: int): ...

    @wp.func_native("gendom::resolve(model, w, state, row, dt);")
    def resolve(model: ThinModel, w: int, state: rows, row: int, dt: real): ...

    @wp.func_native("gendom::resolve_adjoint(model, adjoint, w, kept, at, state, row, c, dt);")
    def resolve_adjoint(
        model: ThinModel, adjoint: ModelAdjoint, w: int, kept: rows, at: int, state: rows, row: int,
        c: int, dt: real,
    ): ...  # fmt: skip

    return functions_of(locals())
