"""Makes microfacet.h, the tables of what rough surfaces reflect: python generate.py > microfacet.h.

One bounce on a microsurface with Smith's masking loses what would have bounced again. Here masking
is height-correlated, G2 = 1 / (1 + Lambda(o) + Lambda(i)).

Metal. A symmetric positive kernel has a unique positive scaling c with

    c(o) * integral of kernel(o, i) c(i) di = 1   for every direction o

(Sinkhorn and Knopp 1967), so f(o, i) c(o) c(i) is reciprocal and loses nothing. The table holds
1 / c, which is smoother.

Glass. Reflection and refraction together; the tables hold the albedo E(o), by which the single
bounce is divided (E. Turquin, "Practical multiple scattering compensation for microfacet models",
2019). A symmetric scaling exists but is of no use: where the indices are close, it makes the two
sides differ by large factors. On the dense side a kink lies at the critical angle; its table has
one half of the nodes below that angle's cosine, and one above.

Coat. How much less a rough coat reflects and refracts, each by itself with separable masking, than
a smooth one; the means over diffuse light from outside of what a smooth coat reflects and of how
much less a rough one does; and the mean that is reflected from within.

Each integral is a mean over visible normals, placed on a Fibonacci lattice; what metal reflects is
kept as a histogram over the table's own coordinate, and interpolated as the renderer does.

All are interpolated by Catmull and Rom's cubics.

Coordinates. Angles from the normal: t^2 = z (1 + 2 alpha) / (z + 2 alpha), where losses of all
small alphas look alike. Alphas: their roots. Index: the cubic root of ln(eta) / ln(10).
"""

import numpy as np
from scipy.special import erf, erfinv

ALPHAS = 20
METAL_ANGLES, OUTER_ANGLES, INNER_ANGLES, COAT_ANGLES = 24, 24, 32, 24
INDICES = 16  # from 1 to 10
FINE_INDICES = 64
SHEEN_ALPHAS, SHEEN_ANGLES = 8, 32
FILM_FIRST, FILM_STEP, FILM_WAVELENGTHS = 400, 15, 20  # nanometres
MAX_INDEX = 10.0
BINS = 2048
UNIT = 1 << 15  # 1.0 in the tables

# Interpolation errs by up to this much of the energy, so that much is given away.
MARGIN = {"metal": 4e-4, "outer": 4e-4, "inner": 1e-3}

DISTRIBUTIONS = ("ggx", "beckmann")
LATTICE = 17711, 10946


def to_t(z, alpha):
    return np.sqrt(z * (1 + 2 * alpha) / (z + 2 * alpha))


def from_t(t, alpha):
    return 2 * alpha * t**2 / (1 + 2 * alpha - t**2)


def masking(kind, alpha, z):
    """G1 at the cosine z."""
    z = np.abs(z)
    slope = alpha * np.sqrt(np.maximum(1 - z * z, 0)) / np.maximum(z, 1e-9)
    if kind == "ggx":
        return 2 / (1 + np.sqrt(1 + slope**2))
    a = np.minimum(1 / np.maximum(slope, 1e-9), 30.0)
    return 2 * a / (a * (1 + erf(a)) + np.exp(-a * a) / np.sqrt(np.pi))


def visible_normals(kind, alpha, z):
    """(N, 3) normals visible from (sqrt(1 - z^2), 0, z)."""
    i = np.arange(LATTICE[0]) + 0.5
    u, v = i / LATTICE[0], i * LATTICE[1] / LATTICE[0] % 1.0
    sine, cosine = np.array([alpha * np.sqrt(1 - z * z), z]) / np.hypot(
        alpha * np.sqrt(1 - z * z), z
    )
    if kind == "ggx":
        height = 1 - v * (1 + cosine)
        r = np.sqrt(np.maximum(1 - height**2, 0))
        h = [r * np.cos(2 * np.pi * u) + sine, r * np.sin(2 * np.pi * u), height + cosine]
        m = np.stack([alpha * h[0], alpha * h[1], h[2]], axis=1)
    else:
        cot = min(cosine / max(sine, 1e-9), 6.0)
        q = np.linspace(-cot, 6.0, 1 << 16)
        cumulative = cosine * (erf(q) + erf(cot)) / 2 + sine * (
            np.exp(-cot * cot) - np.exp(-q * q)
        ) / (2 * np.sqrt(np.pi))
        along = np.interp(v * cumulative[-1], cumulative, q)
        m = np.stack([alpha * along, alpha * erfinv(2 * u - 1), np.ones_like(u)], axis=1)
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

    def __init__(self, kind, alpha, z):
        self.kind, self.alpha, self.z = kind, alpha, z
        self.m = visible_normals(kind, alpha, z)
        self.facing = self.m[:, 0] * np.sqrt(1 - z * z) + self.m[:, 2] * z
        self.facing = np.maximum(self.facing, 1e-9)  # which rounding makes 0
        self.mirrored = 2 * self.facing * self.m[:, 2] - z

    def shadowing(self, z, correlated=True):
        """G2(o, i) / G1(o); 0 below the surface."""
        i = masking(self.kind, self.alpha, z)
        o = masking(self.kind, self.alpha, self.z) if correlated else 1.0
        return np.where(z > 0, i / (o + i - o * i), 0.0)

    def histogram(self):
        """Of what a white metal reflects, over t."""
        place = to_t(np.clip(self.mirrored, 0, 1), self.alpha) * BINS
        bins = np.minimum(place.astype(int), BINS - 1)
        return np.bincount(bins, self.shadowing(self.mirrored) / len(bins), BINS)

    def glass(self, eta):
        """Share reflected or refracted, eta being the far index over the near one."""
        share, cos_t = fresnel(self.facing, eta)
        down = (self.z - self.facing * self.m[:, 2]) / eta + cos_t * self.m[:, 2]
        return np.mean(share * self.shadowing(self.mirrored) + (1 - share) * self.shadowing(down))

    def coat(self, eta):
        """(share reflected, share refracted), masking separable."""
        share, cos_t = fresnel(self.facing, eta)
        down = (self.z - self.facing * self.m[:, 2]) / eta + cos_t * self.m[:, 2]
        return (
            np.mean(share * self.shadowing(self.mirrored, correlated=False)),
            np.mean((1 - share) * self.shadowing(down, correlated=False)),
        )


def interpolation(count):
    """(BINS, count): what an interpolated table has in the middle of each bin."""
    x = (np.arange(BINS) + 0.5) / BINS * (count - 1)
    k = np.minimum(x.astype(int), count - 2)
    f = x - k
    weights = [
        (-f + 2 * f**2 - f**3) / 2,
        (2 - 5 * f**2 + 3 * f**3) / 2,
        (f + 4 * f**2 - 3 * f**3) / 2,
        (f**3 - f**2) / 2,
    ]
    matrix = np.zeros((BINS, count + 2))  # with a node beyond each end, which continues the slope
    for i, weight in enumerate(weights):
        matrix[np.arange(BINS), k + i] = weight
    matrix[:, 1] += 2 * matrix[:, 0]
    matrix[:, 2] -= matrix[:, 0]
    matrix[:, -2] += 2 * matrix[:, -1]
    matrix[:, -3] -= matrix[:, -1]
    return matrix[:, 1:-1]


def scaling(kernel, values, steps=200):
    """1 / c at the nodes, for the histograms (nodes, bins) and the interpolation (bins, nodes)."""
    e = np.ones(len(kernel))
    for _ in range(steps):
        e = np.sqrt(e * (kernel @ (1 / (values @ e))))
    return e


def alphas():
    return np.maximum(np.linspace(0, 1, ALPHAS) ** 2, 1e-4)


def angle_nodes(count, alpha):
    return np.clip(from_t(np.linspace(0, 1, count), alpha), 1e-6, 1)


def metal_table(kind):
    values = interpolation(METAL_ANGLES)
    table = [
        scaling(
            np.array([Rows(kind, a, z).histogram() for z in angle_nodes(METAL_ANGLES, a)]), values
        )
        for a in alphas()
    ]
    return np.array(table) * np.sqrt(1 + MARGIN["metal"])


def indices(count=INDICES):
    return MAX_INDEX ** (np.linspace(0, 1, count) ** 3)


def inner_nodes(alpha, eta):
    """Cosines on the dense side; eta < 1."""
    critical = np.sqrt(1 - eta**2)
    # Below: from grazing, where x is t, to the critical angle, where 1 - x is that of the distance
    share = np.sin(np.linspace(0, np.pi / 2, 8192) ** 2 / (np.pi / 2))
    rising, falling = to_t(share * critical, alpha), to_t(np.sqrt(1 - share**2), alpha)
    x = rising / (rising + falling)
    below = critical * np.interp(np.linspace(0, 1, INNER_ANGLES), x, share)
    # Above: t of the refracted direction
    refracted = angle_nodes(INNER_ANGLES, alpha)
    above = np.sqrt(1 - eta**2 * (1 - refracted**2))
    return np.clip(np.concatenate([below, above]), 1e-6, 1)


def glass_tables(kind):
    """(INDICES, alphas, angles) of the thin side and (INDICES, alphas, 2 angles) of the dense."""
    outer = np.zeros((INDICES, ALPHAS, OUTER_ANGLES))
    inner = np.zeros((INDICES, ALPHAS, 2 * INNER_ANGLES))
    etas = np.maximum(indices(), 1 + 1e-5)  # the limit; 1 itself would have no dense side
    for k, alpha in enumerate(alphas()):
        for j, z in enumerate(angle_nodes(OUTER_ANGLES, alpha)):
            rows = Rows(kind, alpha, z)
            outer[:, k, j] = [rows.glass(eta) for eta in etas]
        for i, eta in enumerate(etas):
            inner[i, k] = [Rows(kind, alpha, z).glass(1 / eta) for z in inner_nodes(alpha, 1 / eta)]
    return outer * (1 + MARGIN["outer"]), inner * (1 + MARGIN["inner"])


def coat_tables(kind):
    """What a rough coat reflects and refracts less, (2, INDICES, alphas, angles); the mean of the
    former over diffuse light; and the mean that is reflected from within.
    """
    less = np.zeros((2, INDICES, ALPHAS, COAT_ANGLES))
    mean, within = np.zeros((2, INDICES, ALPHAS))
    places = np.linspace(0, 1, BINS + 1)
    values = interpolation(COAT_ANGLES)
    inner_z = np.linspace(0, 1, 64)  # both ends whole: the quadrature of Mitsuba's roughplastic
    for k, alpha in enumerate(alphas()):
        weight = np.diff(from_t(places, alpha) ** 2)
        inner = [Rows(kind, alpha, max(x, 1e-6)) for x in inner_z]
        for j, x in enumerate(angle_nodes(COAT_ANGLES, alpha)):
            rows = Rows(kind, alpha, x)
            for i, eta in enumerate(indices()):
                smooth = fresnel(x, eta)[0]
                less[:, i, k, j] = np.array([smooth, 1 - smooth]) - rows.coat(eta)
        for i, eta in enumerate(indices()):
            mean[i, k] = weight @ (values @ less[0, i, k])
            within[i, k] = np.mean(
                [2 * x * r.coat(1 / eta)[0] for x, r in zip(inner_z, inner, strict=True)]
            )
    return less, mean, within


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


HEADER = """// Made by generate.py, which says what is in it. Numbers are in units of 2^-15.
#pragma once
#include "../types.h"

// clang-format off
namespace parhelion {

using u16 = unsigned short;
using i16 = short;
"""


def main():
    print(HEADER)
    for name, value in (
        ("kAlphas", ALPHAS),
        ("kMetalAngles", METAL_ANGLES),
        ("kOuterAngles", OUTER_ANGLES),
        ("kInnerAngles", INNER_ANGLES),
        ("kCoatAngles", COAT_ANGLES),
        ("kIndices", INDICES),
        ("kFineIndices", FINE_INDICES),
        ("kSheenAlphas", SHEEN_ALPHAS),
        ("kSheenAngles", SHEEN_ANGLES),
        ("kFilmWavelengths", FILM_WAVELENGTHS),
    ):
        print(f"inline constexpr u32 {name} = {value};")
    print(f"inline constexpr float kLogMaxIndex = {np.log(MAX_INDEX):.9f}f;")
    print(f"inline constexpr float kFilmFirst = {FILM_FIRST}.0f, kFilmStep = {FILM_STEP}.0f;\n")
    metal = [metal_table(k) for k in DISTRIBUTIONS]
    print(text("kMetalEscape", metal, "[distribution][alpha][angle]"))
    outer, inner = zip(*[glass_tables(k) for k in DISTRIBUTIONS], strict=True)
    print(text("kGlassOuter", outer, "[distribution][index][alpha][angle]"))
    print(text("kGlassInner", inner, "[distribution][index][alpha][angle, twice as many]"))
    less, mean, within = zip(*[coat_tables(k) for k in DISTRIBUTIONS], strict=True)
    what = "less {} than by a smooth coat, [distribution][index][alpha][angle]"
    print(text("kCoatReflected", [t[0] for t in less], what.format("reflected")))
    print(text("kCoatRefracted", [t[1] for t in less], what.format("refracted")))
    print(text("kCoatMean", mean, "less reflected of diffuse light, [distribution][index][alpha]"))
    print(text("kCoatWithin", within, "[distribution][index][alpha]"))
    print(text("kSmoothMean", smooth_means(), "[index]"))
    print(text("kSheenAlbedo", sheen_table(), "[alpha, from 1/4][root of the cosine]"))
    print("// Of the spectrum, for linear RGB, [wavelength][channel]")
    print(f"PH_TABLE float kFilmWeights[{3 * FILM_WAVELENGTHS}] = {{")
    for row in film_weights():
        print("  " + " ".join(f"{v:.7f}f," for v in row))
    print("};\n")
    print("}  // namespace parhelion\n// clang-format on")


if __name__ == "__main__":
    main()
