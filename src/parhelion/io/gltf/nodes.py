"""The tree of nodes: where everything is, and what is part of the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import animation, schema
from .source import Source

Matrices = NDArray[np.float64]

# What lights and cameras may have as coordinates
FARTHEST = 1e30


@dataclass(frozen=True, eq=False)
class Tree:
    """world: (N, 4, 4) from each node's frame to the scene. seen: nodes of the scene, in order.

    weights: of nodes whose morph targets have some of their own.
    """

    world: Matrices
    seen: list[int]
    weights: dict[int, list[float]]


def read(s: Source, time: float | None) -> Tree:
    """The tree at a time of the animations; None is the pose in which the file has it."""
    nodes = s.document.nodes
    animated = {} if time is None else animation.at_time(s, time)
    parents = np.full(len(nodes), -1, np.int64)
    for i, node in enumerate(nodes):
        for k, child in enumerate(node.children):
            s.item(nodes, "nodes", child, f"nodes[{i}].children[{k}]")
            if parents[child] >= 0 or child == i:
                other = "the node itself" if child == i else f"nodes[{parents[child]}]'s too"
                raise s.error(f"nodes[{i}].children[{k}] is {other}; nodes must form a tree")
            parents[child] = i
    world = _world(s, parents, _local(s, animated))
    weights = {i: list(node.weights) for i, node in enumerate(nodes) if node.weights}
    weights |= {i: values.tolist() for (i, path), values in animated.items() if path == "weights"}
    return Tree(world, _seen(s, parents), weights)


def _local(s: Source, animated: animation.Properties) -> Matrices:
    """(N, 4, 4): what each node does within its parent."""
    nodes = s.document.nodes
    if not nodes:
        return np.zeros((0, 4, 4))

    def table(path: str) -> NDArray[np.float64]:
        return np.array(
            [animation.chosen(animated, i, path, getattr(n, path)) for i, n in enumerate(nodes)],
            np.float64,
        )

    turns = table("rotation")
    still = ~turns.any(axis=1)
    if still.any():
        raise s.error(f"nodes[{int(np.argmax(still))}].rotation: is 0 0 0 0, which is no rotation")
    local = placed(table("translation"), turns, table("scale"))
    own = [i for i, node in enumerate(nodes) if node.matrix is not None]
    if own:
        local[own] = np.array([nodes[i].matrix for i in own]).reshape(-1, 4, 4).transpose(0, 2, 1)
        skewed = np.abs(local[own][:, 3] - (0.0, 0.0, 0.0, 1.0)).max(axis=1) > 1e-6
        if skewed.any():
            raise s.error(
                f"nodes[{own[int(np.argmax(skewed))]}].matrix: its last row is not 0 0 0 1"
            )
    return local


def placed(
    translation: NDArray[np.float64], rotation: NDArray[np.float64], scale: NDArray[np.float64]
) -> Matrices:
    """(N, 4, 4) matrices that scale, then turn by quaternions x y z w, then move."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    x, y, z, w = (rotation / np.where(length > 0.0, length, 1.0)).T
    w = np.where(length[:, 0] > 0.0, w, 1.0)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    made = np.zeros((len(scale), 4, 4))
    made[:, :3, :3] = turn * scale[:, None, :]
    made[:, :3, 3] = translation
    made[:, 3, 3] = 1.0
    return np.asarray(made)


def _world(s: Source, parents: NDArray[np.int64], local: Matrices) -> Matrices:
    """Products of the matrices along each path from a root, one level of the tree at a time."""
    world: Matrices = local.copy()
    children: list[list[int]] = [node.children for node in s.document.nodes]
    level = np.flatnonzero(parents < 0).tolist()
    reached = len(level)
    while level:
        level = [child for i in level for child in children[i]]
        if level:
            world[level] = world[parents[level]] @ local[level]
            reached += len(level)
    if reached < len(local):
        hanging = _below(s, np.flatnonzero(parents < 0).tolist())
        lost = next(i for i in range(len(local)) if i not in hanging)
        raise s.error(f"nodes[{lost}]: is its own ancestor; nodes must form a tree")
    bad = ~(np.abs(world) <= FARTHEST).all(axis=(1, 2))
    if bad.any():
        lost = int(np.argmax(bad))
        raise s.error(
            f"nodes[{lost}]: its place in the scene is not finite, or beyond {FARTHEST:g}"
        )
    return world


def _below(s: Source, roots: list[int]) -> dict[int, None]:
    """These nodes and all that hang from them, each once, in the order of the file."""
    found: dict[int, None] = {}
    stack = roots[::-1]
    while stack:
        i = stack.pop()
        if i not in found:
            found[i] = None
            stack.extend(s.document.nodes[i].children[::-1])
    return found


def _seen(s: Source, parents: NDArray[np.int64]) -> list[int]:
    """The nodes of the scene that the file shows: the default one, else the first, else all."""
    document = s.document
    if document.scenes:
        chosen = document.scene or 0
        scene = s.item(document.scenes, "scenes", chosen, "scene")
        roots = scene.nodes
        for k, i in enumerate(roots):
            s.item(document.nodes, "nodes", i, f"scenes[{chosen}].nodes[{k}]")
    else:
        roots = np.flatnonzero(parents < 0).tolist()
    hidden = [
        i
        for i, node in enumerate(document.nodes)
        if "KHR_node_visibility" in node.extensions and not _visible(s, i, node)
    ]
    gone = _below(s, hidden)
    return [i for i in _below(s, roots) if i not in gone]


def _visible(s: Source, index: int, node: schema.Node) -> bool:
    found = s.extension(node, "KHR_node_visibility", schema.Visibility, f"nodes[{index}]")
    return found is None or found.visible
