"""Makes microfacet.h, the tables of what rough surfaces reflect.

    python generate.py [part ...]    all, or only those parts anew; their names are in PARTS

One bounce on a microsurface with Smith's masking loses what would have bounced again. Here masking
is height-correlated, G2 = 1 / (1 + Lambda(o) + Lambda(i)).

Metal. A symmetric positive kernel has a unique positive scaling c with

    c(o) * integral of kernel(o, i) c(i) di = 1   for every direction o

(Sinkhorn and Knopp 1967), so f(o, i) c(o) c(i) is reciprocal and loses nothing. The tables hold
1 / c, which is smoother; one is for surfaces whose slopes differ along and across.

Glass. Reflection and refraction together; the tables hold the albedo E(o), by which the single
bounce is divided (E. Turquin, "Practical multiple scattering compensation for microfacet models",
2019). A symmetric scaling exists but is of no use: where the indices are close, it makes the two
sides differ by large factors. Of surfaces whose slopes differ along and across, the renderer
computes E(o) by itself, from the lattice of normals.

Coat. How much less a rough coat reflects and refracts, each by itself with separable masking, than
a smooth one, which is seen at a less grazing angle where roughness shows facets less grazed; the
means over diffuse light from outside of what a smooth coat reflects and of how much less a rough
one does; and the mean that is reflected from within.

Each integral is a mean over visible normals, placed on a Fibonacci lattice; what metal reflects is
kept as a histogram over the table's own coordinates, and interpolated as the renderer does.

All are interpolated by cubics through four nodes.

Coordinates. Angles from the normal: with sin(p)^2 = z (1 + 2 alpha) / (z + 2 alpha), where losses
of all small alphas look alike, sin(p) + BEND (1 - cos(p)), scaled to [0, 1]. Next to the normal it
goes as the sine of the angle, whose third power is in what facets send below the horizon. In glass
a step at the critical angle, 2 alpha wide, is added. Alphas: their roots. Index: the fourth root of
ln(eta) / ln(10). Ratio of the alphas: its root. Azimuth: the fourth root of the alpha that slopes
have along it, from 0 at the smaller to 1 at the larger.
"""

import re
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from scipy.special import erf, erfinv

METAL_ALPHAS, OUTER_ALPHAS, INNER_ALPHAS, COAT_ALPHAS = 32, 20, 28, 28
METAL_ANGLES, OUTER_ANGLES, INNER_ANGLES, COAT_ANGLES = 32, 24, 40, 24
INDICES, INNER_INDICES = 24, 44  # from 1 to 10
FINE_INDICES = 64
# Of surfaces whose slopes differ: larger alphas, ratios of the smaller to it, azimuths, angles
STRETCHED = 15, 11, 9, 20
LEAST_RATIO = 1e-3
LATTICE_NORMALS, LATTICE_STEP = 384, 173  # a step whose lattice has all its points far apart
SHEEN_ALPHAS, SHEEN_ANGLES = 8, 32
FILM_FIRST, FILM_STEP, FILM_WAVELENGTHS = 400, 15, 20  # nanometres
MAX_INDEX = 10.0
BEND = 0.3
BINS = 2048
STRETCHED_BINS = 48, 256
UNIT = 1 << 15  # 1.0 in the tables

# Interpolation errs by up to this much of the energy, so that much is given away.
MARGIN = {"metal": 2e-4, "stretched": 3e-4, "outer": 2e-4, "inner": 3e-4}

DISTRIBUTIONS = ("ggx", "beckmann")
LATTICE = 17711, 10946


def to_t(z, alpha):
    sine = np.sqrt(z * (1 + 2 * alpha) / (z + 2 * alpha))
    cosine = np.sqrt(np.maximum(2 * alpha * (1 - z) / (z + 2 * alpha), 0))
    return (sine + BEND * (1 - cosine)) / (1 + BEND)


def from_t(t, alpha):
    p = np.arcsin((t * (1 + BEND) - BEND) / np.hypot(1, BEND)) + np.arctan(BEND)
    sine2 = np.clip(np.sin(p), 0, 1) ** 2
    return 2 * alpha * sine2 / (1 + 2 * alpha - sine2)


def direction(z, across=0.0):
    """The unit vector of a cosine, the sine of its azimuth given."""
    return np.sqrt(1 - z * z) * np.array([np.sqrt(1 - across**2), across, 0]) + [0, 0, z]


def masking(kind, alphas, w):
    """G1 of directions (..., 3)."""
    z = np.abs(w[..., 2])
    slope = np.hypot(alphas[0] * w[..., 0], alphas[1] * w[..., 1]) / np.maximum(z, 1e-9)
    if kind == "ggx":
        return 2 / (1 + np.sqrt(1 + slope**2))
    a = np.minimum(1 / np.maximum(slope, 1e-9), 30.0)
    return 2 * a / (a * (1 + erf(a)) + np.exp(-a * a) / np.sqrt(np.pi))


def visible_normals(kind, alphas, o):
    """(N, 3) normals visible from o."""
    i = np.arange(LATTICE[0]) + 0.5
    u, v = i / LATTICE[0], i * LATTICE[1] / LATTICE[0] % 1.0
    s = o * [*alphas, 1]
    s /= np.linalg.norm(s)
    if kind == "ggx":
        height = 1 - v * (1 + s[2])
        r = np.sqrt(np.maximum(1 - height**2, 0))
        m = np.stack([r * np.cos(2 * np.pi * u), r * np.sin(2 * np.pi * u), height], axis=1) + s
    else:
        sine, cosine = np.hypot(s[0], s[1]), s[2]
        cot = min(cosine / max(sine, 1e-9), 6.0)
        q = np.linspace(-cot, 6.0, 1 << 14)
        cumulative = cosine * (erf(q) + erf(cot)) / 2 + sine * (
            np.exp(-cot * cot) - np.exp(-q * q)
        ) / (2 * np.sqrt(np.pi))
        along, across = np.interp(v * cumulative[-1], cumulative, q), erfinv(2 * u - 1)
        x, y = s[:2] / sine if sine > 0 else (1, 0)
        m = np.stack([x * along - y * across, y * along + x * across, np.ones_like(u)], axis=1)
    m *= [*alphas, 1]
    return m / np.linalg.norm(m, axis=1, keepdims=True)


def fresnel(cosine, eta):
    """(share reflected, cosine refracted)"""
    sine2 = (1 - cosine**2) / eta**2
    cos_t = np.sqrt(np.maximum(1 - sine2, 0))
    p = (eta * cosine - cos_t) / (eta * cosine + cos_t)
    s = (cosine - eta * cos_t) / (cosine + eta * cos_t)
    return np.where(sine2 >= 1, 1.0, (p**2 + s**2) / 2), cos_t


class Rows:
    """What comes of light from one direction, given the visible normals."""

    def __init__(self, kind, alphas, o):
        self.kind, self.alphas, self.o = kind, alphas, o
        self.m = visible_normals(kind, alphas, o)
        self.facing = np.maximum(self.m @ o, 1e-9)  # which rounding makes 0
        self.mirrored = 2 * self.facing[:, None] * self.m - o

    def shadowing(self, w, correlated=True, side=1):
        """G2(o, w) / G1(o); 0 on the other side of the surface."""
        i = masking(self.kind, self.alphas, w)
        o = masking(self.kind, self.alphas, self.o) if correlated else 1.0
        return np.where(w[:, 2] * side > 0, i / (o + i - o * i), 0.0)

    def reflected(self, correlated=True):
        """Of mirrors that reflect everything, by normal."""
        return self.shadowing(self.mirrored, correlated)

    def bounces(self, eta, correlated=True):
        """(share reflected, share refracted), eta being the far index over the near one."""
        share, cos_t = fresnel(self.facing, eta)
        down = (self.facing / eta - cos_t)[:, None] * self.m - self.o / eta
        return (
            np.mean(share * self.reflected(correlated)),
            np.mean((1 - share) * self.shadowing(down, correlated, -1)),
        )


def interpolation(count, bins):
    """(bins, count): what an interpolated table has in the middle of each bin."""
    x = (np.arange(bins) + 0.5) / bins * (count - 1)
    k = np.clip(x.astype(int) - 1, 0, count - 4)
    matrix = np.zeros((bins, count))
    for i in range(4):
        weight = [(x - k - j) / (i - j) for j in range(4) if j != i]
        matrix[np.arange(bins), k + i] = np.prod(weight, axis=0)
    return matrix


def scaling(kernel, values, steps=50):
    """1 / c at the nodes, for the histograms (nodes, bins) and the interpolation (bins, nodes).

    Errors shrink to half or less at each step: by (1 - x) / 2, x the eigenvalues, from 0 to 1.
    """
    e = np.ones(len(kernel))
    for _ in range(steps):
        e = np.sqrt(e * (kernel @ (1 / (values @ e))))
    return e


def alphas(count):
    return np.maximum(np.linspace(0, 1, count) ** 2, 1e-4)


def angle_nodes(count, alpha):
    return np.clip(from_t(np.linspace(0, 1, count), alpha), 1e-6, 1)


def metal_table(kind):
    values = interpolation(METAL_ANGLES, BINS)
    table = []
    for alpha in alphas(METAL_ALPHAS):
        kernel = []
        for z in angle_nodes(METAL_ANGLES, alpha):
            rows = Rows(kind, (alpha, alpha), direction(z))
            places = to_t(np.clip(rows.mirrored[:, 2], 0, 1), alpha) * BINS
            kernel.append(histogram(places.astype(int), rows.reflected(), BINS))
        table.append(scaling(np.array(kernel), values))
    return np.array(table) * np.sqrt(1 + MARGIN["metal"])


def histogram(places, shares, bins):
    return np.bincount(np.minimum(places, bins - 1), shares, bins) / len(places)


def stretched_page(kind, u, v, count_w, count_t):
    """Of the alphas u > v, (azimuths, angles)."""
    bins_w, bins_t = STRETCHED_BINS
    values = np.kron(interpolation(count_w, bins_w), interpolation(count_t, bins_t))
    low, high = v**0.25, u**0.25
    kernel = []
    for w in np.linspace(0, 1, count_w):
        along = (low + w * (high - low)) ** 4
        across = np.sqrt(np.clip((u**2 - along**2) / (u**2 - v**2), 0, 1))
        for z in angle_nodes(count_t, along):
            rows = Rows(kind, (u, v), direction(z, across))
            x, y, height = rows.mirrored.T
            flat = np.maximum(np.hypot(x, y), 1e-12)
            slope = np.hypot(u * x / flat, v * y / flat)
            at_w = np.clip((slope**0.25 - low) / (high - low), 0, 1 - 1e-9) * bins_w
            at_t = to_t(np.clip(height, 0, 1), slope) * bins_t
            places = at_w.astype(int) * bins_t + np.minimum(at_t.astype(int), bins_t - 1)
            kernel.append(histogram(places, rows.reflected(), bins_w * bins_t))
    return scaling(np.array(kernel), values).reshape(count_w, count_t)


def stretched_table(kind):
    """Of surfaces of slopes that differ (larger alpha, ratio, azimuth, angle)."""
    count_a, count_r, count_w, count_t = STRETCHED
    table = np.zeros(STRETCHED)
    for i, u in enumerate(alphas(count_a)):
        for j, ratio in enumerate(np.maximum(np.linspace(0, 1, count_r) ** 2, LEAST_RATIO)):
            table[i, j] = stretched_page(kind, u, min(ratio, 1 - 1e-4) * u, count_w, count_t)
    return table * np.sqrt(1 + MARGIN["stretched"])


def normal_lattice():
    """(4, LATTICE_NORMALS): cosine and sine of an azimuth, a uniform number, and the slope that a
    Beckmann surface of alpha 1 exceeds with that probability.
    """
    i = np.arange(LATTICE_NORMALS)
    turns = (i + 0.5) / LATTICE_NORMALS * 2 * np.pi
    v = (i * LATTICE_STEP % LATTICE_NORMALS + 0.5) / LATTICE_NORMALS
    return np.stack([np.cos(turns), np.sin(turns), v, np.sqrt(-np.log(v))])


def indices(count=INDICES):
    return MAX_INDEX ** (np.linspace(0, 1, count) ** 4)


def inner_place(z, alpha, eta):
    """The coordinate of cosines on the dense side; eta < 1."""
    critical = np.sqrt(1 - eta**2)

    def step(z):
        return (z - critical) / np.hypot(z - critical, 2 * alpha)

    return (to_t(z, alpha) + step(z) - step(0)) / (1 + step(1) - step(0))


def inner_nodes(alpha, eta):
    critical = np.sqrt(1 - eta**2)
    fine = np.linspace(0, 1, 8192)
    near = 2 * alpha * np.tan(fine[:-1] * np.pi / 2)
    z = np.concatenate([fine, from_t(fine, alpha), critical + near, critical - near])
    z = np.unique(np.clip(z, 0, 1))
    return np.clip(
        np.interp(np.linspace(0, 1, INNER_ANGLES), inner_place(z, alpha, eta), z), 1e-6, 1
    )


# 1 + 1e-5 stands for the limit; 1 itself would have no dense side
LEAST_INDEX = 1 + 1e-5


def outer_table(kind):
    """Albedos (indices, alphas, angles) of the thin side."""
    table = np.zeros((INDICES, OUTER_ALPHAS, OUTER_ANGLES))
    for k, alpha in enumerate(alphas(OUTER_ALPHAS)):
        for j, z in enumerate(angle_nodes(OUTER_ANGLES, alpha)):
            rows = Rows(kind, (alpha, alpha), direction(z))
            table[:, k, j] = [sum(rows.bounces(max(eta, LEAST_INDEX))) for eta in indices()]
    return table * (1 + MARGIN["outer"])


def inner_table(kind):
    """Of the dense side."""
    table = np.zeros((INNER_INDICES, INNER_ALPHAS, INNER_ANGLES))
    for k, alpha in enumerate(alphas(INNER_ALPHAS)):
        for i, index in enumerate(indices(INNER_INDICES)):
            eta = 1 / max(index, LEAST_INDEX)
            for j, z in enumerate(inner_nodes(alpha, eta)):
                rows = Rows(kind, (alpha, alpha), direction(z))
                table[i, k, j] = sum(rows.bounces(eta))
    return table * (1 + MARGIN["inner"])


def coat_tables(kind):
    """How much less a rough coat reflects, and refracts, (indices, alphas, angles); the mean of the
    former over diffuse light; and the mean that is reflected from within.
    """
    less = np.zeros((2, INDICES, COAT_ALPHAS, COAT_ANGLES))
    mean, within = np.zeros((2, INDICES, COAT_ALPHAS))
    places = np.linspace(0, 1, BINS + 1)
    values = interpolation(COAT_ANGLES, BINS)
    inner_z = np.linspace(0, 1, 64)  # both ends whole: the quadrature of Mitsuba's roughplastic
    for k, alpha in enumerate(alphas(COAT_ALPHAS)):

        def smooth(z, eta, alpha=alpha):
            return fresnel(np.hypot(z, alpha * np.sqrt(1 - z * z)), eta)[0]

        weight = np.diff(from_t(places, alpha) ** 2)
        middle = from_t((places[1:] + places[:-1]) / 2, alpha)
        inner = [Rows(kind, (alpha, alpha), direction(max(x, 1e-6))) for x in inner_z]
        for j, x in enumerate(angle_nodes(COAT_ANGLES, alpha)):
            rows = Rows(kind, (alpha, alpha), direction(x))
            for i, eta in enumerate(indices()):
                share = smooth(x, eta)
                less[:, i, k, j] = np.array([share, 1 - share]) - rows.bounces(eta, False)
        for i, eta in enumerate(indices()):
            extra = fresnel(middle, eta)[0] - smooth(middle, eta)
            mean[i, k] = weight @ (extra + values @ less[0, i, k])
            within[i, k] = np.mean(
                [2 * x * r.bounces(1 / eta, False)[0] for x, r in zip(inner_z, inner, strict=True)]
            )
    return *less, mean, within


def smooth_means():
    """Mean over diffuse light from outside of what a smooth coat reflects, (FINE_INDICES,)."""
    z = (np.arange(1 << 18) + 0.5) / (1 << 18)
    return [np.mean(2 * z * fresnel(z, eta)[0]) for eta in indices(FINE_INDICES)]


def sheen_table():
    """Albedo of Estevez and Kulla's sheen (SHEEN_ALPHAS, SHEEN_ANGLES): alpha from 1/4, sqrt(z)."""
    z, phi = np.meshgrid((np.arange(512) + 0.5) / 512, (np.arange(256) + 0.5) / 256 * np.pi)
    x, y = np.sqrt(1 - z * z) * [np.cos(phi), np.sin(phi)]
    table = np.zeros((SHEEN_ALPHAS, SHEEN_ANGLES))
    for j, o in enumerate(np.clip(np.linspace(0, 1, SHEEN_ANGLES) ** 2, 1e-6, 1)):
        h = np.stack([x + np.sqrt(1 - o * o), y, z + o])
        sine = np.sqrt(np.maximum(1 - h[2] ** 2 / np.sum(h * h, axis=0), 0))
        for k, alpha in enumerate(np.linspace(0.25, 1, SHEEN_ALPHAS)):
            density = (2 + 1 / alpha) * sine ** (1 / alpha) / (2 * np.pi)
            table[k, j] = 2 * np.pi * np.mean(density * z / (4 * (z + o - z * o)))
    assert table.max() < 1
    return table


def film_weights():
    """(wavelengths, 3): linear Rec. 709 of a spectrum, such that a flat one is white.

    CIE 1931 observer in the form of Wyman, Sloan and Shirley, "Simple Analytic Approximations to
    the CIE XYZ Color Matching Functions", JCGT 2(2), 2013.
    """
    nm = FILM_FIRST + FILM_STEP * np.arange(FILM_WAVELENGTHS)

    def bump(place, below, above):
        return np.exp(-(((nm - place) / np.where(nm < place, below, above)) ** 2) / 2)

    x = 1.056 * bump(599.8, 37.9, 31.0) + 0.362 * bump(442.0, 16.0, 26.7)
    x -= 0.065 * bump(501.1, 20.4, 26.2)
    y = 0.821 * bump(568.8, 46.9, 40.5) + 0.286 * bump(530.9, 16.3, 31.1)
    z = 1.217 * bump(437.0, 11.8, 36.0) + 0.681 * bump(459.0, 26.0, 13.8)
    to_rgb = np.array(
        [
            [3.2404542, -1.5371385, -0.4985314],
            [-0.9692660, 1.8760108, 0.0415560],
            [0.0556434, -0.2040259, 1.0572252],
        ]
    )
    rgb = np.stack([x, y, z], axis=1) @ to_rgb.T
    return rgb / rgb.sum(axis=0)


def text(name, tables, comment):
    numbers = np.rint(np.array(tables) * UNIT).astype(int).ravel()
    kind = "i16" if numbers.min() < 0 else "u16"
    if kind == "i16":
        numbers = np.minimum(numbers, UNIT - 1)  # 1 does not fit
    assert numbers.max() < 1 << 16
    lines, line = [], " "
    for n in numbers:
        if len(line) + len(f" {n},") > 100:
            lines.append(line)
            line = " "
        line += f" {n},"
    body = "\n".join([*lines, line])
    return f"// {comment}\nPH_TABLE {kind} {name}[{numbers.size}] = {{\n{body}\n}};\n"


def floats(name, values, comment):
    lines = np.reshape(values, (-1, 6))
    body = "\n".join("  " + " ".join(f"{v:.7f}f," for v in line) for line in lines)
    return f"// {comment}\nPH_TABLE float {name}[{np.size(values)}] = {{\n{body}\n}};\n"


HEADER = """// Made by generate.py, which says what is in it. Numbers are in units of 2^-15.
#pragma once
#include "../types.h"

// clang-format off
namespace parhelion {

using u16 = unsigned short;
using i16 = short;
"""


# What makes the tables of each part, and their names and contents
SHARED = "[distribution][index][alpha][angle]"
PARTS = {
    "metal": (metal_table, {"kMetalEscape": "[distribution][alpha][angle]"}),
    "stretched": (
        stretched_table,
        {"kStretchedEscape": "[distribution][larger alpha][ratio][azimuth][angle]"},
    ),
    "outer": (outer_table, {"kGlassOuter": SHARED}),
    "inner": (inner_table, {"kGlassInner": SHARED}),
    "coat": (
        coat_tables,
        {
            "kCoatReflected": f"less reflected than by a smooth coat, {SHARED}",
            "kCoatRefracted": f"less refracted than by a smooth coat, {SHARED}",
            "kCoatMean": "less reflected of diffuse light, [distribution][index][alpha]",
            "kCoatWithin": "[distribution][index][alpha]",
        },
    ),
    "mean": (smooth_means, {"kSmoothMean": "[index]"}),
    "sheen": (sheen_table, {"kSheenAlbedo": "[alpha, from 1/4][root of the cosine]"}),
    "lattice": (
        normal_lattice,
        {"kNormalLattice": "[cosine, sine, uniform number, Beckmann slope][normal]"},
    ),
    "film": (
        film_weights,
        {"kFilmWeights": "Of the spectrum, for linear RGB, [wavelength][channel]"},
    ),
}
BY_DISTRIBUTION = "metal", "stretched", "outer", "inner", "coat"
IN_FLOAT = "lattice", "film"


def constants():
    counts = {
        "kMetalAlphas": METAL_ALPHAS,
        "kMetalAngles": METAL_ANGLES,
        "kOuterAlphas": OUTER_ALPHAS,
        "kOuterAngles": OUTER_ANGLES,
        "kInnerAlphas": INNER_ALPHAS,
        "kInnerAngles": INNER_ANGLES,
        "kCoatAlphas": COAT_ALPHAS,
        "kCoatAngles": COAT_ANGLES,
        "kIndices": INDICES,
        "kInnerIndices": INNER_INDICES,
        "kFineIndices": FINE_INDICES,
        "kSheenAlphas": SHEEN_ALPHAS,
        "kSheenAngles": SHEEN_ANGLES,
        "kFilmWavelengths": FILM_WAVELENGTHS,
        "kLatticeNormals": LATTICE_NORMALS,
        "kStretchedAlphas": STRETCHED[0],
        "kStretchedRatios": STRETCHED[1],
        "kStretchedAzimuths": STRETCHED[2],
        "kStretchedAngles": STRETCHED[3],
    }
    lines = [f"inline constexpr u32 {name} = {value};" for name, value in counts.items()]
    lines += [
        f"inline constexpr float kLogMaxIndex = {np.log(MAX_INDEX):.9f}f, kBend = {BEND}f;",
        f"inline constexpr float kFilmFirst = {FILM_FIRST}.0f, kFilmStep = {FILM_STEP}.0f;",
    ]
    return "\n".join(lines) + "\n"


def made(part, pool):
    """{name: text} of the tables of a part."""
    make, tables = PARTS[part]
    if part not in BY_DISTRIBUTION:
        values = [make()]
    elif len(tables) == 1:
        values = [list(pool.map(make, DISTRIBUTIONS))]
    else:
        values = zip(*pool.map(make, DISTRIBUTIONS), strict=True)
    write = floats if part in IN_FLOAT else text
    return {
        name: write(name, value, comment)
        for (name, comment), value in zip(tables.items(), values, strict=True)
    }


def main():
    header = Path(__file__).with_name("microfacet.h")
    parts = sys.argv[1:] or list(PARTS)
    if unknown := set(parts) - set(PARTS):
        sys.exit(f"no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    tables = {}
    if sys.argv[1:]:
        found = re.findall(r"(// [^\n]*\nPH_TABLE \w+ (\w+)\[.*?\n};\n)", header.read_text(), re.S)
        tables = {name: block for block, name in found}
    with ProcessPoolExecutor() as pool:
        for part in parts:
            tables |= made(part, pool)
    blocks = [tables[name] for _, names in PARTS.values() for name in names]
    end = "}  // namespace parhelion\n// clang-format on\n"
    header.write_text("\n".join([HEADER, constants(), *blocks, end]))


if __name__ == "__main__":
    main()
