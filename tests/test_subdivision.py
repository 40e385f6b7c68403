"""Subdivision of triangles: what the limit surface must be, by other means."""

from __future__ import annotations

import numpy as np
import pytest

from parhelion import subdivision
from parhelion.errors import SceneError
from parhelion.io.meshes import smooth_normals

_OCTAHEDRON = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64
)
_SIDES = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
)


def warren(
    points: np.ndarray, faces: np.ndarray, levels: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and vertices' normals, of some corner each, as pbrt's loopsubdiv has them."""
    made = subdivision.subdivide(
        points,
        np.full(len(faces), 3),
        np.ravel(faces),
        levels=levels,
        scheme="warren",
        sharp_boundary_corners=False,
    )
    normals = np.zeros_like(made.points)
    normals[made.faces.ravel()] = made.normals.reshape(-1, 3)
    return made.points, made.faces, normals


def _sheet(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat square of n by n fields, each two triangles."""
    y, x = (a.ravel() for a in np.meshgrid(*(np.linspace(0, 1, n + 1),) * 2, indexing="ij"))
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    a, b, c, d = corner, corner + 1, corner + n + 2, corner + n + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, y, 0 * x], 1), faces


@pytest.mark.parametrize("shape", ["octahedron", "bent sheet"])
def test_the_limit_is_the_same_from_every_level(shape: str) -> None:
    """A vertex and its normal are what they are, however often the mesh was refined before."""
    points, faces = (_OCTAHEDRON, _SIDES) if shape == "octahedron" else _sheet(3)
    points = points + 0.2 * np.random.default_rng(1).normal(size=points.shape)
    first, _, normals = warren(points, faces, 0)
    for level in (1, 3):
        again, _, more = warren(points, faces, level)
        np.testing.assert_allclose(again[: len(first)], first, atol=1e-12)
        inside = slice(None) if shape == "octahedron" else [5, 6, 9, 10]  # of 4 by 4
        np.testing.assert_allclose(more[: len(first)][inside], normals[inside], atol=1e-9)


def test_counts_and_outward_normals_of_a_closed_mesh() -> None:
    points, faces, normals = warren(_OCTAHEDRON, _SIDES, 3)
    assert faces.shape == (8 * 64, 3)
    assert len(points) == 4 * 64 + 2  # Euler: V = F / 2 + 2
    radius = np.linalg.norm(points, axis=1)
    assert 0.3 < radius.min() < radius.max() < 0.8  # a ball within the octahedron
    across = np.einsum("vi,vi->v", normals, points) / radius
    assert across.min() > 0.95
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)


def test_normals_are_those_of_the_fine_mesh() -> None:
    points = _OCTAHEDRON * (1.0, 2.0, 3.0)
    vertices, faces, normals = warren(points, _SIDES, 5)
    angle = np.arccos(
        np.clip(np.einsum("vi,vi->v", normals, smooth_normals(vertices, faces)), -1, 1)
    )
    # at vertices of valence 4 the curvature has no bound, and neighbours differ by degrees
    assert np.degrees(np.median(angle)) < 0.05
    assert np.degrees(angle.max()) < 3.0


def test_a_flat_sheet_stays_flat_and_in_its_outline() -> None:
    points, faces = _sheet(4)
    vertices, _, normals = warren(points, faces, 2)
    assert np.abs(vertices[:, 2]).max() == 0.0
    assert vertices.min() >= 0.0
    assert vertices.max() <= 1.0
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (len(normals), 1)), atol=1e-12)


def test_three_faces_on_one_edge_and_fans_that_touch() -> None:
    """No surface, but an answer: finite points, and normals of length 1 or 0."""
    points = np.array(
        [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0.5], [0, 1, 0], [2, 2, 2], [3, 2, 2]]
    )
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 5, 6]])
    vertices, _, normals = warren(points, faces, 2)
    assert np.isfinite(vertices).all()
    assert set(np.linalg.norm(normals, axis=1).round(9).tolist()) <= {0.0, 1.0}


def test_normals_of_loop_near_those_of_the_fine_mesh() -> None:
    """At vertices of the coarse mesh, whose normals the fine one has to within its own facets."""
    points = _OCTAHEDRON * (1.0, 2.0, 3.0)
    corners = np.full(8, 3), _SIDES.ravel()
    first = subdivision.subdivide(points, *corners, levels=1, scheme="loop")
    fine = subdivision.subdivide(points, *corners, levels=6, scheme="loop")
    for vertex in range(len(first.points)):
        own = first.normals.reshape(-1, 3)[first.faces.ravel() == vertex]
        np.testing.assert_allclose(own, np.tile(own[:1], (len(own), 1)))
        a, b, c = (
            fine.points[fine.faces[(fine.faces == vertex).any(axis=1)][:, k]] for k in range(3)
        )
        facets = np.cross(b - a, c - a).sum(axis=0)
        assert own[0] @ facets / np.linalg.norm(facets) > np.cos(np.radians(0.5))


def test_too_many_faces_are_refused_before_they_are_made() -> None:
    with pytest.raises(SceneError, match="8 faces, subdivided 30 times"):
        warren(_OCTAHEDRON, _SIDES, 30)


def test_a_budget_is_shared_by_the_meshes_that_come() -> None:
    """Each takes at most half of what is left: 4^3 of 128, then 4^2 of 64, then of 48."""
    budget = subdivision.Budget(128)
    assert budget.report() == ""
    assert [budget.levels(1, 100) for _ in range(3)] == [3, 2, 2]
    assert budget.levels(10**9, 2**40) == 0
    assert budget.levels(1, 5, least=1) == 1
    assert "5 meshes are subdivided up to 1099511627776 times less" in budget.report()
    assert "at most 128 triangles" in budget.report()


def test_meshes_that_are_known_get_equally_many_levels_fewer() -> None:
    """A hundred of 4^5 triangles each are 102,400; two levels fewer make 6400, of 16,000 at most
    8000. What comes more often than was known has the rest.
    """
    budget = subdivision.Budget(16_000, [(1, 5)] * 100)
    assert {budget.levels(1, 5) for _ in range(100)} == {3}
    assert "100 meshes are subdivided up to 2 times less" in budget.report()
    more = [budget.levels(1, 5) for _ in range(1000)]
    assert max(more) == 3
    assert sum(4**level for level in more if level) < 9600
    few = subdivision.Budget(16_000, [(1, 5)] * 7)
    assert {few.levels(1, 5) for _ in range(7)} == {5}
    assert few.report() == ""
