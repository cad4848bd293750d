"""What the graph of an ONNX file may hold, seen before anything runs or allocates it.

The wire format is that of protocol buffers (https://protobuf.dev/programming-guides/encoding/), the
numbers of fields those of ``onnx.proto``. Operators are those of multilayer perceptrons: none makes
more numbers than it is given, but for `Concat`, which may stand there once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

from gendom.errors import PolicyError

LARGEST = 1 << 22
"""Of a policy's file [bytes]: ten times that of a shipped one."""

OPERATORS = ("Add", "Concat", "Div", "Exp", "Gemm", "Log", "MatMul", "Mul", "Relu", "Sigmoid",
             "Sub", "Sum", "Tanh")  # fmt: skip

MOST_NODES, MOST_INPUTS, LARGEST_SIDE = 256, 64, 4096
"""Nodes of the graph, inputs of one, and rows or columns of its weights."""

_GRAPH, _TRAINING, _FUNCTION = 7, 20, 25  # of a model
_NODE, _INITIALIZER, _SPARSE = 1, 5, 15  # of a graph
_INPUT, _OPERATOR = 1, 4  # of a node
_DIMS, _EXTERNAL, _LOCATION = 1, 13, 14  # of a tensor

SEAL = b"\x72\x51\x0a\x0dgendom-sha256\x12\x40"
"""Head of the last entry of a model's metadata: the SHA-256 of what is before."""


def sealed(content: bytes) -> bytes:
    """An ONNX file with its checksum, in place of an older one."""
    content = content.partition(SEAL)[0]
    return content + SEAL + hashlib.sha256(content).hexdigest().encode()


def check_graph(content: bytes, where: str) -> None:
    """Check an ONNX file.

    Raises:
        PolicyError: It is none, or not one of a policy.
    """
    try:
        fault = next(_faults(content), None)
    except ValueError:
        fault = "is not an ONNX file"
    if fault is not None:
        fix = "check that it is a policy written by gendom train"
        raise PolicyError(fault, where=where, fix=fix)


def _faults(content: bytes) -> Iterator[str]:
    if SEAL in content and sealed(content) != content:  # files of 0.1 have none
        yield "is damaged: it is not what was written"
    nodes = joined = 0
    for number, graph in _fields(memoryview(content)):
        if number in (_TRAINING, _FUNCTION):
            yield "holds functions of its own"
        if number != _GRAPH or not isinstance(graph, memoryview):
            continue
        for kind, part in _fields(graph):
            nodes += 1
            if nodes > MOST_NODES:
                yield f"has more than {MOST_NODES} nodes and tensors"
            if kind == _SPARSE:
                yield "has sparse weights"
            if kind == _INITIALIZER and isinstance(part, memoryview):
                yield from _tensor_faults(part)
            if kind == _NODE and isinstance(part, memoryview):
                inputs = [value for field, value in _fields(part) if field == _INPUT]
                names = [value for field, value in _fields(part) if field == _OPERATOR]
                name = bytes(names[0]).decode() if names else ""  # pyright: ignore
                joined += name == "Concat"
                if name not in OPERATORS:
                    yield f"has the operator {name[:60]!r}, which no policy has"
                if joined > 1 or len(inputs) > MOST_INPUTS:
                    yield "joins more than a policy does"


def _tensor_faults(tensor: memoryview) -> Iterator[str]:
    sides: list[int] = []
    for number, value in _fields(tensor):
        if number == _EXTERNAL or (number == _LOCATION and value):
            yield "keeps weights in another file"
        if number == _DIMS:
            sides += [value] if isinstance(value, int) else _packed(value)
    if len(sides) > 2 or max(sides, default=0) > LARGEST_SIDE:
        yield f"has weights of shape {sides[:8]}, at most two sides of {LARGEST_SIDE} are read"


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field of a message; what is not a variable integer as its bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        if key & 7 == 0:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if key & 7 == 2:
            size, at = _varint(message, at)
        else:
            size = {1: 8, 5: 4}.get(key & 7, len(message))
        if at + size > len(message):
            raise ValueError("cut short")
        yield key >> 3, message[at : at + size]
        at += size


def _packed(data: memoryview) -> list[int]:
    at, values = 0, []
    while at < len(data) and len(values) < MOST_INPUTS:
        value, at = _varint(data, at)
        values.append(value)
    return values


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    """A variable integer, and where the next byte is."""
    value = 0
    for k in range(10):
        if at + k >= len(data):
            break
        value |= (data[at + k] & 127) << (7 * k)
        if data[at + k] < 128:
            return value, at + k + 1
    raise ValueError("cut short")
