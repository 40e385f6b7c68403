"""The file: its JSON, its buffers, and errors that name the file and the object."""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import msgspec

from ...errors import FormatError, SceneError
from .. import TAKEN, LoadOptions, require_memory
from ..files import Folders, Reports
from . import schema

T = TypeVar("T")

# Extensions that are read, besides those that change nothing here
_READ = {
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_basisu",
    "KHR_texture_transform",
}
_WITHOUT_EFFECT = {"KHR_xmp", "KHR_xmp_json_ld", "FB_ngon_encoding", "MSFT_lod"}

# A document has at most this many objects: each takes some 150 bytes, however few it takes there.
_MOST_OBJECTS = 4_000_000

_LARGEST_JSON = 2**30
_MAGIC, _JSON, _BINARY = b"glTF", 0x4E4F534A, 0x004E4942


class Source:
    """A glTF file and all that it refers to.

    spend() keeps account of the memory that the file asks for: however often a document uses the
    same bytes, what is made of them stays within a multiple of what there is on disk.
    """

    def __init__(self, path: Path, options: LoadOptions) -> None:
        self.path = path
        self.folders = Folders(path.parent, options.allow_paths)
        self.reports = Reports(path, options.strict)
        self._buffers: dict[int, memoryview] = {}
        self._views: dict[int, memoryview] = {}  # that were compressed
        data = _read(path)
        self.bytes = len(data)
        self._spent = 0
        self._binary: memoryview | None = None
        text = data
        if bytes(data[:4]) == _MAGIC:
            text, self._binary = self._chunks(data)
        elif path.suffix.lower() == ".glb":
            raise self.error("does not begin with 'glTF'; it is no .glb file")
        self.document = self._parse(bytes(text))
        self._check_extensions()

    # Errors and reports

    def error(self, text: str) -> FormatError:
        """The error for the whole file; the text names the object."""
        return FormatError(f"{self.path}: {text}")

    def report(self, text: str) -> None:
        """Notes something that the file asks for and we do not do; the same text once."""
        self.reports.add(text)

    def item(self, things: Sequence[T], name: str, index: int, where: str) -> T:
        """things[index]; `name` is what the document calls the list, `where` what refers to it."""
        if index >= len(things):
            have = f"{len(things)}, from 0" if things else "none"
            raise self.error(f"{where} is {index}; the file has {have}, in {name!r}")
        return things[index]

    def extension(self, thing: Any, name: str, kind: type[T], where: str) -> T | None:
        """An object's extension of that name."""
        raw = thing.extensions.get(name)
        if raw is None:
            return None
        try:
            return msgspec.json.decode(raw, type=kind)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise self._invalid(error, f"{where}.extensions.{name}") from None

    def spend(self, size: int, where: str) -> None:
        """Takes note of bytes that will be held. Raises FormatError if they are out of measure."""
        self._spent += size
        most = 2**28 + 16 * self.bytes
        if self._spent > most:
            raise self.error(
                f"{where}: the file of {self.bytes:,} bytes asks for more than {most:,} bytes of"
                " memory, by using the same data again and again"
            )

    def forget(self) -> None:
        """Begins a new account: what was read is no longer held, as of another time's scene."""
        self._spent = 0

    # The document

    def _chunks(self, data: memoryview) -> tuple[memoryview, memoryview | None]:
        """The JSON and the binary chunk of a .glb file."""
        if len(data) < 20:
            raise self.error(f"has {len(data)} bytes; the header of a .glb file alone has 20")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.error(f"is version {version} of the .glb format; 2 is read")
        if length > len(data):
            raise self.error(f"is cut off: it has {len(data)} of the {length} bytes it speaks of")
        chunks: dict[int, memoryview] = {}
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > length:
                raise self.error(f"the chunk at byte {at} reaches beyond the end of the file")
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size + (-size % 4)
        if _JSON not in chunks:
            raise self.error("has no JSON chunk")
        return chunks[_JSON], chunks.get(_BINARY)

    def _parse(self, text: bytes) -> schema.Document:
        text = text.removeprefix(b"\xef\xbb\xbf")
        if len(text) > _LARGEST_JSON:
            raise self.error(f"its JSON is longer than {_LARGEST_JSON >> 20} MiB")
        if text.count(b"{") > _MOST_OBJECTS:
            raise self.error(f"has more than {_MOST_OBJECTS:,} objects")
        try:
            return msgspec.json.decode(text, type=schema.Document)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise self._invalid(error, "") from None

    def _invalid(self, error: Exception, start: str) -> FormatError:
        """Our text for msgspec's "Expected `int`, got `str` - at `$.meshes[0].mode`"."""
        if isinstance(error, RecursionError):
            return self.error(f"{start}: is nested too deeply" if start else "is nested too deeply")
        malformed = not isinstance(error, msgspec.ValidationError)
        # msgspec says so itself from 0.23 on.
        if isinstance(error, UnicodeDecodeError) or (malformed and "UTF-8" in str(error)):
            return self.error(f"{start}: holds text that is not UTF-8".lstrip(": "))
        what, _, place = str(error).partition(" - at `$")
        place = (start + place.rstrip("`")).lstrip(".")
        what = what.replace("`", "")
        if malformed:
            what = what if what.startswith("JSON") else f"its JSON is not complete: {what}"
        return self.error(f"{place}: {what}" if place else what)

    def _check_extensions(self) -> None:
        version = self.document.asset.min_version or self.document.asset.version
        if not version.startswith("2."):
            raise self.error(f"asset.version is {version[:20]!r}; glTF 2.0 is read")
        for name in self.document.extensions_required:
            if name not in _READ | _WITHOUT_EFFECT:
                raise self.error(f"requires the extension {name[:80]!r}, which is not supported")
        for name in self.document.extensions_used:
            if name not in _READ | _WITHOUT_EFFECT:
                self.report(f"extension {name[:80]!r}: not supported; ignored")

    # Bytes

    def view(self, index: int, where: str) -> memoryview:
        """The bytes of a buffer view."""
        view = self.item(self.document.buffer_views, "bufferViews", index, where)
        place = f"bufferViews[{index}]"
        packed = self.extension(view, "EXT_meshopt_compression", schema.Meshopt, place)
        if packed is not None:
            where = f"{place}.extensions.EXT_meshopt_compression"
            return self._unpacked(index, view, packed, where)
        return self.part(view.buffer, view.byte_offset, view.byte_length, place)

    def part(self, buffer: int, offset: int, length: int, where: str) -> memoryview:
        """Some bytes of a buffer."""
        data = self._buffer(buffer, f"{where}.buffer")
        if offset + length > len(data):
            raise self.error(
                f"{where}: bytes {offset} to {offset + length} lie beyond the end of buffer"
                f" {buffer}, which has {len(data)}"
            )
        return data[offset : offset + length]

    def _unpacked(
        self, index: int, view: schema.BufferView, packed: schema.Meshopt, where: str
    ) -> memoryview:
        """The bytes of a view that is compressed."""
        from . import meshopt

        if index not in self._views:
            data = self.part(packed.buffer, packed.byte_offset, packed.byte_length, where)
            if packed.count * packed.byte_stride != view.byte_length:
                raise self.error(
                    f"{where}: {packed.count} elements of {packed.byte_stride} bytes are not the"
                    f" {view.byte_length} of the view"
                )
            self.spend(view.byte_length, where)
            try:
                self._views[index] = memoryview(meshopt.decode(data, packed))
            except SceneError as error:
                raise self.error(f"{where}: {error}") from None
        return self._views[index]

    def _buffer(self, index: int, where: str) -> memoryview:
        if index not in self._buffers:
            buffer = self.item(self.document.buffers, "buffers", index, where)
            place = f"buffers[{index}]"
            if buffer.uri is not None:
                data = memoryview(self.resource(buffer.uri, f"{place}.uri"))
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise self.error(f"{place}: has no uri, and there is no binary chunk for it")
            if len(data) < buffer.byte_length:
                raise self.error(
                    f"{place}: byteLength is {buffer.byte_length}; there are {len(data)} bytes"
                )
            self._buffers[index] = data[: buffer.byte_length]
        return self._buffers[index]

    def resource(self, uri: str, where: str) -> bytes:
        """What a uri holds: base64 text of its own, or a file."""
        if uri.startswith("data:"):
            head, comma, text = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise self.error(f"{where}: is a data: URI without ';base64,'")
            try:
                return base64.b64decode(text, validate=True)
            except (binascii.Error, ValueError) as error:
                raise self.error(f"{where}: is no base64 text: {error}") from None
        path = self.file(uri, where)
        require_memory(path, factor=TAKEN[".glb"])
        try:
            data = path.read_bytes()
        except OSError as error:
            raise self.error(f"{where}: {uri[:80]!r} cannot be read: {error.strerror}") from None
        self.bytes += len(data)
        return data

    def file(self, uri: str, where: str) -> Path:
        """The file that a uri names, which is there and may be read."""
        scheme = uri.partition(":")[0]
        if ":" in uri and len(scheme) > 1 and scheme.isalnum():
            raise self.error(f"{where}: is a {scheme[:20]}: URI; files beside the scene are read")
        try:
            return self.folders.file(unquote(uri), where)
        except SceneError as error:
            raise self.error(str(error)) from None


def _read(path: Path) -> memoryview:
    if not path.is_file():
        raise FormatError(f"{path}: is not a regular file")
    data = path.read_bytes()
    if not data or data.isspace():
        raise FormatError(f"{path}: is empty")
    return memoryview(data)
