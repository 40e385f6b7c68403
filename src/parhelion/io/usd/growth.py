"""How many prims the references, payloads and inherits of layers make, before the library composes.

Ten prims that each refer four times to the next stand for a million, and the library's time grows
with the third power of a chain of them; it can neither be asked beforehand nor stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pxr import Sdf

from ...errors import FormatError

# Prims that a stage may have, those that are instances counted once
MOST = 1 << 21
# Arcs, one behind the other
LONGEST = 250

# A layer's identifier, and the path of a prim in it
_Node = tuple[str, str]


def refuse(layers: Sequence[Any], where: str) -> None:
    """Raises FormatError if the first of these layers, composed, has too many prims."""
    known = {layer.identifier: layer for layer in layers}
    root = (layers[0].identifier, "/")
    prims: dict[_Node, int] = {}  # of what is below, and behind arcs from there
    chain: dict[_Node, int] = {}  # arcs behind each other from there
    once: set[_Node] = set()
    todo = [root]
    inner: dict[_Node, tuple[int, list[tuple[_Node, bool]]]] = {}
    while todo:
        node = todo[-1]
        if node not in inner:
            inner[node] = _inside(known, *node)
            # what is on its way already is a circle, which the library tells of
            todo += [n for n, _ in inner[node][1] if n not in inner]
            continue
        todo.pop()
        if node in prims:
            continue
        count, arcs = inner[node]
        for target, instance in arcs:
            if not (instance and target in once):
                count += prims.get(target, 0)
            if instance:
                once.add(target)
        prims[node] = count
        chain[node] = 1 + max((chain.get(target, 0) for target, _ in arcs), default=0)
        if count > MOST:
            raise FormatError(
                f"{where}: {node[1]} stands for more than {MOST} prims by what it refers to"
            )
        if chain[node] > LONGEST:
            raise FormatError(
                f"{where}: {node[1]} refers to a prim that refers to another, more than {LONGEST}"
                " times"
            )


def _inside(known: dict[str, Any], layer: str, path: str) -> tuple[int, list[tuple[_Node, bool]]]:
    """The number of prims at and below a path of a layer, and where arcs from there lead."""
    source: Any = known.get(layer)
    prim = source.GetPrimAtPath(path) if source is not None else None
    if prim is None:
        return 0, []
    count, arcs = 0, []
    if path == "/":
        for name in source.subLayerPaths:
            arcs.append(((source.ComputeAbsolutePath(name), "/"), False))
    below = [prim]
    while below:
        at = below.pop()
        count += 1
        below += at.nameChildren
        arcs += [(target, bool(at.instanceable)) for target in _arcs(known, source, at)]
    return count, arcs


def _arcs(known: dict[str, Any], source: Any, prim: Any) -> Iterator[_Node]:
    """What a prim's references, payloads, inherits and specializes name."""
    for items in (prim.referenceList, prim.payloadList):
        for arc in items.GetAddedOrExplicitItems():
            name = source.ComputeAbsolutePath(arc.assetPath) if arc.assetPath else source.identifier
            target = known.get(Sdf.Layer.SplitIdentifier(name)[0])
            if target is not None:
                path = str(arc.primPath) or f"/{target.defaultPrim.lstrip('/')}"
                yield target.identifier, path
    for items in (prim.inheritPathList, prim.specializesList):
        for path in items.GetAddedOrExplicitItems():
            yield source.identifier, str(path)
