"""Pictures made again from what they say of themselves."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments, machine
from .denoise import without_guides
from .display import told_display
from .errors import FormatError, ParhelionError, SceneError
from .image import COMPRESSIONS, COUNTS, HIDDEN, Image, unpacked_counts
from .io.sources import scene_at, tuples
from .layers import PictureFile
from .progress import Progress
from .renderer import build, prepare, render
from .scene import Camera, Scene, Settings, Source

if TYPE_CHECKING:
    from .progress import ProgressCallback

log = logging.getLogger("parhelion")


@dataclass(frozen=True)
class Record:
    """How a picture file says that it was made. counts: samples of each pixel, (H, W), or of all.
    hidden: objects that were not to be seen, names by indices. save: arguments of Image.save() that
    make such a file again.
    """

    path: Path
    settings: Settings
    camera: Camera
    counts: Any
    scene_hash: str
    build: str
    source: Source | None
    hidden: Mapping[int, str]
    features: bool
    denoised: bool
    save: Mapping[str, Any]

    def for_file(self, path: str | os.PathLike[str]) -> dict[str, Any]:
        """Arguments of Image.save() for a file with that name: all, if its kind is the same."""
        same = Path(path).suffix.lower() == self.path.suffix.lower()
        return {
            k: v for k, v in self.save.items() if same or k not in ("bits", "legend", "compression")
        }

    def scene(self) -> Scene:
        """The scene, from where it came from. Raises FormatError where that is not told."""
        if self.source is None:
            raise FormatError(
                f"{self.path}: does not say where its scene is, which was made in Python; give the"
                " scene"
            )
        try:
            return scene_at(self.source)
        except ParhelionError:
            raise
        except (TypeError, ValueError) as error:
            raise FormatError(f"{self.path}: tells of options that there are not") from error


def record(path: str | os.PathLike[str]) -> Record:
    """What a picture file tells. Raises FormatError for one that is none or tells too little."""
    file = PictureFile(arguments.path("path", path))
    told = {key: str(value) for key, value in file.metadata.items()}
    try:
        if "parhelion:settings" not in told:  # JPEG has a description alone
            told = json.loads(told["ImageDescription"])
        settings = Settings(**tuples(json.loads(told["parhelion:settings"])))
        camera = Camera(**tuples(json.loads(told["parhelion:camera"])))
        width, height = settings.size
        counts: Any = int(told["parhelion:samples"]) // (width * height)
        if COUNTS in told:
            if not told[COUNTS]:
                raise FormatError(
                    f"{file.path}: does not say how many samples each pixel has; .exr and .png"
                    " files do"
                )
            counts = unpacked_counts(told[COUNTS], height, width)
        source = json.loads(told.get("parhelion:source", "null"))
        hidden = told.get(HIDDEN, "{}")
        main = file.layer()
        exr = file.path.lower().endswith(".exr")
        compression = told.get("compression", "").partition(":")[0]
        laid_out = {"compression": compression} if exr and compression in COMPRESSIONS else {}
        bits = {"half": 16, "float": 32, "uint16": 16, "uint8": 8}[main.kinds[0]]
        return Record(
            path=Path(path),
            settings=settings,
            camera=camera,
            counts=counts,
            scene_hash=told["parhelion:scene"],
            build=told["parhelion:build"],
            source=None if source is None else Source(**source),
            hidden={int(i): str(name) for i, name in tuples(json.loads(hidden)).items()},
            features="shape" in file.layers,
            denoised="parhelion:denoised" in told,
            save={
                "bits": bits,
                "legend": "parhelion:legend" in told,
                **told_display(told),
                **laid_out,
            },
        )
    except FormatError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{file.path}: does not tell how it was made, as pictures by Parhelion do"
        ) from error


def rerender(
    path: str | os.PathLike[str],
    scene: Scene | Any = None,
    *,
    threads: int = 0,
    progress: ProgressCallback | bool | None = None,
) -> Image:
    """Makes a picture again: the same pixels, to the last bit.

    scene: in the place of what the file says. Raises FormatError for a file that does not tell how
    it was made, and SceneError for a scene that is not, or no longer, the one it was made of.
    """
    made = record(path)
    return remade(made, scene, threads=threads, progress=progress)


def remade(
    made: Record,
    scene: Scene | Any = None,
    *,
    threads: int = 0,
    progress: ProgressCallback | bool | None = None,
) -> Image:
    """As rerender(), of what a file was read to tell."""
    from . import _core

    prepared = prepare(made.scene() if scene is None else scene, threads=threads)
    if made.hidden:
        flat = prepared.flat.without(made.hidden)
        with machine.threads(threads):
            prepared = replace(prepared, flat=flat, core=build(flat))
    if prepared.flat.sha256() != made.scene_hash:
        raise SceneError(
            f"{made.path}: was made of another scene than"
            f" {prepared.scene.name!r}, or that has changed since"
        )
    if made.build != _core.sources:
        log.warning("%s: was made by another build of Parhelion; bits may differ", made.path)
    width, height = made.settings.size
    image = render(
        prepared,
        camera=made.camera,
        threads=threads,
        progress=progress,
        features=made.features or made.denoised,
        counts=np.broadcast_to(np.asarray(made.counts, np.uint32), (height, width)),
        **vars(made.settings),
    )
    if made.denoised and image.stats.complete:
        told = callable(progress) and (lambda _: progress(_whole(image)))
        image = image.denoised(progress=told or None)
    if not made.features:
        image = replace(image, features=without_guides(image.features))
    return image


def _whole(image: Image) -> Progress:
    """The progress of a picture that is rendered."""
    stats = image.stats
    return Progress(stats.samples, stats.samples, stats.rays, stats.seconds, stats.error)
