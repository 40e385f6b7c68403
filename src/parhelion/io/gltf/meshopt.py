"""EXT_meshopt_compression: unpacking its three kinds of streams, and its filters.

Written from the extension's specification (A. Kapoulkine and J. St. Pierre, Khronos, 2021),
appendices A and B. Attributes and index sequences are unpacked by NumPy; only triangles, each of
which depends on those before, and the sizes of attributes' groups need loops.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, unknown_name
from . import schema

Bytes = NDArray[np.uint8]

_GROUP = 16  # elements whose deltas are packed alike
_SHORT = "the compressed data ends too early"


def decode(data: memoryview, packed: schema.Meshopt) -> bytes:
    """All elements of the view, as they lie there. Raises SceneError."""
    modes = {"ATTRIBUTES": _attributes, "TRIANGLES": _triangles, "INDICES": _indices}
    if packed.mode not in modes:
        raise SceneError(unknown_name("mode", packed.mode, modes))
    if packed.filter not in ("NONE", *_FILTERS):
        raise SceneError(unknown_name("filter", packed.filter, ("NONE", *_FILTERS)))
    stride = packed.byte_stride
    allowed = range(4, 257, 4) if packed.mode == "ATTRIBUTES" else (2, 4)
    if stride not in allowed:
        raise SceneError(f"byteStride is {stride}; {packed.mode} cannot have that")
    made = modes[packed.mode](np.frombuffer(data, np.uint8), packed.count, stride)
    if packed.filter != "NONE":
        sizes, apply = _FILTERS[packed.filter]
        if stride not in sizes or packed.mode != "ATTRIBUTES":
            raise SceneError(f"the filter {packed.filter} is not for byteStride {stride}")
        made = apply(made)
    return made.tobytes()


# --- Attributes (appendix A, mode 0) -------------------------------------------------------------


def _attributes(data: Bytes, count: int, stride: int) -> Bytes:
    """(count, stride). Blocks of elements hold, byte by byte, differences of one element to the
    next; 16 of them take 0, 2, 4 or 8 bits each, and some of those stand for a byte of their own.
    """
    tail = max(stride, 32)
    if len(data) < 1 + tail or data[0] != 0xA0:
        raise SceneError("is no stream of attributes, version 0")
    block = min((8192 // stride) & ~15, 256)
    sizes = [block] * (count // block) + ([count % block] if count % block else [])
    modes, places = _groups(data, len(data) - tail, sizes, stride)
    deltas = _deltas(data, np.array(modes, np.uint8), np.array(places, np.int64))
    whole = count // block * stride * (block // _GROUP)
    parts = [deltas[:whole].reshape(-1, stride, block).transpose(0, 2, 1).reshape(-1, stride)]
    if count % block:
        parts.append(deltas[whole:].reshape(stride, -1).T[: count % block])
    moves = np.cumsum(np.concatenate(parts), axis=0, dtype=np.uint8)
    return np.asarray(moves + data[len(data) - stride :], np.uint8)


def _groups(data: Bytes, end: int, sizes: list[int], stride: int) -> tuple[list[int], list[int]]:
    """How each group is packed, and where: known only once those before it are."""
    padded = np.concatenate([data, np.zeros(_GROUP, np.uint8)])
    crumbs = sum(((padded >> shift) & 3 == 3).astype(np.int64) for shift in (0, 2, 4, 6))
    nibbles = sum(((padded >> shift) & 15 == 15).astype(np.int64) for shift in (0, 4))
    # bytes that a group takes that begins at each place, in 2 and in 4 bits
    small = (4 + _windows(crumbs, 4)[: len(data)]).astype(np.uint8).tobytes()
    large = (8 + _windows(nibbles, 8)[: len(data)]).astype(np.uint8).tobytes()
    raw = data.tobytes()
    modes, places = [], []
    at = 1
    for size in sizes:
        groups = -(-size // _GROUP)
        for _ in range(stride):
            header = at
            at += -(-groups // 4)
            if at > end:
                raise SceneError(_SHORT)
            for g in range(groups):
                mode = raw[header + g // 4] >> 2 * (g % 4) & 3
                modes.append(mode)
                places.append(at)
                if mode:
                    if at >= end:
                        raise SceneError(_SHORT)
                    at += small[at] if mode == 1 else large[at] if mode == 2 else _GROUP
    if at > end:
        raise SceneError(_SHORT)
    return modes, places


def _windows(values: Any, length: int) -> NDArray[np.int64]:
    """Sums of `length` values from each place on."""
    total = np.concatenate([[0], np.cumsum(values)])
    return np.asarray(total[length:] - total[:-length])


def _deltas(data: Bytes, modes: Bytes, places: NDArray[np.int64]) -> Bytes:
    """(groups, 16) differences."""
    found = np.zeros((len(modes), _GROUP), np.uint8)
    for mode, bits in ((1, 2), (2, 4), (3, 8)):
        chosen = modes == mode
        if not chosen.any():
            continue
        start = places[chosen][:, None]
        per_byte = 8 // bits
        lane = np.arange(_GROUP)
        value = data[start + lane // per_byte] >> (8 - bits * (1 + lane % per_byte))
        value &= np.uint8(2**bits - 1)
        if bits < 8:  # the largest value stands for a byte behind the group
            own = value == 2**bits - 1
            behind = start + _GROUP // per_byte + np.cumsum(own, axis=1) - 1
            value[own] = data[behind[own]]
        found[chosen] = value
    return np.asarray((found >> 1) ^ (0 - (found & 1)), np.uint8)  # zigzag


# --- Indices (appendix A, modes 1 and 2) ---------------------------------------------------------


def _triangles(data: Bytes, count: int, stride: int) -> NDArray[Any]:
    """(count,) indices of triangles that mostly share an edge with one of the 16 last ones."""
    total = count // 3
    if count % 3 or len(data) < 1 + total + 16 or data[0] != 0xE1:
        raise SceneError("is no stream of triangles, version 1")
    raw = data.tobytes()
    end = len(raw) - 16
    table = raw[end:]
    at = 1 + total
    fresh = last = 0
    edges = [(0, 0)] * 16  # rings: the newest lies before `edge`, `vertex`
    vertices = [0] * 16
    edge = vertex = 0
    made: list[int] = []

    def index() -> int:
        """An index by its difference to the last one so given."""
        nonlocal at, last
        value = shift = 0
        while True:
            if at >= end or shift > 28:
                raise SceneError(_SHORT)
            byte = raw[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        last = (last + (value >> 1 ^ -(value & 1))) & 0xFFFFFFFF
        return last

    def corner(code: int) -> int:
        """A new vertex, one of the last ones, or an index."""
        nonlocal fresh
        if code == 0:
            fresh += 1
            return fresh - 1
        return index() if code == 15 else vertices[(vertex - code) & 15]

    for code in raw[1 : 1 + total]:
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = edges[(edge - 1 - high) & 15]
            if low in (13, 14):
                c = last = (last + (1 if low == 14 else -1)) & 0xFFFFFFFF
            else:
                # here 0 is the newest vertex, which is never meant
                c = corner(low + 1 if 0 < low < 13 else low)
            new = [c] if low == 0 or low >= 13 else []
            edges[edge & 15] = (c, b)
            edges[(edge + 1) & 15] = (a, c)
            edge += 2
        else:
            if low < 14:
                second, first = table[low], 0
            else:
                if at >= end:
                    raise SceneError(_SHORT)
                second, first = raw[at], 15 if low == 15 else 0
                at += 1
                if second == 0:
                    fresh = 0
            a, b, c = corner(first), corner(second >> 4), corner(second & 15)
            new = [a]
            new += [b] if second >> 4 in (0, 15) else []
            new += [c] if second & 15 in (0, 15) else []
            edges[edge & 15] = (b, a)
            edges[(edge + 1) & 15] = (c, b)
            edges[(edge + 2) & 15] = (a, c)
            edge += 3
        for v in new:
            vertices[vertex & 15] = v
            vertex += 1
        made += (a, b, c)
    if at != end:
        raise SceneError("the compressed data has more bytes than its triangles need")
    return np.array(made, np.int64).astype(f"<u{stride}")


def _indices(data: Bytes, count: int, stride: int) -> NDArray[Any]:
    """(count,) indices, each by its difference to one of two others."""
    if len(data) < 5 or data[0] != 0xD1:
        raise SceneError("is no stream of indices, version 1")
    body = data[1:-4]
    ends = np.flatnonzero(body < 128)  # of numbers of 7 bits a byte
    if len(ends) != count or (count and ends[-1] != len(body) - 1):
        raise SceneError(f"has {len(ends)} indices; count is {count}")
    if not count:
        return np.zeros(0, f"<u{stride}")
    starts = np.concatenate([[0], ends[:-1] + 1])
    if (ends - starts > 4).any():
        raise SceneError("an index has more than 32 bits")
    place = np.arange(len(body)) - np.repeat(starts, ends - starts + 1)
    values = np.add.reduceat((body & 127).astype(np.int64) << (7 * place), starts)
    delta = values >> 2 ^ -(values >> 1 & 1)
    second = (values & 1).astype(bool)
    made = np.where(second, np.cumsum(delta * second), np.cumsum(delta * ~second))
    return np.asarray(made & 0xFFFFFFFF).astype(f"<u{stride}")


# --- Filters (appendix B) ------------------------------------------------------------------------


def _octahedral(data: Bytes) -> NDArray[Any]:
    """Unit vectors from two coordinates on an octahedron, the third number being 1."""
    stored = data.view("<i1" if data.shape[1] == 4 else "<i2")
    top = np.iinfo(stored.dtype).max
    x, y, one = stored[:, :3].astype(np.float32).T
    one = np.where(one == 0.0, np.float32(1.0), one)
    x, y = x / one, y / one
    z = 1.0 - np.abs(x) - np.abs(y)
    below = np.minimum(z, 0.0)
    x, y = x - np.copysign(below, x), y - np.copysign(below, y)
    made: NDArray[Any] = stored.copy()
    vector = np.stack([x, y, z], axis=1)
    length = np.sqrt((vector * vector).sum(axis=1, keepdims=True))
    made[:, :3] = np.rint(vector / np.maximum(length, np.float32(1e-12)) * top)
    return made


def _quaternion(data: Bytes) -> NDArray[Any]:
    """Unit quaternions without their largest component, which follows from the others."""
    stored = data.view("<i2")
    largest = stored[:, 3] & 3
    one = (stored[:, 3] | 3).astype(np.float32)
    others = stored[:, :3] / one[:, None] * np.float32(np.sqrt(0.5))
    left = np.sqrt(np.maximum(1.0 - (others * others).sum(axis=1), 0.0))
    parts = np.concatenate([left[:, None], others], axis=1)
    made = np.empty_like(stored)
    rows = np.arange(len(stored))
    for k in range(4):
        made[rows, (largest + k) % 4] = np.rint(np.clip(parts[:, k], -1.0, 1.0) * 32767.0)
    return made


def _exponential(data: Bytes) -> NDArray[Any]:
    """Numbers as 24 bits times a power of two of 8 bits."""
    stored = data.view("<i4")
    mantissa = ((stored << 8) >> 8).astype(np.float32)
    return np.asarray(np.ldexp(mantissa, stored >> 24), "<f4")


_FILTERS = {
    "OCTAHEDRAL": ((4, 8), _octahedral),
    "QUATERNION": ((8,), _quaternion),
    "EXPONENTIAL": (range(4, 257, 4), _exponential),
}
