"""Files with one thing wrong each: one clear error that names file, object and element, soon.

Each begins as a good file of fuzz.seeds, of which one text is replaced. What the tests of a reader
have is not repeated here: nodes in circles, say, are in test_gltf.py.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import lzma
import re
import struct
import time
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from fuzz.harness import Case
from fuzz.seeds import READERS
from parhelion.errors import plain
from parhelion.image import reason_of

# Bytes of arrays and texts that refusing a file may take, and seconds: with room for a machine that
# does something else meanwhile
MOST = 256 << 20
SECONDS = 10.0

DEEP = 20_000
MANY = 4_000_000_000
ONE = struct.pack("<3f", 1, 0, 0)
NAN = struct.pack("<3f", 1, 0, float("nan"))


def seed(reader: str, number: int = 0) -> Case:
    """A good case; skips where the library that makes it is missing."""
    cases = READERS[reader][1]()
    if not cases:
        pytest.skip(f"what {reader} files need is not installed")
    return cases[number]


def changed(reader: str, number: int, name: str, old: bytes, new: bytes) -> Case:
    """A good case of which one text is replaced, wherever it stands in a file."""
    case = seed(reader, number)
    assert old in case.files[name]
    return replace(case, files=case.files | {name: case.files[name].replace(old, new)})


def alone(name: str, data: bytes) -> Case:
    return Case(name, {name: data})


def json_scene(**fields: object) -> Case:
    return alone("a.json", json.dumps({"parhelion": 1, **fields}).encode())


def refused(case: Case, folder: Path, words: str) -> None:
    """Loads a case, which has to be refused in these words and soon."""
    path = case.write(folder / "case")
    start = time.process_time()
    with pytest.raises(ph.ParhelionError, match=words) as error:
        ph.prepare(ph.load(path))
    assert time.process_time() - start < SECONDS
    text = str(error.value)
    assert str(folder / "case") in text
    assert text == plain(text)


def refused_cheaply(case: Case, folder: Path, words: str) -> None:
    """The same without much memory; looking for that makes it several times slower."""
    tracemalloc.start()
    try:
        refused(case, folder, words)
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()


# --- what they hold -------------------------------------------------------------------------------

# name -> reader, number of its seed, file, what stands there, what is put there, words of the error
WRONG: dict[str, tuple[str, int, str, bytes, bytes, str]] = {
    "pbrt index": ("pbrt", 0, "a.pbrt", b"[ 0 1 2 0 2 3 ]", b"[ 0 1 2 0 2 9 ]",
        r'line \d+: Shape "trianglemesh": face 1 refers to vertex 9; it has 4'),
    "pbrt ply index": ("pbrt", 0, "a.ply", struct.pack("<B3i", 3, 0, 1, 3),
        struct.pack("<B3i", 3, 0, 1, 9), r'Shape "plymesh": .*a.ply: face 1 refers to vertex 9'),
    "usd index": ("usd", 0, "a.usda", b"faceVertexIndices = [0, 1, 2, 3]",
        b"faceVertexIndices = [0, 1, 2, 9]", "/World/M: face 0 refers to vertex 9; there are 4"),
    "usd prototype": ("usd", 0, "a.usda", b"protoIndices = [0, 0]", b"protoIndices = [0, 5]",
        r"/World/I: protoIndices\[1\] is 5; there are 1 prototypes"),
    "obj index": ("obj", 0, "a.obj", b"f 2 3 4", b"f 2 3 9", "face 2 refers to vertex 9"),
    "obj index before": ("obj", 0, "a.obj", b"f -4 -1", b"f -9 -1", "face 3 refers to vertex -9"),
    "ply index": ("ply", 1, "b.ply", b"3 1 2 3", b"3 1 2 9", "face 2 refers to vertex 9"),
    "off index": ("off", 0, "a.off", b"3 1 2 3", b"3 1 2 9", "face 2 refers to vertex 9"),
    "pbrt nan": ("pbrt", 0, "a.pbrt", b"1 1 0 0 1 0 ]\n", b"1 1 nan 0 1 0 ]\n",
        "'point3 P' holds nan as its number 8"),
    "pbrt ply nan": ("pbrt", 0, "a.ply", ONE, NAN, 'Shape "plymesh": vertex 1 is not finite'),
    "ply nan": ("ply", 0, "a.ply", ONE, NAN, "a.ply: vertex 1 is not finite"),
    "ply text nan": ("ply", 1, "b.ply", b"\n1.0 0.0 0.0", b"\n1.0 nan 0.0", "vertex 1 is not fin"),
    "stl text nan": ("stl", 1, "b.stl", b"vertex 1.0", b"vertex nan", "face 0 has a corner that"),
    "off nan": ("off", 0, "a.off", b"\n1.0 0.0", b"\nnan 0.0", "vertex 1 is not finite"),
    "mitsuba ply nan": ("mitsuba", 0, "a.ply", ONE, NAN, r"shape \(ply\): vertex 1 of 'a' is not"),
    "usd widths nan": ("usd", 0, "a.usda", b"widths = [0.2]", b"widths = [nan]",
        r"/World/P: widths\[0\] is not finite"),
    "pbrt itself": ("pbrt", 0, "a.pbrt", b'Include "b.pbrt"', b'Include "a.pbrt"',
        'Include "a.pbrt": includes itself'),
    "pbrt import": ("pbrt", 0, "a.pbrt", b'Include "b.pbrt"', b'Import "a.pbrt"',
        'Import "a.pbrt": includes itself'),
    "pbrt object": ("pbrt", 0, "a.pbrt", b'  Shape "cylinder"', b'  ObjectInstance "thing"',
        'ObjectInstance "thing": object .thing. is open'),
    "pbrt mixture": ("pbrt", 0, "a.pbrt", b'[ "metal" "glass" ]', b'[ "metal" "mixed" ]',
        "is a mixture of itself"),
    "pbrt texture": ("pbrt", 0, "a.pbrt", b'"float tex" 0.5', b'"texture tex" "mixed"',
        "unknown texture 'mixed'"),
    "mitsuba itself": ("mitsuba", 0, "a.xml", b'filename="b.xml"', b'filename="a.xml"',
        "'a.xml' includes itself"),
    "mitsuba circle": ("mitsuba", 0, "a.xml", b'<bsdf type="dielectric" id="glass">',
        b'<bsdf type="twosided" id="glass"><ref id="glass"/>', "'glass' .twosided.: refers to its"),
    "mitsuba group": ("mitsuba", 0, "a.xml", b'<shape type="rectangle"/></shape>',
        b'<shape type="instance"><ref id="group"/></shape></shape>', "holds an instance of itself"),
    "usd itself": ("usd", 0, "a.usda", b"@b.usda@</Thing>", b"@a.usda@</World>", "Cycle detected"),
    "usd layers": ("usd", 0, "a.usda", b'upAxis = "Z"', b'upAxis = "Z"\nsubLayers = [@a.usda@]',
        "has cycles"),
    "usd instancer": ("usd", 0, "a.usda", b"prototypes = [</World/I/A>]",
        b"prototypes = [</World/I>]", "/World/I: is in its own prototype"),
    "obj itself": ("obj", 0, "a.obj", b"mtllib a.mtl", b"mtllib a.obj", "comes before any .newm"),
    "json itself": ("json", 0, "a.json", b'"a.ply"', b'"a.json"', "must be a mesh file"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_wrong_content(tmp_path: Path, name: str) -> None:
    *change, words = WRONG[name]
    refused(changed(*change), tmp_path, words)


# --- headers that lie -----------------------------------------------------------------------------


def _glb(at: int) -> Case:
    data = seed("gltf", 1).files["a.glb"]
    return alone("a.glb", data[:at] + struct.pack("<I", MANY) + data[at + 4 :])


def _npy() -> Case:
    out = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (MANY, 3)}
    np.lib.format.write_array_header_1_0(out, header)
    case = seed("json")
    return replace(case, files=case.files | {"a.npy": out.getvalue()})


def serialized(vertices: int, body: bytes) -> Case:
    """A mesh of so many vertices and one face."""
    case = seed("serialized")
    packed = zlib.compress(
        struct.pack("<I", 0x1000) + b"\0" + struct.pack("<QQ", vertices, 1) + body
    )
    data = struct.pack("<HH", 0x041C, 4) + packed + struct.pack("<QI", 0, 1)
    return replace(case, files=case.files | {"a.serialized": data})


LYING: dict[str, tuple[Callable[[], Case], str]] = {
    "ply": (lambda: changed("ply", 0, "a.ply", b"vertex 4\n", b"vertex %d\n" % MANY),
        "cut short: 4000000000 of element 'vertex'"),
    "ply faces": (lambda: changed("ply", 0, "a.ply", b"face 4\n", b"face %d\n" % MANY),
        "cut short: 4000000000 of element 'face'"),
    "ply list": (lambda: changed("ply", 2, "c.ply", struct.pack(">I2H", 4, 0, 1),
        struct.pack(">I2H", MANY, 0, 1)), "cut short: list 'vertex_index' of element 'face'"),
    "ply text": (lambda: changed("ply", 1, "b.ply", b"vertex 4\n", b"vertex %d\n" % MANY),
        "cut short: 4000000000 of element 'vertex'"),
    "stl": (lambda: changed("stl", 0, "a.stl", struct.pack("<I", 4), struct.pack("<I", MANY)),
        "tells of 4000000000 faces; there are 4"),
    "off": (lambda: changed("off", 0, "a.off", b"4 4 6", b"%d 4 6" % MANY), "4000000000 vertices"),
    "serialized": (lambda: serialized(MANY, b""), "mesh 0: 4000000000 vertices and 1 faces cannot"),
    "xyz": (lambda: changed("xyz", 0, "a.xyz", b"3\nwater", b"%d\nwater" % MANY), "line 6: has 1 "),
    "lammps": (lambda: changed("lammps", 0, "a.dump", b"ATOMS\n3\n", b"ATOMS\n%d\n" % MANY),
        "line 13: has 2 columns"),
    "gltf": (lambda: changed("gltf", 0, "a.gltf", b'"count": 12', b'"count": %d' % MANY),
        r"accessors\[7\]: 4000000000 elements need 8000000000 bytes; bufferViews\[7\] has 24"),
    "glb": (lambda: _glb(8), r"has \d+ of the 4000000000 bytes"),
    "glb chunk": (lambda: _glb(12), "chunk at byte 12 reaches beyond the end"),
    "pbrt film": (lambda: changed("pbrt", 0, "a.pbrt", b'resolution" 8', b'resolution" %d' % MANY),
        "Film"),
    "pbrt heights": (lambda: changed("pbrt", 1, "c.pbrt", b'nu" 2', b'nu" 2000000000'), "heights"),
    "usd faces": (lambda: changed("usd", 0, "a.usda", b"Counts = [4]", b"Counts = [2000000000]"),
        "add up to 2000000000; faceVertexIndices has 4"),
    "json npy": (_npy, "'a.npy' is no valid .npy file"),
}  # fmt: skip


@pytest.mark.parametrize("name", LYING)
def test_lying_headers(tmp_path: Path, name: str) -> None:
    make, words = LYING[name]
    refused_cheaply(make(), tmp_path, words)


def picture(kind: str, side: int) -> bytes:
    """The header of a picture of side x side pixels, and next to nothing that follows it."""
    if kind == "tga":
        return struct.pack("<BBBHHBHHHHBB", 0, 0, 10, 0, 0, 0, 0, 0, side, side, 24, 0) + bytes(99)
    if kind == "hdr":
        return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (side, side) + bytes(99)
    if kind == "pfm":
        return b"PF\n%d %d\n-1.0\n" % (side, side) + bytes(99)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(99)))


@pytest.mark.parametrize(
    ("reader", "kind"),
    [("gltf", "png")]  # which takes few kinds of pictures
    + [
        (r, k)
        for r in ("json", "pbrt", "usd", "obj", "mitsuba")
        for k in ("png", "tga", "hdr", "pfm")
    ],
)
def test_pictures_that_claim_two_to_the_thirty_pixels(
    tmp_path: Path, reader: str, kind: str
) -> None:
    # OpenImageIO tells a picture's kind by what it holds, whatever its name
    case = seed(reader)
    if reader == "gltf":  # which has its own in a buffer
        document = json.loads(case.files["a.gltf"]) | {"images": [{"uri": "a.png"}]}
        case = replace(case, files=case.files | {"a.gltf": json.dumps(document).encode()})
    case = replace(case, files=case.files | {"a.png": picture(kind, 1 << 15)})
    refused_cheaply(case, tmp_path, "32768 x 32768 pixels|cannot be read")


# --- what unpacks to more than it should ----------------------------------------------------------

PACKED = {".gz": lambda data: gzip.compress(data, 1), ".bz2": lambda data: bz2.compress(data, 1),
          ".xz": lambda data: lzma.compress(data, preset=0)}  # fmt: skip


@pytest.mark.parametrize(
    ("reader", "name", "ending"),
    [
        *(("json", "a.json", ending) for ending in PACKED),
        ("pbrt", "a.pbrt", ".gz"),
        ("ply", "a.ply", ".gz"),
        ("obj", "a.obj", ".gz"),
        ("off", "a.off", ".gz"),
        ("stl", "a.stl", ".gz"),
    ],
)
def test_packed_bombs(tmp_path: Path, reader: str, name: str, ending: str) -> None:
    data = seed(reader).files[name] + b" " * (65 << 20)
    refused_cheaply(alone(name + ending, PACKED[ending](data)), tmp_path, "unpacks to more than")


@pytest.mark.parametrize(
    ("reader", "name"),
    [
        ("gltf", "a.gltf"),
        ("mitsuba", "a.xml"),
        ("npz", "a.npz"),
        ("gsd", "a.gsd"),
        ("usd", "a.usda"),
    ],
)
def test_what_is_not_read_packed(tmp_path: Path, reader: str, name: str) -> None:
    packed = gzip.compress(seed(reader).files[name], 1)
    refused(alone(f"{name}.gz", packed), tmp_path, "files are not read packed; unpack it first")


def test_a_serialized_bomb(tmp_path: Path) -> None:
    refused_cheaply(
        serialized(1 << 24, bytes(1 << 27)), tmp_path, "16777216 vertices .* cannot fit in it"
    )


def test_an_archive_that_is_a_bomb(tmp_path: Path) -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("a.usda", b"#usda 1.0\n#" + bytes(1 << 24))
    seed("usd")  # skips without the library
    refused(alone("a.usdz", out.getvalue()), tmp_path, "compressed files are not supported")


def test_parameters_that_multiply(tmp_path: Path) -> None:
    lines = [b'<default name="a0" value="word"/>']
    lines += [b'<default name="a%d" value="$a%d $a%d"/>' % (i + 1, i, i) for i in range(40)]
    text = b'<scene version="3.0.0">' + b"\n".join(lines) + b"</scene>"
    refused(alone("a.xml", text), tmp_path, "line 15: parameters make a text of")


# --- deep nesting ---------------------------------------------------------------------------------

NESTED: dict[str, tuple[str, bytes, str]] = {
    "json blends": ("a.json", b'{"parhelion": 1, "materials": {"a": '
        + b'{"type": "blend", "a": ' * DEEP, "is nested too deeply"),
    "mitsuba": ("a.xml", b'<scene version="3.0.0">' + b'<bsdf type="twosided">' * DEEP,
        "more than 100 elements in each other"),
    "mitsuba references": ("a.xml",
        b'<scene version="3.0.0"><bsdf type="diffuse" id="m0"/>'
        + b"".join(b'<bsdf type="twosided" id="m%d"><ref id="m%d"/></bsdf>' % (i + 1, i)
                   for i in range(DEEP))
        + b'<shape type="sphere"><ref id="m%d"/></shape></scene>' % DEEP,
        "is in or behind more than 100 others"),
    "pbrt objects": ("a.pbrt", b"WorldBegin\n" + b'ObjectBegin "a"\n' * DEEP, "object 'a' is open"),
    "pbrt mixtures": ("a.pbrt",
        b'WorldBegin MakeNamedMaterial "0" "string type" "diffuse"\n'
        + b"".join(b'MakeNamedMaterial "%d" "string type" "mix" "string materials" ["%d" "0"]\n'
                   % (i + 1, i) for i in range(DEEP))
        + b'NamedMaterial "%d" Shape "sphere"' % DEEP, "too deep a one"),
    "usd tuples": ("a.usda", b'#usda 1.0\ndef Mesh "M" { point3f[] points = ' + b"(" * DEEP,
        "tuples in tuples, more than 2000 deep"),
    "usd lists": ("a.usda", b'#usda 1.0\ndef Mesh "M" { point3f[] points = ' + b"[" * DEEP,
        "lists in lists, more than 2000 deep"),
    "usd dictionaries": ("a.usda", b"#usda 1.0\n(customLayerData = " + b"{dictionary a = " * DEEP,
        "more than 2000 deep"),
    "extended xyz": ("a.extxyz", b"1\nLattice=" + b"{" * DEEP + b"\nC 0 0 0\n", "line 2: Lattice"),
    "ply elements": ("a.ply", b"ply\nformat ascii 1.0\n" + b"element a 1\n" * DEEP,
        "no header from 'ply' to 'end_header'"),
}  # fmt: skip


@pytest.mark.parametrize("name", NESTED)
def test_twenty_thousand_levels(tmp_path: Path, name: str) -> None:
    file, data, words = NESTED[name]
    if file.endswith("usda"):
        seed("usd")
    refused(alone(file, data), tmp_path, words)


# --- files elsewhere ------------------------------------------------------------------------------

# reader -> number of its seed, file in which a name stands, the name, and what is so called
NAMED: dict[str, tuple[str, int, str, bytes, str]] = {
    "json picture": ("json", 0, "a.json", b"a.png", "material|materials"),
    "json numbers": ("json", 0, "a.json", b"a.npy", r"shapes\[1\].centers"),
    "json mesh": ("json", 0, "a.json", b"a.ply", r"shapes\[3\].file"),
    "gltf buffer": ("gltf", 0, "a.gltf", b"a.bin", r"buffers\[0\]"),
    "pbrt include": ("pbrt", 0, "a.pbrt", b"b.pbrt", "Include"),
    "pbrt mesh": ("pbrt", 0, "a.pbrt", b"a.ply", "plymesh"),
    "pbrt picture": ("pbrt", 1, "c.pbrt", b"a.png", "imagemap"),
    "mitsuba include": ("mitsuba", 0, "a.xml", b"b.xml", r"line \d+"),
    "mitsuba mesh": ("mitsuba", 0, "a.xml", b"a.obj", r"line \d+"),
    "mitsuba picture": ("mitsuba", 0, "a.xml", b"a.png", r"line \d+"),
    "usd layer": ("usd", 0, "a.usda", b"b.usda", "a.usda"),
    "usd picture": ("usd", 0, "a.usda", b"a.png", "/World"),
}


@pytest.mark.parametrize("how", ["up", "absolute", "link", "folder"])
@pytest.mark.parametrize("name", NAMED)
def test_files_elsewhere_are_not_opened(tmp_path: Path, name: str, how: str) -> None:
    reader, number, file, named, where = NAMED[name]
    case = seed(reader, number)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    target = elsewhere / named.decode()
    target.write_bytes(case.files[named.decode()])
    folder = tmp_path / "case"
    new = {"up": f"../elsewhere/{target.name}", "absolute": str(target), "link": named.decode(),
           "folder": f"inner/{target.name}"}[how]  # fmt: skip
    text = case.files[file].replace(named, new.encode())
    files = {k: v for k, v in case.files.items() if k != named.decode()} | {file: text}
    path = replace(case, files=files).write(folder)
    if how == "link":
        (folder / target.name).symlink_to(target)
    elif how == "folder":
        (folder / "inner").symlink_to(elsewhere)
    with pytest.raises(ph.ParhelionError, match=r"(?s)not inside the scene's folder|outside of the"
                       r" scene's folder") as error:  # fmt: skip
        ph.prepare(ph.load(path))
    assert str(path) in str(error.value)
    assert re.search(where, str(error.value))
    assert ph.load(path, ph.LoadOptions(allow_paths=(str(elsewhere),))).shapes


def test_messages_quote_no_control_characters() -> None:
    text = str(ph.FormatError("a.obj: '\x1b[31m" + "x" * 5000 + "'\nsecond"))
    assert text.startswith("a.obj: '\\x1b[31mxxx")
    assert text.endswith("xxx'\nsecond")
    assert len(text) < 1100


def test_the_first_of_no_numbers_is_not_looked_for() -> None:
    """A mesh of nothing, as broken files may hold, with an attribute of its vertices."""
    none = np.zeros((0, 3), np.float32)
    mesh = ph.Mesh(none, none.astype(np.int64), attributes={"vertex_color": none})
    ph.prepare(ph.Scene([mesh, ph.Spheres([[0.0, 0.0, 0.0]], 1.0)]))


def test_an_error_about_a_value_whose_key_comes_again(tmp_path: Path) -> None:
    text = b'{"parhelion": 1, "shapes": [[[null]]], "shapes": 5}'
    refused(alone("a.json", text), tmp_path, "the key 'shapes' occurs twice|shapes")


def test_a_frame_of_no_atoms(tmp_path: Path) -> None:
    text = seed("lammps").files["a.dump"].replace(b"ATOMS\n3\n", b"ATOMS\n0\n")
    text = text[: text.index(b"1 1 0 0 0")]
    refused(alone("a.dump", text), tmp_path, "a.dump")


def test_a_chunk_that_no_memory_can_hold(tmp_path: Path) -> None:
    """GSD's index of chunks gives each a number of rows."""
    case = seed("gsd")
    data = case.files["a.gsd"]
    rows = struct.pack("<QQ", 0, 4)  # of frame 0; four particles
    assert rows in data
    lying = alone("a.gsd", data.replace(rows, struct.pack("<QQ", 0, 1 << 60)))
    refused(lying, tmp_path, "particles/|cannot be read")


def test_tables_of_gsd_that_lie_outside_of_the_file(tmp_path: Path) -> None:
    """The library reads beyond its end where their sizes are beyond 64 bits."""
    data = seed("gsd").files["a.gsd"]
    for at, what in ((8, "index"), (16, "index"), (24, "names"), (32, "names")):
        for value in (len(data), 1 << 58, (1 << 63) + 128):
            lying = data[:at] + struct.pack("<Q", value) + data[at + 8 :]
            refused(
                alone("a.gsd", lying), tmp_path, f"its {what} of [0-9]+ rows at byte [0-9]+ lie"
            )


def test_a_picture_whose_error_is_no_text() -> None:
    """OpenImageIO may quote a broken file as it stands."""

    def geterror() -> str:
        return b"channel \xb1".decode()

    assert reason_of(geterror) == "it holds bytes that are no text"


def test_an_extension_that_is_no_text(tmp_path: Path) -> None:
    """What is in extensions is decoded when it is asked for."""
    case = changed("gltf", 0, "a.gltf", b'[{"name": "a"}]', b'[{"name": "\xff"}]')
    refused(case, tmp_path, "extensions.KHR_materials_variants: holds text that is not UTF-8")


def test_a_lamp_too_bright_for_a_number(tmp_path: Path) -> None:
    exposure = b"float inputs:width = 2\n        float inputs:exposure = 1e8"
    case = changed("usd", 0, "a.usda", b"float inputs:width = 2", exposure)
    refused(case, tmp_path, "/World/Rect: its intensity is not finite, or above 1e12")


def test_options_that_do_not_go_with_a_file_name_it(tmp_path: Path) -> None:
    path = seed("xyz").write(tmp_path / "case")
    with pytest.raises(ph.FormatError, match=r"case/a\.xyz: unknown field to colour by 'mass'"):
        ph.load(path, ph.LoadOptions(color_by="mass"))


def test_lists_whose_sizes_overflow(tmp_path: Path) -> None:
    """Sizes may be floating-point numbers; those of this file come to places below 0."""
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty list float int a\n"
    head += b"property float x\nproperty float y\nproperty float z\nend_header\n"
    body = struct.pack("<4f", 4e18, 1, 2, 3) * 20
    refused(alone("a.ply", head + body), tmp_path, "is cut short: list 'a' of element 'vertex'")


def test_a_shape_that_reaches_beyond_what_floats_hold_is_named() -> None:
    ball = ph.Spheres([[0, 0, 0]], 1.0)
    far = ph.Spheres([[0, 0, 0], [3e38, 0, 0]], 1.0, name="far")
    words = r"'far': reaches 3e\+38 from the origin; 1e\+37 is the most"
    with pytest.raises(ph.SceneError, match=words):
        ph.prepare(ph.Scene([ball, far]))
    copies = ph.Instances([ball], np.eye(4)[None], name="far")
    copies.transforms[0, 0, 3] = -3e38
    with pytest.raises(ph.SceneError, match=words):
        ph.prepare(ph.Scene([ball, copies]))
