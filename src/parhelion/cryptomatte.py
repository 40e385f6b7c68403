"""Cryptomatte: names as ids that a float can hold, and what a file says about its layers.

After Friedman and Jones, "Fully Automatic ID Mattes with Support for Motion Blur and Transparency",
SIGGRAPH 2015 posters, and the Cryptomatte specification 1.2.0 (github.com/Psyop/Cryptomatte).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable

# Layer -> what its ids are names of
LAYERS = {"CryptoObject": "shape", "CryptoMaterial": "material"}
# Pairs of id and coverage a pixel, two to an RGBA image; host/render.h has kMatteRanks
RANKS = 6

_WORD = 0xFFFFFFFF


def channels(layer: str) -> tuple[str, ...]:
    """Those of a file, in the order of the ranks: id, coverage, id, coverage and so on."""
    return tuple(f"{layer}{image:02d}.{c}" for image in range(RANKS // 2) for c in "RGBA")


def matte_id(name: str) -> int:
    """The bits of the float that stands for a name in a picture.

    It is the name's hash, with the exponent's lowest bit turned where the float would be
    subnormal, infinite or not a number.
    """
    bits = _murmur3(name.encode())
    return bits ^ 1 << 23 if bits >> 23 & 0xFF in (0, 0xFF) else bits


def attributes(layer: str, names: Iterable[str]) -> dict[str, str]:
    """What a file says about a layer: the kind of its ids, and the names that they stand for."""
    key = f"cryptomatte/{matte_id(layer):08x}"[:-1]
    manifest = {name: f"{matte_id(name):08x}" for name in names}
    return {
        f"{key}/name": layer,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        # some of its readers know no \u escapes
        f"{key}/manifest": json.dumps(manifest, ensure_ascii=False),
    }


def _murmur3(data: bytes) -> int:
    """MurmurHash3_x86_32 by Austin Appleby, of seed 0."""
    whole = len(data) & ~3
    h = 0
    for (word,) in struct.iter_unpack("<I", data[:whole]):
        h = (_rotated(h ^ _mixed(word), 13) * 5 + 0xE6546B64) & _WORD
    h ^= _mixed(int.from_bytes(data[whole:], "little")) ^ len(data)
    h = (h ^ h >> 16) * 0x85EBCA6B & _WORD
    h = (h ^ h >> 13) * 0xC2B2AE35 & _WORD
    return h ^ h >> 16


def _mixed(word: int) -> int:
    return _rotated(word * 0xCC9E2D51 & _WORD, 15) * 0x1B873593 & _WORD


def _rotated(word: int, bits: int) -> int:
    return (word << bits | word >> 32 - bits) & _WORD
