"""Opening a stage: its layers, where they lie, and what the library says of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Ar, Pcp, Sdf, Tf, Usd, UsdUtils

from ...errors import FormatError, SceneError, unknown_name
from .. import LoadOptions
from ..files import Folders, Reports
from . import crate, growth

# Files that a stage may be made of
_MOST_LAYERS = 100_000
# Prims in prims; the library walks over them by recursion, and far deeper it ends the process
_DEEPEST = 2000
# How files with USD's own suffixes begin
_KINDS = (b"#usda", b"PXR-USDC", b"PK")


def opened(path: Path, options: LoadOptions, folders: Folders, reports: Reports) -> Any:
    """The stage; to be called within guarded()."""
    layers = _layers(path, folders, reports)
    growth.refuse(layers, str(path))
    stage = Usd.Stage.Open(layers[0])
    if options.variant is not None:
        _select(stage, options.variant)
    for error in stage.GetCompositionErrors():
        if isinstance(error, (Pcp.ErrorArcCycle, Pcp.ErrorSublayerCycle)):
            raise FormatError(f"{path}: {_sentence(str(error), path)}")
        # a file that is missing has been noted
        if not isinstance(error, (Pcp.ErrorInvalidAssetPath, Pcp.ErrorInvalidSublayerPath)):
            reports.add(_sentence(str(error), path))
    for layer in stage.GetUsedLayers():  # names may depend on what has been composed
        _check(layer.realPath, folders, _place(path, layer))
    return stage


@contextmanager
def guarded(path: Path) -> Iterator[None]:
    """In the block, the library's errors are FormatErrors that begin with the path, and its
    warnings are not printed.
    """
    quiet = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    except Tf.ErrorException as error:
        raise FormatError(f"{path}: cannot be read as USD: {_reason(error, path)}") from None
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: holds a name or a text that is not UTF-8: {error}") from None
    except FormatError:
        raise
    except SceneError as error:
        text = str(error)
        raise FormatError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    finally:
        quiet.TakeUncoalescedDiagnostics()


def _select(stage: Any, wanted: str) -> None:
    """Chooses variants, "set=name" and more after commas, on every prim that has the set.

    They are chosen in turn, since one may bring in another. Raises SceneError.
    """
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for choice in wanted.split(","):
            name, _, variant = (part.strip() for part in choice.partition("="))
            sets = [
                prim.GetVariantSet(own)
                for prim in stage.TraverseAll()
                for own in prim.GetVariantSets().GetNames()
            ]
            known = {f"{s.GetName()}={v}" for s in sets for v in s.GetVariantNames()}
            if f"{name}={variant}" not in known:
                raise SceneError(unknown_name("variant", choice.strip(), known))
            for own in sets:
                if own.GetName() == name and variant in own.GetVariantNames():
                    own.SetVariantSelection(variant)


def _layers(path: Path, folders: Folders, reports: Reports) -> list[Any]:
    """The layer of a file, and all that it is made of; none is opened that may not be.

    Composition would open them without asking.
    """
    _refuse_foreign(path, str(path))
    _refuse_deep_text(path, str(path))
    crate.check(path, str(path))
    root = Sdf.Layer.FindOrOpen(str(path.resolve()))
    if root is None:
        raise FormatError(f"{path}: cannot be read as USD")
    found, seen = [root], {root.identifier}
    for layer in found:
        place = _place(path, layer)
        _refuse_broken(layer, place)
        users: dict[str, str] | None = None
        for name in layer.GetCompositionAssetDependencies():
            asset = layer.ComputeAbsolutePath(name)
            asset, _ = Sdf.Layer.SplitIdentifier(asset)
            if not asset or asset in seen:
                continue
            seen.add(asset)
            where = f"{place}: {name!r}"
            resolved = Ar.GetResolver().Resolve(asset).GetPathString()
            # one that is nowhere keeps its name, which counts from its layer's folder
            _check(resolved or str(Path(layer.realPath).parent / asset), folders, where)
            if not resolved:
                users = _users(layer) if users is None else users
                who = users.get(name, "sublayer" if name in layer.subLayerPaths else "")
                reports.add(f"{who} {name!r}: no such file; left out".lstrip())
                continue
            if len(found) == _MOST_LAYERS:
                raise FormatError(f"{path}: is made of more than {_MOST_LAYERS} files")
            _refuse_foreign(Path(resolved), where)
            _refuse_deep_text(Path(resolved), where)
            if Path(resolved).is_file():
                crate.check(Path(resolved), where)
            try:
                inner = Sdf.Layer.FindOrOpen(asset)
            except Tf.ErrorException as error:
                raise FormatError(f"{where}: {_reason(error, Path(resolved))}") from None
            if inner is not None:
                found.append(inner)
    return found


def _place(path: Path, layer: Any) -> str:
    """The beginning of an error's text about a layer of the stage at a path."""
    own = Path(layer.realPath) == path.resolve()
    return str(path) if own else f"{path}: {Path(layer.identifier).name}"


def _users(layer: Any) -> dict[str, str]:
    """By the file that a reference or a payload names, the first prim of the layer that has it."""
    found: dict[str, str] = {}

    def look(at: Any) -> None:
        if not (at.IsPrimPath() or at.IsPrimVariantSelectionPath()):
            return
        prim: Any = layer.GetPrimAtPath(at)
        if prim is None:  # of a damaged file: listed, but not there
            return
        for items in (prim.referenceList, prim.payloadList):
            for arc in items.GetAddedOrExplicitItems():
                found.setdefault(str(arc.assetPath), f"{at}:")

    layer.Traverse(Sdf.Path.absoluteRootPath, look)
    return found


def _refuse_foreign(file: Path, where: str) -> None:
    """Raises FormatError for a file that has a name of USD's, and something else in it."""
    if not file.suffix.lower().startswith(".usd") or not file.is_file():
        return
    with file.open("rb") as stream:
        start = stream.read(8)
    if not start:
        raise FormatError(f"{where}: cannot be read as USD: it is empty")
    if not start.startswith(_KINDS):
        raise FormatError(
            f"{where}: cannot be read as USD: it begins neither as text (#usda), nor as a crate"
            " (PXR-USDC), nor as a package (zip)"
        )


def _refuse_deep_text(file: Path, where: str) -> None:
    """Raises FormatError for a text with brackets in brackets without end."""
    if not file.is_file():  # in an archive, where there are few texts
        return
    with file.open("rb") as stream:
        if stream.read(5) != b"#usda":
            return
        text = np.frombuffer(stream.read(), np.uint8)
    # the parser takes seconds and gigabytes for what it then refuses
    for pair, what in (("{}", "prims"), ("()", "tuples"), ("[]", "lists")):
        begin, end = (text == ord(c) for c in pair)
        open_ = np.cumsum(begin.astype(np.int8) - end, dtype=np.int32)
        if (open_ - np.minimum.accumulate(open_)).max(initial=0) > _DEEPEST:
            raise FormatError(f"{where}: has {what} in {what}, more than {_DEEPEST} deep")


def _refuse_broken(layer: Any, where: str) -> None:
    """Raises FormatError for prims in prims without end, or that are named but not there.

    A .usdc file lists children apart from the prims, variant sets and variants themselves; the
    library ends the process when it follows a list to one that is missing or of another kind.
    """
    level = [layer.pseudoRoot]
    for _ in range(_DEEPEST):
        below = []
        for prim in level:
            below += _there(prim.nameChildren, "child", prim, where)
            for own in _there(prim.variantSets, "variant set", prim, where):
                variants = _there(own.variants, "variant", prim, where)
                below += [variant.primSpec for variant in variants]
        level = below
        if not level:
            return
    raise FormatError(f"{where}: has prims in prims, more than {_DEEPEST} deep")


def _there(listed: Any, kind: str, prim: Any, where: str) -> list[Any]:
    """The specs of a list; the library's views give None for one that is missing."""
    found = list(listed)
    if not all(found):
        number = [bool(spec) for spec in found].index(False)
        raise FormatError(f"{where}: {prim.path}: its {kind} {number} is listed, but is not there")
    return found


def _check(asset: str, folders: Folders, where: str) -> None:
    """Raises SceneError for a file that lies elsewhere; of an archive's, the archive counts."""
    outer = Ar.SplitPackageRelativePathOuter(asset)[0]
    if not outer:  # in memory
        return
    try:
        allowed = folders.allows(Path(outer).resolve())
    except (OSError, RuntimeError, ValueError):  # too long, a loop of links, a NUL
        allowed = False
    if not allowed:
        raise folders.outside(asset, where)


def _reason(error: Any, path: Path) -> str:
    """What the library says, without its places in its own source."""
    try:
        said = "; ".join(part.commentary for part in error.args if hasattr(part, "commentary"))
    except UnicodeDecodeError:  # it quotes what it could not read
        said = "it holds bytes that are no text"
    return _sentence(said.replace(f"<{path.resolve()}>", "it"), path)


def _sentence(text: str, path: Path) -> str:
    """On one line, files by their names from the stage's folder, without layers in memory."""
    text = re.sub(",?@anon:[^@]*@", "", text.replace(f"{path.resolve().parent}/", ""))
    line = " ".join(text.split())
    return line if len(line) <= 300 else line[:297] + "..."
