"""Objects of other libraries as scenes: told by what they have, so that none of them is imported.

Known are Parhelion's own scenes and shapes, paths, NumPy arrays of positions, ASE's Atoms,
MDAnalysis' Universe and AtomGroup, pyvista's data sets and blocks of them, meshio's meshes,
trimesh's meshes, paths, point clouds and scenes, anything with vertices and faces, and lists of
these. A new kind is one function that makes `parts` of it, and one line in KINDS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from os import PathLike
from typing import Any

import numpy as np

from ..errors import SceneError
from ..io import check_options, load, options_of
from ..io.frames import Frames, ParticleFrames, checked_fps
from ..io.text import Trajectory
from ..particles import OPTIONS as OF_PARTICLES
from ..particles import Particles
from ..scene import Curves, Cylinders, Disks, Instances, Mesh, Scene, Shape, Spheres
from ..studio import axis, dressed, framing
from . import atoms, surfaces
from .arrays import floats
from .parts import Own, Part, Points, scene_of_parts

_SHAPES = (Spheres, Mesh, Disks, Cylinders, Curves, Instances)
# Whose shapes stand on a ground where there is no light; particles float.
_STANDING = (Mesh,)
# Radiance up to which meshes glow for show, as in glTF, whose materials trimesh has
_GLOW = 1.0

# Lists in lists; more are a slip of the pen, such as a list that holds itself.
_DEEPEST = 32

_CHOICES = (
    "a Scene or shapes, a path, (N, 3) positions, objects of ASE, MDAnalysis, pyvista (which wraps"
    " those of VTK), trimesh or meshio, anything with vertices and faces, a list of these"
)


def scene_of(thing: Any, **options: Any) -> Scene:
    """The scene that an object is, with a view, light and a ground as files get them.

    thing: a Scene, a path, (N, 3) positions, a shape or a list of shapes of this package, or an
    object of ASE, MDAnalysis, pyvista, trimesh, meshio and the like, or a list of objects and
    shapes that are to be seen together. options: fields of LoadOptions, such as color_by, radius,
    view, ground.

    Raises SceneError for an object of none of these kinds, and for one that makes no scene.
    """
    chosen = options_of(None, options)
    if isinstance(thing, (str, PathLike)):
        return load(thing, chosen)
    if isinstance(thing, Scene):
        if not options:
            return thing
        check_options(chosen, (), "objects of type Scene")
        scene, bare = thing, False
    elif _own(thing):
        check_options(chosen, ("up",), f"objects of type {_named(thing)}")
        shapes: Sequence[Shape] = [thing] if isinstance(thing, _SHAPES) else list(thing)
        camera = framing(axis(chosen.up or "y"))
        scene, bare = Scene(shapes, camera=camera, background=None, name="shapes"), True
    else:
        found, taken = _parts(thing)
        check_options(chosen, taken, f"objects of type {_named(thing)}")
        scene, bare = scene_of_parts(found, chosen, _named(thing)), True
    return dressed(
        scene,
        view=chosen.view,
        environment=chosen.environment,
        ground=chosen.ground,
        bare=bare,
        glow=0.0 if _own(thing) else _GLOW,
        standing=_STANDING,
    )


def frames_of(
    thing: Any, frames: str | slice = ":", *, fps: float | None = None, **options: Any
) -> Frames:
    """The frames of a trajectory in memory as scenes, as load_frames() makes them of a file.

    thing: MDAnalysis' Universe or AtomGroup, a list of ASE's Atoms, or a trajectory that ASE has
    opened. frames, fps: as of load_frames(). options: fields of LoadOptions.

    Raises SceneError for an object of another kind, and as load_frames() does.
    """
    chosen = options_of(None, options)
    check_options(chosen, _POINTS, f"objects of type {_named(thing)}")
    opened: Callable[[], AbstractContextManager[Trajectory]]
    if _has("atoms", "universe")(thing):
        opened = lambda: atoms.mdanalysis_frames(thing)  # noqa: E731
    elif _ase_trajectory(thing):
        opened = lambda: nullcontext(atoms.ase_frames(thing))  # noqa: E731
    else:
        raise SceneError(
            f"an object of type {_typed(thing)} has no frames (choices: MDAnalysis' Universe and"
            " AtomGroup, a list of ASE's Atoms; of files, load_frames)"
        )
    rate = None if fps is None else checked_fps(fps)
    return ParticleFrames(opened, _named(thing), chosen, frames, rate)


def _has(*names: str) -> Callable[[Any], bool]:
    return lambda thing: all(hasattr(thing, name) for name in names)


def _named(thing: Any) -> str:
    return type(thing).__name__


def _typed(thing: Any) -> str:
    return f"{type(thing).__module__}.{type(thing).__qualname__}"


def _own(thing: Any) -> bool:
    """Whether it is a shape, or a list of shapes, of this package."""
    if isinstance(thing, (list, tuple)):
        return len(thing) > 0 and all(isinstance(one, _SHAPES) for one in thing)
    return isinstance(thing, _SHAPES)


def _parts(thing: Any, depth: int = 0) -> tuple[list[Part], Sequence[str]]:
    """What an object is made of, and the options that this reads. Raises SceneError.

    depth: how many lists it lies in.
    """
    if depth > _DEEPEST:
        raise SceneError(f"lists of objects lie more than {_DEEPEST} deep in each other")
    for known, make, taken in KINDS:
        if known(thing):
            return list(make(thing, _named(thing))), taken
    if _ase_trajectory(thing):
        raise SceneError(
            f"a {_named(thing)} of {len(thing)} Atoms is a trajectory: frames_of() makes scenes of"
            " it; a picture is of one of them"
        )
    if isinstance(thing, (list, tuple)) and thing and _of_a_kind(thing[0]):
        made = [_parts(one, depth + 1) for one in thing]
        return [part for parts, _ in made for part in parts], _BOTH
    if isinstance(thing, (np.ndarray, list, tuple)) or hasattr(thing, "__array__"):
        return [Points(Particles(floats(thing)), "positions")], _POINTS
    raise SceneError(f"an object of type {_typed(thing)} cannot be rendered (choices: {_CHOICES})")


def _of_a_kind(thing: Any) -> bool:
    return any(known(thing) for known, _, _ in KINDS)


def _ase_trajectory(thing: Any) -> bool:
    """Whether Atoms can be taken from it by number."""
    listed = hasattr(thing, "__len__") and hasattr(thing, "__getitem__")
    if not listed or isinstance(thing, (str, Mapping, np.ndarray)) or not len(thing):
        return False
    return all(map(_ATOMS, thing if isinstance(thing, (list, tuple)) else [thing[0]]))


def _of_atoms(read: Callable[[Any], Particles]) -> Callable[[Any, str], Iterable[Part]]:
    return lambda thing, _: [Points(read(thing), "atoms")]


_ATOMS = _has("get_positions", "get_chemical_symbols")
_POINTS = (*(name for name in OF_PARTICLES if name != "frame"), "up")
_FACES = ("color_by", "colormap", "color_range", "up")
_BOTH = tuple(dict.fromkeys((*_POINTS, *_FACES)))
# What an object is told by, what makes parts of it, given its name, and the options that these
# read; the first that fits counts.
KINDS: tuple[
    tuple[Callable[[Any], bool], Callable[[Any, str], Iterable[Part]], Sequence[str]], ...
] = (
    (lambda x: isinstance(x, _SHAPES), lambda x, _: [Own(x)], ("up",)),
    (_ATOMS, _of_atoms(atoms.ase_atoms), _POINTS),
    (_has("symbol", "position", "number"), _of_atoms(atoms.ase_atoms), _POINTS),
    (
        lambda x: hasattr(getattr(x, "atoms", None), "positions"),
        _of_atoms(atoms.mdanalysis_atoms),
        _POINTS,
    ),
    (_has("n_blocks", "get_block_name"), lambda x, _: surfaces.pyvista_blocks(x), _BOTH),
    (_has("points", "point_data", "n_points"), surfaces.pyvista_parts, _BOTH),
    (_has("points", "cells", "cell_data"), surfaces.meshio_parts, _FACES),
    (_has("geometry", "dump"), lambda x, _: surfaces.trimesh_scene(x), _BOTH),
    (_has("entities", "vertices"), surfaces.trimesh_path, (*_FACES, "radius")),
    (_has("vertices", "faces"), surfaces.mesh_parts, _FACES),
    (_has("as_boxes"), lambda x, name: surfaces.mesh_parts(x.as_boxes(), name), _FACES),
    (_has("vertices", "colors"), surfaces.trimesh_cloud, _POINTS),
)
