"""How far the tables' interpolated values are from the integrals that they stand for.

    python measure.py [draws]    draws of roughness, angle and index a row, 400 by default

A line a row, in %, of energy: the mean error of a white surface's albedo, its least and greatest,
and what 95 of 100 draws stay within; then the worst draw. The integrals are those of generate.py,
on more normals. Numbers are those of the file, interpolated as by the renderer, but in float64.
"""

import re
import sys
from pathlib import Path

import generate as g
import numpy as np

FINE_LATTICE = 75025, 46368


def tables():
    text = Path(__file__).with_name("microfacet.h").read_text()
    return {
        name: np.array([int(n) for n in re.findall(r"-?\d+", body)]) / g.UNIT
        for name, body in re.findall(r"PH_TABLE [ui]16 (\w+)\[\d+\] = \{(.*?)\};", text, re.S)
    }


def weights(x, count):
    """Places and weights (..., 4) of the nodes around x in [0, 1]."""
    x = np.clip(x, 0, 1)[..., None] * (count - 1)
    first = np.clip(x.astype(int) - 1, 0, count - 4)
    nodes = np.arange(4)
    weight = [
        np.prod([(x[..., 0] - first[..., 0] - j) / (i - j) for j in nodes if j != i], axis=0)
        for i in nodes
    ]
    return first + nodes, np.stack(weight, axis=-1)


def at(table, *places):
    """Interpolated along the first dimensions, at one place each."""
    for x in places:
        nodes, weight = weights(np.asarray(x), len(table))
        table = np.tensordot(weight, table[nodes], 1)
    return table


def along(table, *places):
    """At many places (N,) in all dimensions."""
    found = [weights(x, n) for x, n in zip(places, table.shape, strict=True)]
    if len(found) == 1:
        return np.sum(table[found[0][0]] * found[0][1], axis=1)
    (i, a), (j, b) = found
    return np.einsum("nij,ni,nj->n", table[i[:, :, None], j[:, None, :]], a, b)


def index_place(index):
    return (np.log(index) / np.log(g.MAX_INDEX)) ** 0.25


def metal(table, kind, alpha, o):
    row = at(table, np.sqrt(alpha))
    rows = g.Rows(kind, (alpha, alpha), o)
    up = np.clip(rows.mirrored[:, 2], 0, 1)
    gain = 1 / along(row, g.to_t(up, alpha)) / at(row, g.to_t(o[2], alpha))
    return np.mean(rows.reflected() * gain)


def stretched(table, kind, alphas, o):
    u, v = alphas
    page = at(table, np.sqrt(u), np.sqrt(v / u))
    low, high = v**0.25, u**0.25

    def escape(w):
        flat = np.maximum(np.hypot(w[:, 0], w[:, 1]), 1e-12)
        slope = np.hypot(u * w[:, 0] / flat, v * w[:, 1] / flat)
        place = (slope**0.25 - low) / (high - low)
        return along(page, place, g.to_t(np.clip(w[:, 2], 0, 1), slope))

    rows = g.Rows(kind, alphas, o)
    return np.mean(rows.reflected() / escape(rows.mirrored)) / escape(o[None])[0]


def report(name, draws):
    errors = np.array([d[0] for d in draws]) * 100
    what = draws[np.argmax(np.abs(errors))][1]
    print(
        f"{name:34} mean {errors.mean():+.3f}  {errors.min():+.3f} to {errors.max():+.3f}"
        f"  95 % {np.quantile(np.abs(errors), 0.95):.3f}  worst at "
        + ", ".join(f"{k} {v:.4g}" for k, v in what.items()),
        flush=True,
    )


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    g.LATTICE = FINE_LATTICE
    t = tables()
    escape = t["kMetalEscape"].reshape(2, g.METAL_ALPHAS, -1)
    bent = t["kStretchedEscape"].reshape(2, *g.STRETCHED)
    outer = t["kGlassOuter"].reshape(2, g.INDICES, g.OUTER_ALPHAS, -1)
    inner = t["kGlassInner"].reshape(2, g.INNER_INDICES, g.INNER_ALPHAS, -1)
    coat = t["kCoatReflected"].reshape(2, g.INDICES, g.COAT_ALPHAS, -1)
    for d, kind in enumerate(g.DISTRIBUTIONS):
        random = np.random.default_rng(1)
        found = {}

        def add(name, error, found=found, **what):
            found.setdefault(name, []).append((error, what))

        for k in range(count):
            roughness, cosine = random.uniform(0.03, 1), random.uniform(0.05, 1) ** 1.5
            alpha, o = roughness**2, g.direction(cosine)
            where = {"roughness": roughness, "cosine": cosine}
            if k % 4 == 0:  # as long to compute as the rest together
                a = random.uniform(-0.99, 0.99)
                q = np.sqrt((1 - abs(a)) / (1 + abs(a)))
                u, v = min(alpha / q, 1), alpha * q
                w = g.direction(cosine, np.sin(random.uniform(0, np.pi / 2)))
                share = stretched(bent[d], kind, (u, v), w)
                add("stretched metal", share - 1, **where, anisotropy=a, across=w[1])
            add("metal", metal(escape[d], kind, alpha, o) - 1, **where)
            for span, ends in (
                ("1.0 to 1.02", (1e-3, 0.02)),
                ("1.02 to 1.2", (0.02, 0.2)),
                ("1.2 to 10", (0.2, 9.0)),
            ):
                index = 1 + np.exp(random.uniform(*np.log(ends)))
                rows = g.Rows(kind, (alpha, alpha), o)
                place = index_place(index), np.sqrt(alpha), g.to_t(cosine, alpha)
                where["index"] = index
                share = sum(rows.bounces(index)) / at(outer[d], *place)
                add(f"glass from outside, {span}", share - 1, **where)
                inside = g.inner_place(cosine, alpha, 1 / index)
                share = sum(rows.bounces(1 / index)) / at(inner[d], *place[:2], inside)
                add(f"glass from inside, {span}", share - 1, **where)
                smooth = g.fresnel(np.hypot(cosine, alpha * np.sqrt(1 - cosine**2)), index)[0]
                share = rows.bounces(index, False)[0] - (smooth - at(coat[d], *place))
                add(f"coat, {span}", share, **where)
        for name, draws in found.items():
            report(f"{kind} {name}", draws)


if __name__ == "__main__":
    main()
