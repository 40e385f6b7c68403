"""Spoils files with regard to what they are made of.

`mutated` takes the bytes of a file apart as the ending of its name says (the tree of a JSON
document, the words of a text, the members of an archive, the chunks of a container, else bytes),
changes some parts, and puts them together again, so that a change reaches the code behind the
checks of form.
"""

from __future__ import annotations

import gzip
import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random
from typing import Any

# Text that means more than it seems to
NAMES = [
    "", ".", "..", "../../../../etc/passwd", "/dev/zero", "/dev/stdin", "/proc/self/mem",
    "scene.json", "a\0b", "\x1b[31m", "x" * 5000, "data:;base64,AAAA", "file:///etc/passwd", "~",
    "http://localhost/", "é", "\ud800", "nan", "-1", "NaN", "none", "*", "%s%n", "{0}", "</a>",
]  # fmt: skip
NUMBERS: list[Any] = [
    0, 1, -1, 2, 3, 4, 7, 255, 256, 65535, 65536, 2**30, 2**31 - 1, 2**31, -(2**31), 2**32 - 1,
    2**32, 2**53, 2**63 - 1, 2**63, 2**64, 10**30, 0.5, -0.0, 1e-3, 1e-38, 1e-310, 3e38, 3.5e38,
    1e100, 1e308, -1e308, float("nan"), float("inf"), float("-inf"),
]  # fmt: skip
INTEGERS = [n for n in NUMBERS if isinstance(n, int)]
_WORDS = re.compile(rb'"[^"\n]*"|[-+]?[\w.]+(?:[eE][-+]?\d+)?|\s+|.', re.S)
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
# How often what is repeated is
_TIMES = [1, 1, 1, 2, 3, 10, 100]
# Bytes of a mutated file at most: what is slow by its size alone is no finding
LARGEST = 1 << 20

TEXT = {".pbrt", ".xml", ".usda", ".obj", ".mtl", ".off", ".xyz", ".extxyz", ".dump", ".lammpstrj",
        ".pdb", ".gro", ".spd"}  # fmt: skip


def mutated(name: str, data: bytes, random: Random, others: list[bytes]) -> bytes:
    """The file's bytes, changed. others: files of the same ending, to take parts from."""
    suffix = "." + name.rpartition(".")[2].lower()
    changed = data
    for _ in range(random.choice([1, 1, 1, 1, 1, 2, 2, 3, 8])):
        how: Callable[[bytes, Random, list[bytes]], bytes] = binary
        if random.random() < 0.9:
            how = _by_ending(suffix, changed)
        changed = how(changed, random, others)
    return changed[:LARGEST]


def _by_ending(suffix: str, data: bytes) -> Callable[[bytes, Random, list[bytes]], bytes]:
    if suffix == ".gz":
        return packed
    if data[:4] == b"glTF":
        return glb
    if data[:2] == b"PK":
        return archive
    if suffix in (".json", ".gltf"):
        return tree
    if suffix in TEXT or data[:6] == b"solid " or data[:10] == b"#usda 1.0\n":
        return text
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return png
    if data[:2] == b"#?":
        return lambda d, r, o: headed(d, r, o, b"\n\n")
    if data[:4] == b"ply\n":
        if b"format ascii" in data[:200]:
            return text
        return lambda d, r, o: headed(d, r, o, b"end_header\n")
    return binary


# --- bytes ----------------------------------------------------------------------------------------


def binary(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """One change of bytes: of some, of a number, or of their order."""
    if not data:
        return random.randbytes(random.choice([1, 4, 16, 80]))
    at = random.randrange(len(data))
    size = min(random.choice([1, 1, 2, 4, 4, 8, 16, 64, 512]), len(data) - at)
    match random.randrange(10):
        case 0:
            return data[:at] + bytes([data[at] ^ 1 << random.randrange(8)]) + data[at + 1 :]
        case 1 | 2 | 3:  # a number in a record
            form = random.choice(["<i", "<i", ">i", "<q", "<h", ">h", "<f", "<d", ">f", "B"])
            number = struct.pack(form, _fitting(form, random))
            at -= at % len(number) if random.random() < 0.7 else 0
            return data[:at] + number + data[at + len(number) :]
        case 4:
            return data[:at]
        case 5:
            return data[:at] + data[at + size :]
        case 6:
            return data[: at + size] + data[at : at + size] * random.choice(_TIMES) + data[at:]
        case 7:
            return data[:at] + random.randbytes(size) + data[at + size :]
        case 8:
            other = random.choice(others)
            start = random.randrange(len(other) + 1)
            part = other[start : start + random.choice([4, 64, 1024, len(other)])]
            return data[:at] + part + data[at + random.choice([0, len(part)]) :]
        case _:
            fill = random.choice([b"\0", b"\xff", b"\x7f", b"\x80", b" "])
            return data[:at] + fill * size + data[at + size :]


def _fitting(form: str, random: Random) -> Any:
    if form[-1] in "fd":
        number = float(random.choice(NUMBERS))
        return number if form[-1] == "d" or abs(number) < 3.4e38 else float("nan")
    bits = 8 * struct.calcsize(form)
    number = random.choice(INTEGERS) % 2**bits
    return number - 2**bits if form[-1] != "B" and number >= 2 ** (bits - 1) else number


# --- text -----------------------------------------------------------------------------------------


def text(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """One change of words or lines."""
    if random.random() < 0.3:
        lines = data.split(b"\n")
        return b"\n".join(_parts(lines, random, random.choice(others).split(b"\n")))
    words = _WORDS.findall(data)
    if not words:
        return random.choice(others)  # of an empty file nothing is left to change
    numbers = [i for i, word in enumerate(words) if _NUMBER.fullmatch(word)]
    strings = [i for i, word in enumerate(words) if word[:1] == b'"']
    kind = random.random()
    if kind < 0.4 and numbers:
        words[random.choice(numbers)] = repr(random.choice(NUMBERS)).encode()
    elif kind < 0.55 and strings:
        at = random.choice(strings)
        if random.random() < 0.5:
            words[at] = b'"' + random.choice(NAMES).encode("utf-8", "surrogatepass") + b'"'
        else:
            words[at] = words[random.choice(strings)]
    elif kind < 0.7:
        foreign = [w for w in _WORDS.findall(random.choice(others)) if not w.isspace()]
        solid = [i for i, word in enumerate(words) if not word.isspace()]
        if foreign and solid:
            words[random.choice(solid)] = random.choice(foreign)
    else:
        words = _parts(words, random, words)
    return b"".join(words)


def _parts(parts: list[bytes], random: Random, others: list[bytes]) -> list[bytes]:
    """A list with some of it gone, repeated, exchanged, out of order or taken from elsewhere."""
    at = random.randrange(len(parts))
    size = random.choice([1, 1, 1, 2, 4, 16])
    chosen = parts[at : at + size]
    match random.randrange(6):
        case 0:
            return parts[:at] + parts[at + size :]
        case 1:
            return parts[:at] + chosen * (1 + random.choice(_TIMES)) + parts[at + size :]
        case 2:
            to = random.randrange(len(parts))
            parts = list(parts)
            parts[at], parts[to] = parts[to], parts[at]
            return parts
        case 3:
            random.shuffle(chosen)
            return parts[:at] + chosen + parts[at + size :]
        case 4:
            start = random.randrange(len(others))
            return parts[:at] + others[start : start + size] + parts[at:]
        case _:
            to = random.randrange(len(parts))
            return parts[:to] + chosen + parts[to:]


# --- JSON -----------------------------------------------------------------------------------------


def tree(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """One change of a JSON document's tree."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return text(data, random, others)
    places = list(_places(document))
    if not places or random.random() < 0.02:
        return text(data, random, others)
    holder, key = random.choice(places)
    kind = random.random()
    if kind < 0.25:
        holder[key] = random.choice(NUMBERS)
    elif kind < 0.33:
        holder[key] = random.choice(NAMES)
    elif kind < 0.4:
        holder[key] = random.choice([None, True, False, [], {}, [[]], [{}], "", 0])
    elif kind < 0.5:
        del holder[key]
    elif kind < 0.65:  # something else of the document
        other, place = random.choice(places)
        holder[key] = json.loads(json.dumps(other[place]))
    elif kind < 0.75:
        if isinstance(holder, list):
            holder[key:key] = [holder[key]] * random.choice(_TIMES)
        else:
            _, place = random.choice(places)
            holder[place if isinstance(place, str) else key + "_"] = holder[key]
    elif kind < 0.9:
        try:
            others_places = list(_places(json.loads(random.choice(others))))
            other, place = random.choice(others_places)
            holder[place if isinstance(place, str) and isinstance(holder, dict) else key] = other[
                place
            ]
        except (ValueError, IndexError, RecursionError):
            holder[key] = random.choice(NAMES)
    elif isinstance(holder[key], (int, float)) and not isinstance(holder[key], bool):
        holder[key] = random.choice([holder[key] + 1, holder[key] - 1, -holder[key]])
    else:
        for _ in range(random.choice([1, 1, 5, 50])):
            holder[key] = [holder[key]]
    try:
        return json.dumps(document).encode("utf-8", "surrogatepass")
    except (ValueError, RecursionError):
        return data


def _places(node: Any) -> Any:
    """Every value of a tree, as what holds it and its key there; of long lists, the ends."""
    stack = [node] if isinstance(node, (dict, list)) else []
    while stack:
        holder = stack.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys if len(keys) < 64 else [*list(keys)[:8], *list(keys)[-8:]]:
            yield holder, key
            if isinstance(holder[key], (dict, list)):
                stack.append(holder[key])


# --- containers -----------------------------------------------------------------------------------


def glb(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """A change within a chunk of a GLB, whose sizes are then right again, or of its bytes."""
    chunks, at = [], 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or random.random() < 0.1:
        return binary(data, random, others)
    number = random.choice([0, 0, 0, *range(len(chunks))])
    kind, body = chunks[number]
    json_chunks = [o[20 : 20 + struct.unpack_from("<I", o, 12)[0]] for o in others if len(o) > 20]
    changed = (tree if kind == 0x4E4F534A else binary)(body, random, json_chunks or others)
    chunks[number] = kind, changed + b" " * (-len(changed) % 4)
    body = b"".join(struct.pack("<II", len(part), kind) + part for kind, part in chunks)
    return data[:8] + struct.pack("<I", 12 + len(body)) + body


def archive(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """A change within a member of a ZIP archive, or of the archive's own bytes."""
    if random.random() < 0.15:
        return binary(data, random, others)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            names = file.namelist()[:100]
            stored = file.infolist()[0].compress_type == zipfile.ZIP_STORED if names else False
            members = {name: file.read(name) for name in names}
    except (zipfile.BadZipFile, zlib.error, OSError, NotImplementedError, RuntimeError, EOFError,
            ValueError, IndexError):  # fmt: skip
        return binary(data, random, others)
    if not members:
        return binary(data, random, others)
    chosen = random.choice(list(members))
    kind = random.random()
    if kind < 0.1:
        del members[chosen]
    elif kind < 0.2:
        renamed = random.choice([*members, "x.npy", "../x.npy", "/x", "positions.npy"])
        members[renamed] = members[chosen]
    elif members[chosen][:6] == b"\x93NUMPY" and kind < 0.6:
        members[chosen] = headed(members[chosen], random, [members[chosen]], b"\n")
    else:
        suffix = "." + chosen.rpartition(".")[2]
        change = _by_ending(suffix, members[chosen])
        members[chosen] = change(members[chosen], random, list(members.values()))
    out = io.BytesIO()
    how = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED
    with zipfile.ZipFile(out, "w", how) as file:
        for name, member in members.items():
            # usdz wants the bytes of a member at a multiple of 64
            info = zipfile.ZipInfo(name.replace("\0", "_"))
            info.compress_type = how
            if stored:
                start = out.tell() + 30 + len(name.encode()) + 4
                pad = -start % 64
                info.extra = struct.pack("<HH", 0x1986, pad) + bytes(pad)
            file.writestr(info, member)
    return out.getvalue()


def packed(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """A change of what is packed, or of the bytes of the packing."""
    try:
        whole = gzip.decompress(data)
    except (OSError, EOFError, zlib.error):
        return binary(data, random, others)
    if random.random() < 0.15:
        return binary(data, random, others)
    change = _by_ending("", whole)
    return gzip.compress((text if change is binary else change)(whole, random, [whole]), 1)


def headed(data: bytes, random: Random, others: list[bytes], end: bytes) -> bytes:
    """A change of the header of words, up to `end`, or of the bytes that follow it."""
    at = data.find(end) + len(end)
    if at < len(end) or random.random() < 0.4:
        return binary(data, random, others)
    heads = [o[: o.find(end) + len(end)] for o in others if end in o]
    return text(data[:at], random, heads or [data[:at]]) + data[at:]


def png(data: bytes, random: Random, others: list[bytes]) -> bytes:
    """A change within a PNG's chunk, whose check is then right again, or of the file's bytes."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    if not chunks or random.random() < 0.15:
        return binary(data, random, others)
    number = random.choice([0, 0, *range(len(chunks))])
    kind, body = chunks[number]
    if random.random() < 0.1:
        kind = random.choice([b"PLTE", b"tRNS", b"gAMA", b"iCCP", b"IDAT", b"IHDR", b"acTL"])
    body = binary(body, random, [body])
    if random.random() < 0.2:
        chunks.insert(number, (kind, body))
    else:
        chunks[number] = kind, body
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
