"""The registry of scene formats: one module a format, one line here.

A format module has these names:

    NAME        what users call the format, e.g. "XYZ"
    OPTIONS     the fields of LoadOptions that it reads, besides EVERY_FORMAT's
    BARE        True if its files often lack a camera and lights, which are then added
    PACKED      False if it does not read files that are packed, as NAME.gz (none: it does)
    PARTS       True if it calls require_memory() itself, for what it reads at once (none: False)
    TIME_CODES  True if `frame` need not be a whole number (none: False)
    GROUND      kinds of shapes, such as scene.Mesh, that a ground is put below where light is added
                (none: ())
    GLOW        radiance up to which emission in its files is for show, and no light (none: 0)
    load(path: pathlib.Path, options: LoadOptions) -> Scene
    trajectory(path: pathlib.Path, options: LoadOptions) -> context manager of a text.Trajectory,
                of particles, if its files have frames
    timeline(path: pathlib.Path, options: LoadOptions) -> Timeline, if its files have a scene at
                every time instead
    contents(path: pathlib.Path, options: LoadOptions) -> Mapping[str, Any] of what there is in the
                file to choose from, for `parhelion info`, which prints numbers, text, and lists
                and mappings of these, with underscores in names as spaces, if it has any

and raises FormatError, its text beginning with the path, for a file that it cannot read. Modules
are imported only when a file of theirs is loaded.

Other packages add such modules by an entry point of the group "parhelion.formats" for each ending:

    [project.entry-points."parhelion.formats"]
    ".vox" = "voxels.parhelion_format"
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any

from .. import arguments, memory
from ..errors import FormatError, ResourceError, SceneError, option, unknown_name
from ..scene import Scene, Source

# suffix -> module; the one list that a new format is added to
FORMATS: dict[str, str] = {
    ".json": "json_scene",
    ".xyz": "xyz",
    ".extxyz": "xyz",
    ".dump": "lammps",
    ".lammpstrj": "lammps",
    ".npz": "npz",
    ".gsd": "gsd_file",
    ".pdb": "chemfiles_file",
    ".gro": "chemfiles_file",
    ".xml": "mitsuba",
    ".gltf": "gltf",
    ".glb": "gltf",
    ".ply": "mesh_file",
    ".stl": "mesh_file",
    ".off": "mesh_file",
    ".obj": "obj",
    ".pbrt": "pbrt",
    ".usd": "usd",
    ".usda": "usd",
    ".usdc": "usd",
    ".usdz": "usd",
}

# where other packages list theirs
ENTRY_POINTS = "parhelion.formats"

# endings that may follow those of FORMATS
COMPRESSED = (".gz", ".bz2", ".xz")

# Bytes that reading takes at its peak for each byte of a file, unpacked; of those with frames, of
# a frame. What `python -m bench.reading` measures of files that take much, and some more; 1 where
# nothing is known. Stages of USD are packed inside by as much as there is order in them: their
# factors are those of stages without.
TAKEN = {
    ".json": 11.0,
    ".npz": 5.0,
    ".gro": 11.5,
    ".pdb": 8.5,
    ".gltf": 4.0,
    ".glb": 4.0,
    ".ply": 6.0,
    ".stl": 5.5,
    ".off": 9.0,
    ".obj": 4.0,
    ".pbrt": 5.0,
    ".usd": 24.0,
    ".usda": 24.0,
    ".usdc": 22.0,
}
# The same for each row of a table of particles, and for each number or name in it
ROW_TAKES, COLUMN_TAKES = 40, 16
# Bytes of a file that is read without a look at the memory
_SMALL = 1 << 20
# More than that a .gz file does not unpack to, whatever its end says
_BEST_PACKED = 250


# What is done with any scene, and permissions that a format may have no occasion for; an option
# that is none of these and that a format does not read is an error.
EVERY_FORMAT = ("strict", "allow_paths", "view", "environment", "ground")


@dataclass(frozen=True)
class LoadOptions:
    """What the user asked of a loader; each one reads what it has a use for.

    color_by: a per-particle field to colour by. colormap: a Matplotlib colour map's name.
    color_range: field values at the two ends of the map; None for their 1st and 99th percentile.
    radius: one radius for all particles, "vdw" or "covalent"; None for the loader's choice. frame:
    of a trajectory, from 0; negative counts from the end; of USD, the time code.
    style: of particles, "spheres", "ball-and-stick" or "licorice". bond_length: particles nearer to
    each other are bonded; None for the file's bonds, or by covalent radii. box: the simulation box
    is drawn. wrap: particles are moved into it where it is periodic. assembly: the number of a PDB
    file's biological assembly; None for the atoms that are in the file.
    defines: values of a scene's own parameters by name (Mitsuba's `-D name=value`). strict: what a
    scene asks for and is not supported is an error, not a warning. allow_paths: folders, besides
    the scene file's own, that its files may lie in.
    up: "x", "y" or "z", "-z" and so on: the axis that is up in a file that does not say; None for
    what is usual in its format. view: where the camera stands instead of where the scene says: a
    name in studio.VIEWS. environment: a panorama's file, instead of the scene's background. ground:
    whether there is one below all, for shadows to fall on; None for one below meshes and scenes
    that bring no light, where the camera is not below it.
    time: seconds of a scene's animations; None for the pose that it is stored in. variant: the name
    of one of a scene's sets of materials, of USD "set=name" and more such after commas; None for
    those that it begins with. camera: the name of one in the file, of USD its path too; None for
    the one that the file says, else the first.
    """

    color_by: str | None = None
    colormap: str = "viridis"
    color_range: tuple[float, float] | None = None
    radius: float | str | None = None
    ground: bool | None = None
    frame: float = 0
    style: str = "spheres"
    bond_length: float | None = None
    box: bool = False
    wrap: bool = False
    assembly: int | None = None
    defines: Mapping[str, str] = field(default_factory=dict)
    strict: bool = False
    allow_paths: tuple[str, ...] = ()
    view: str | None = None
    environment: str | None = None
    up: str | None = None
    time: float | None = None
    variant: str | None = None
    camera: str | None = None

    def __post_init__(self) -> None:
        """Refuses what would be taken for something else."""
        for given in fields(self):
            value = getattr(self, given.name)
            if value is not None or _default(given) is not None:
                _CHECKS[given.name](given.name, value)


def _finite(name: str, value: Any) -> None:
    if not isfinite(arguments.number(name, value)):
        raise SceneError(f"{option(name)} is {value!r}; must be a number")


def _paths(name: str, value: Any) -> None:
    if isinstance(value, (str, os.PathLike)):
        raise SceneError(f"{name} is one path; must be a sequence of paths")
    if not isinstance(value, Sequence):
        raise SceneError(f"{name} is {value!r}; must be a sequence of paths")
    for i, folder in enumerate(value):
        arguments.path(f"{name}[{i}]", folder)


def _dict(name: str, value: Any) -> None:
    if not isinstance(value, Mapping):
        raise SceneError(f"{name} is {value!r}; must be a dict")


# What an option must be, where None is not what it is left as
_CHECKS: Mapping[str, Callable[[str, Any], object]] = {
    **dict.fromkeys(
        ("color_by", "colormap", "style", "view", "up", "variant", "camera"), arguments.text
    ),
    **dict.fromkeys(("ground", "box", "wrap", "strict"), arguments.flag),
    **dict.fromkeys(("frame", "time"), _finite),
    "color_range": arguments.pair,
    "radius": lambda name, value: isinstance(value, str) or arguments.number(name, value),
    "bond_length": arguments.number,
    "assembly": lambda name, value: arguments.whole(name, value, -_MOST, _MOST),
    "environment": arguments.path,
    "defines": _dict,
    "allow_paths": _paths,
}
_MOST = 2**31


@dataclass(frozen=True)
class Timeline:
    """The times of a file: what reads the scene at one, and which ones a film of it has.

    option: the field of LoadOptions that is a time. unit: what it is in, for messages. per_second:
    how many units pass in a second. step: units from one picture to the next; None for as many
    pictures a second as are asked for. ends: the first and the last time; None if the file does
    not say.
    """

    option: str
    unit: str
    per_second: float
    step: float | None
    ends: tuple[float, float] | None
    read: Callable[[float], Scene]


def load(
    path: str | os.PathLike[str],
    options: LoadOptions | None = None,
    *,
    studio: bool = True,
    **more: Any,
) -> Scene:
    """Reads a scene or a particle file; which format is told by the ending of its name.

    studio: what lacks a view and light, and is of a format whose files often do, gets some. more:
    fields of LoadOptions, such as color_by or time, beside or in the place of options.

    Raises FormatError for a file that is missing, broken or of no known format, and ResourceError,
    before it is read, for one that would take more memory than is free.
    """
    file, module, options = resolved(path, options_of(options, more) if more else options)
    scene = read(module, file, options)
    from ..studio import dressed

    return dressed(
        scene.replace(source=source_of(file, options)),
        view=options.view,
        environment=options.environment,
        ground=options.ground,
        bare=studio and getattr(module, "BARE", False),
        glow=getattr(module, "GLOW", 0.0),
        standing=getattr(module, "GROUND", ()),
    )


def contents(
    path: str | os.PathLike[str], options: LoadOptions | None = None
) -> Mapping[str, Any] | None:
    """What there is in a file to choose from, by what docs/reference.md calls it; None of formats
    that show all they have in the scene.

    Raises FormatError for a file that is missing or broken.
    """
    file, module, options = resolved(path, options)
    if not hasattr(module, "contents"):
        return None
    with reading(file):
        found: Mapping[str, Any] = module.contents(file, options)
    return found


def options_of(options: LoadOptions | None, more: Mapping[str, Any]) -> LoadOptions:
    """Options with some that are given by name. Raises SceneError for a name that there is not."""
    known = [given.name for given in fields(LoadOptions)]
    for name in more:
        if name not in known:
            raise SceneError(unknown_name("option", name, known))
    options = LoadOptions() if options is None else options
    return replace(arguments.instance("options", options, LoadOptions), **more)


def source_of(file: Path, options: LoadOptions) -> Source:
    """What a scene of a file tells of where it came from; paths that do not depend on the folder
    that the process is in.
    """
    values = ((f, getattr(options, f.name)) for f in fields(options))
    given = {f.name: value for f, value in values if value != _default(f)}
    if options.environment is not None:
        given["environment"] = os.path.abspath(options.environment)
    if options.allow_paths:
        given["allow_paths"] = tuple(map(os.path.abspath, options.allow_paths))
    return Source(os.path.abspath(file), given)


def resolved(
    path: str | os.PathLike[str], options: LoadOptions | None = None
) -> tuple[Path, Any, LoadOptions]:
    """A file that is there, the module that reads it, and options that are for it.

    Raises FormatError.
    """
    file = arguments.path("path", path)
    options = LoadOptions() if options is None else options
    arguments.instance("options", options, LoadOptions)
    try:
        exists = file.exists()
    except OSError as error:  # too long a name, a folder that may not be looked into
        raise FormatError(f"{file}: cannot be read: {error.strerror or error}") from error
    if not exists:
        near = [p.name for p in file.parent.glob("*")] if file.parent.is_dir() else []
        hint = unknown_name("file", file.name, near[:200]).partition(";")[2].partition("(")[0]
        raise FormatError(f"{file}: no such file{';' + hint.rstrip() if 'mean' in hint else ''}")
    if file.is_dir():
        raise FormatError(f"{file}: is a folder, not a scene file")
    if not file.is_file():  # a device or a pipe, which may never end
        raise FormatError(f"{file}: is not a regular file")
    suffixes = [s.lower() for s in file.suffixes]
    packed = bool(suffixes) and suffixes[-1] in COMPRESSED
    if packed:
        suffixes.pop()
    ending = suffixes[-1] if suffixes else ""
    module = _module(ending, file)
    if packed and not getattr(module, "PACKED", True):
        raise FormatError(f"{file}: {module.NAME} files are not read packed; unpack it first")
    try:
        check_options(options, module.OPTIONS, f"{module.NAME} files")
        if options.frame != int(options.frame) and not getattr(module, "TIME_CODES", False):
            raise SceneError(
                f"{option('frame')} is {options.frame}; {module.NAME} files have whole ones"
            )
    except SceneError as error:
        raise FormatError(f"{file}: {error}") from None
    return file, module, options


def check_options(options: LoadOptions, known: Sequence[str] | None, what: str) -> None:
    """Raises SceneError for an option that was given and is neither known nor EVERY_FORMAT's. None:
    no option is.
    """
    known = () if known is None else (*known, *EVERY_FORMAT)
    for given in fields(LoadOptions):
        if given.name not in known and getattr(options, given.name) != _default(given):
            choices = f" (choices: {', '.join(map(option, known))})" if known else ""
            raise SceneError(f"the option {option(given.name)!r} is not for {what}{choices}")


def read(module: Any, file: Path, options: LoadOptions) -> Scene:
    """The scene as it is in the file. Raises FormatError."""
    if not getattr(module, "PARTS", False):
        require_memory(file)
    with reading(file):
        scene = module.load(file, options)
    assert isinstance(scene, Scene)
    if not scene.shapes and scene.background is None:
        logging.getLogger("parhelion").warning("%s: holds nothing that can be seen", file)
    return scene


@contextmanager
def reading(file: Path) -> Iterator[None]:
    """Turns what the system refuses while a file is read into a FormatError about it."""
    try:
        yield
    except ResourceError:
        raise
    except (OSError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise FormatError(f"{file}: cannot be read: {reason}") from error
    except FormatError:
        raise
    except SceneError as error:  # what the file holds does not go with the options
        raise FormatError(f"{file}: {error}") from None
    except RecursionError:
        raise FormatError(f"{file}: is nested too deeply") from None


def require_memory(file: Path, size: int | None = None, factor: float | None = None) -> None:
    """Raises ResourceError for a file that takes more memory to read than there is.

    size: bytes of it that are read at once; None for all, unpacked where that is cheap to know.
    factor: how many times that reading takes; None for what its ending says.
    """
    endings = [s.lower() for s in file.suffixes]
    packed = endings.pop() if endings and endings[-1] in COMPRESSED else ""
    if size is None:
        size = file.stat().st_size
        if packed == ".gz" and size > 4:
            with file.open("rb") as stream:
                stream.seek(-4, os.SEEK_END)  # bytes of the last member, modulo 2^32 (RFC 1952)
                told = int.from_bytes(stream.read(4), "little")
            size = max(size, min(told, _BEST_PACKED * size))
    if factor is None:
        factor = TAKEN.get(endings[-1] if endings else "", 1.0)
    if size > _SMALL:
        memory.require(int(factor * size), f"reading {file.name}", "a part of it takes less")


def _module(ending: str, file: Path) -> Any:
    """The module that reads files of that ending: ours, else that of an installed package."""
    if ending in FORMATS:
        return import_module(f".{FORMATS[ending]}", __name__)
    from importlib.metadata import entry_points

    others = {e.name.lower(): e for e in entry_points(group=ENTRY_POINTS)}
    if ending not in others:
        raise FormatError(f"{file}: {unknown_name('file ending', ending, [*FORMATS, *others])}")
    try:
        module = others[ending].load()
    except Exception as error:
        raise FormatError(
            f"{file}: the reader {others[ending].value!r} cannot be imported: {error}"
        ) from error
    missing = [n for n in ("NAME", "OPTIONS", "load") if not hasattr(module, n)]
    if missing:
        raise FormatError(f"{file}: the reader {others[ending].value!r} has no {missing[0]}")
    return module


def _default(given: Field[Any]) -> Any:
    made = given.default_factory
    return given.default if made is MISSING else made()
