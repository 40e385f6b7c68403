"""What reading files takes: the memory at its peak for each byte of a file, by format.

`python -m bench.reading` writes a file of each format, reads it, and tells its peak beside what
parhelion.io asks for before (TAKEN, ROW_TAKES, COLUMN_TAKES); 1 if a file took more. Linux only.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Bytes of the files that are read before, so that all modules are imported
WARM = 20_000
# Bytes that are taken whatever the size of the file, such as for blocks of text
SLACK = 1 << 23


def main() -> int:
    p = argparse.ArgumentParser(prog="python -m bench.reading", description="Memory of readers.")
    p.add_argument("--size", type=float, default=20.0, metavar="MB", help="of each file")
    p.add_argument("--only", metavar="NAME", nargs="*", default=list(FILES))
    args = p.parse_args()
    too_much = False
    print(f"{'file':12} {'MB':>6} {'taken':>7} {'asked':>7}   times its bytes")
    for name, size, taken, asked in measured(int(args.size * 1e6), args.only):
        more = taken > asked + SLACK
        too_much |= more
        told = f"{size / 1e6:6.1f} {taken / size:7.2f} {asked / size:7.2f}"
        print(f"{name:12} {told}{'   more than asked' if more else ''}", flush=True)
    return int(too_much)


def measured(size: int, names: list[str]) -> list[tuple[str, int, int, int]]:
    """Name, bytes of the file, what reading it took at its peak, and what was asked for before."""
    import parhelion as ph
    from parhelion import memory

    asked: list[int] = []
    real = memory.require

    def require(needed: int, *rest: Any) -> None:
        asked.append(needed)
        real(needed, *rest)

    found = []
    memory.require = require
    try:
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                small, file = Path(folder, f"small-{name}"), Path(folder, name)
                FILES[name](small, WARM)
                FILES[name](file, size)
                ph.load(small)
                asked.clear()
                gc.collect()
                ctypes.CDLL(None).malloc_trim(0)
                Path("/proc/self/clear_refs").write_text("5")
                before = status("VmRSS:")
                scene = ph.load(file)
                taken = status("VmHWM:") - before
                del scene
                found.append((name, file.stat().st_size, taken, max(asked, default=0)))
    finally:
        memory.require = real
    return found


def status(field: str) -> int:
    """Bytes of a field of this process's status."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(field))


# --- Files ---------------------------------------------------------------------------------------


def grid(triangles: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices (V, 3) float32 and faces (F, 3) int32 of a surface with waves."""
    import numpy as np

    n = max(3, int((triangles / 2) ** 0.5) + 1)
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    z = 3 * np.sin(0.1 * x) * np.cos(0.13 * y)
    corner = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    halves = [(0, n, n + 1), (0, n + 1, 1)]
    faces = np.concatenate([np.stack([corner + k for k in half], axis=1) for half in halves])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) * 1.01234
    return vertices.astype(np.float32), faces.astype(np.int32)


def points(count: float) -> NDArray[Any]:
    """(N, 3) in [0, 100)."""
    import numpy as np

    return 100 * np.random.default_rng(1).random((max(3, int(count)), 3))


def rows(values: NDArray[Any], form: str) -> str:
    """A line for each row."""
    return "".join(f"{form % tuple(row)}\n" for row in values.tolist())


def ply(file: Path, size: int) -> None:
    import numpy as np

    vertices, faces = grid(size / 19)
    kind = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    listed = np.empty(len(faces), kind)
    listed["count"], listed["corners"] = 3, faces
    head = ply_head("binary_little_endian", vertices, faces)
    file.write_bytes(head.encode() + vertices.tobytes() + listed.tobytes())


def ply_text(file: Path, size: int) -> None:
    vertices, faces = grid(size / 33)
    head = ply_head("ascii", vertices, faces)
    file.write_text(head + rows(vertices, "%.6g %.6g %.6g") + rows(faces, "3 %d %d %d"))


def ply_head(form: str, vertices: NDArray[Any], faces: NDArray[Any]) -> str:
    coordinates = "".join(f"property float {axis}\n" for axis in "xyz")
    return (
        f"ply\nformat {form} 1.0\nelement vertex {len(vertices)}\n{coordinates}element face"
        f" {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )


def stl(file: Path, size: int) -> None:
    import numpy as np

    vertices, faces = grid(size / 50)
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets = np.zeros(len(faces), kind)
    facets["corners"] = vertices[faces]
    file.write_bytes(b" " * 80 + np.uint32(len(faces)).tobytes() + facets.tobytes())


def stl_text(file: Path, size: int) -> None:
    vertices, faces = grid(size / 150)
    corner = "vertex %.6g %.6g %.6g\n"
    facet = f"facet normal 0 0 1\nouter loop\n{3 * corner}endloop\nendfacet"
    file.write_text(f"solid a\n{rows(vertices[faces].reshape(-1, 9), facet)}endsolid a\n")


def obj(file: Path, size: int) -> None:
    vertices, faces = grid(size / 35)
    file.write_text(rows(vertices, "v %.6g %.6g %.6g") + rows(faces + 1, "f %d %d %d"))


def off(file: Path, size: int) -> None:
    vertices, faces = grid(size / 35)
    head = f"OFF\n{len(vertices)} {len(faces)} 0\n"
    file.write_text(head + rows(vertices, "%.6g %.6g %.6g") + rows(faces, "3 %d %d %d"))


def glb(file: Path, size: int) -> None:
    import parhelion as ph

    mesh = ph.Mesh(*grid(size / 18))
    ph.save(ph.Scene([mesh], camera=ph.Camera(), background=None), file)


def scene_text(file: Path, size: int) -> None:
    centers = points(size / 32).round(6).tolist()
    shapes = [{"type": "spheres", "centers": centers, "radii": 0.1}]
    file.write_text(json.dumps({"parhelion": 1, "shapes": shapes}))


def pbrt(file: Path, size: int) -> None:
    vertices, faces = grid(size / 33)
    file.write_text(
        'WorldBegin\nLightSource "infinite"\nShape "trianglemesh" "point3 P" [\n'
        f'{rows(vertices, "%.6g %.6g %.6g")}] "integer indices" [\n{rows(faces, "%d %d %d")}]\n'
    )


def usd(file: Path, size: int) -> None:
    """Of faces in no order, which cannot be packed."""
    import numpy as np
    from pxr import Usd, UsdGeom, Vt

    each = 44 if file.suffix == ".usda" else 18
    vertices, faces = grid(size / each)
    faces = np.random.default_rng(1).integers(0, len(vertices), faces.shape, np.int32)
    stage = Usd.Stage.CreateNew(str(file))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateSubdivisionSchemeAttr("none")
    stage.Save()


def xyz(file: Path, size: int) -> None:
    places = points(size / 32)
    file.write_text(f"{len(places)}\n\n{rows(places, 'C %.6f %.6f %.6f')}")


def dump(file: Path, size: int) -> None:
    places = points(size / 34)
    box = "ITEM: BOX BOUNDS pp pp pp\n" + 3 * "0 100\n"
    file.write_text(
        f"ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{len(places)}\n{box}"
        f"ITEM: ATOMS id type x y z\n{rows(places, '7 1 %.6g %.6g %.6g')}"
    )


def npz(file: Path, size: int) -> None:
    import numpy as np

    np.savez(file, positions=points(size / 12).astype(np.float32))


def npz_packed(file: Path, size: int) -> None:
    import numpy as np

    np.savez_compressed(file, positions=points(size / 24).round(1))


def gro(file: Path, size: int) -> None:
    places = points(size / 45) / 10
    lines = [
        f"{i // 3 % 100000:5}SOL     OW{i % 100000:5}{x:8.3f}{y:8.3f}{z:8.3f}\n"
        for i, (x, y, z) in enumerate(places.tolist())
    ]
    file.write_text(f"water\n{len(lines)}\n{''.join(lines)}10 10 10\n")


def pdb(file: Path, size: int) -> None:
    lines = [
        f"ATOM  {i % 100000:5}  O   HOH A{i // 3 % 10000:4}    {x:8.3f}{y:8.3f}{z:8.3f}"
        "  1.00  0.00           O\n"
        for i, (x, y, z) in enumerate(points(size / 79).tolist())
    ]
    file.write_text(f"{''.join(lines)}END\n")


def gsd(file: Path, size: int) -> None:
    import numpy as np
    from gsd import hoomd

    frame = hoomd.Frame()
    frame.particles.position = points(size / 12).astype(np.float32) - 50
    frame.particles.N = len(frame.particles.position)
    frame.configuration.box = [100, 100, 100, 0, 0, 0]
    with hoomd.open(str(file), "w") as written:
        written.append(frame)


# Name of a file -> what writes one of about so many bytes
FILES: dict[str, Callable[[Path, int], None]] = {
    "a.ply": ply,
    "text.ply": ply_text,
    "a.stl": stl,
    "text.stl": stl_text,
    "a.obj": obj,
    "a.off": off,
    "a.glb": glb,
    "a.json": scene_text,
    "a.pbrt": pbrt,
    "a.usdc": usd,
    "a.usda": usd,
    "a.xyz": xyz,
    "a.dump": dump,
    "a.npz": npz,
    "packed.npz": npz_packed,
    "a.gro": gro,
    "a.pdb": pdb,
    "a.gsd": gsd,
}

if __name__ == "__main__":
    sys.exit(main())
