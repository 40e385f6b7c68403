"""Objects of other libraries, and what stands in for them where they are not installed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import parhelion as ph

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]])


def first(thing: Any, **options: Any) -> Any:
    scene = ph.scene_of(thing, **options)
    ph.prepare(scene)
    return scene.shapes[0]


def test_a_picture_of_positions() -> None:
    positions = np.random.default_rng(0).uniform(0, 4, (50, 3))
    image = ph.render(positions, width=32, height=24, spp=4)
    assert image.numpy().shape == (24, 32, 3)
    assert image.numpy().std() > 0.05
    for given in (positions.tolist(), (positions * 10).astype(int), positions.astype(np.float32)):
        assert len(first(given).centers) == 50
    assert first(positions, radius=0.25).radii[0] == 0.25
    red = np.asarray(first(positions, color_by="x", colormap="gray").colors)[:, 0]
    assert np.all(np.diff(red[np.argsort(positions[:, 0])]) >= 0)
    assert np.ptp(red) > 0.9


def test_own_scenes_and_shapes() -> None:
    ball = ph.Spheres([[0, 0, 0]], 1.0)
    scene = ph.Scene([ball])
    assert ph.scene_of(scene) is scene
    assert ph.scene_of(ball).shapes[0] is ball
    assert [s.name for s in ph.scene_of([ball], ground=True).shapes] == [
        "spheres",
        "key light",
        "ground",
    ]
    made = ph.scene_of(scene, view="top")
    assert isinstance(made.camera, ph.Framing)
    assert made.camera.direction == (0, 1, 0)


def test_a_path(tmp_path: Any) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("1\n\nC 0 0 0\n")
    assert len(first(path).centers) == 1
    assert ph.render(str(path), width=8, height=8, spp=1).numpy().shape == (8, 8, 3)


def test_ase() -> None:
    ase = pytest.importorskip("ase")
    atoms = ase.Atoms("OH2", positions=[[0, 0, 0], [0, 0.76, 0.59], [0, -0.76, 0.59]])
    cloud = first(atoms)
    np.testing.assert_allclose(cloud.radii, [1.52, 1.2, 1.2])
    atoms.arrays["charge"] = np.array([-0.8, 0.4, 0.4])
    by_charge = first(atoms, color_by="charge").colors
    np.testing.assert_array_equal(by_charge[1], by_charge[2])
    assert np.any(by_charge[0] != by_charge[1])


class Atoms(SimpleNamespace):
    """What of an AtomGroup is used."""

    def __len__(self) -> int:
        return len(self.positions)


def test_mdanalysis_like() -> None:
    atoms = Atoms(
        positions=CORNERS.astype(np.float32),
        elements=np.array(["C", "O"] * 4, object),
        names=np.array(["CA", "O"] * 4, object),
        charges=np.arange(8.0),
        resnames=np.array(["ALA"] * 8, object),
    )
    atoms.atoms = atoms
    cloud = first(SimpleNamespace(atoms=atoms))
    np.testing.assert_allclose(cloud.radii[:2], [1.7, 1.52])
    assert len(np.unique(first(atoms, color_by="charges").colors, axis=0)) == 8
    assert len(np.unique(first(atoms, color_by="resnames").colors, axis=0)) == 1


class Table(dict[str, Any]):
    """As pyvista's data of points: keys, but no iteration over them is relied upon."""


def polydata(faces: Any, **more: Any) -> Any:
    """What of pyvista's PolyData is used."""
    padded = np.concatenate([np.full((len(faces), 1), 3), faces], axis=1).ravel()
    data = SimpleNamespace(points=CORNERS, n_points=8, faces=padded, point_data=Table(more))
    data.triangulate = lambda: data
    data.cell_data = Table(level=np.arange(len(faces)))
    return data


def test_pyvista_like() -> None:
    mesh = first(polydata(FACES))
    assert len(mesh.faces) == 4
    height = first(polydata(FACES, height=CORNERS[:, 2]), color_by="height")
    colors = height.attributes["vertex_color"]
    assert len(np.unique(colors, axis=0)) == 2
    by_cell = first(polydata(FACES), color_by="level", colormap="magma")
    assert len(np.unique(by_cell.attributes["face_color"], axis=0)) == 4
    with pytest.raises(ph.SceneError, match="unknown field to colour by 'levl'; did you mean"):
        first(polydata(FACES), color_by="levl")
    with pytest.raises(ph.SceneError, match="the option 'radius' is for particles"):
        first(polydata(FACES), radius=1.0)
    cloud = first(polydata(np.empty((0, 3), int), size=np.arange(8.0)), color_by="size")
    assert len(cloud.centers) == 8


def test_pyvista() -> None:
    pyvista = pytest.importorskip("pyvista")
    ball = pyvista.Sphere(theta_resolution=12, phi_resolution=12)
    assert len(first(ball).faces) == ball.n_cells
    grid = pyvista.ImageData(dimensions=(3, 3, 3)).cast_to_unstructured_grid()
    assert len(first(grid).faces) == 2 * 6 * 4


def test_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    assert len(first(box).faces) == 12
    box.visual.face_colors = [255, 0, 0, 255]
    np.testing.assert_array_equal(first(box).attributes["face_color"], [[1, 0, 0]] * 12)
    scene = trimesh.Scene([box, trimesh.creation.icosphere(subdivisions=1)])
    made = ph.scene_of(scene)
    assert sum(isinstance(s, ph.Mesh) for s in made.shapes) == 2


def test_meshio_like() -> None:
    cells = [
        SimpleNamespace(type="triangle", data=FACES),
        SimpleNamespace(type="quad", data=np.array([[0, 1, 5, 4]])),
        SimpleNamespace(type="line", data=np.array([[0, 1]])),
    ]
    thing = SimpleNamespace(points=CORNERS, cells=cells, cell_data={}, point_data={})
    assert len(first(thing).faces) == 6
    thing.cells = cells[2:]
    with pytest.raises(ph.SceneError, match="has no triangles or quadrilaterals; it has line"):
        ph.scene_of(thing)


@pytest.mark.parametrize(
    ("thing", "words"),
    [
        (object(), "an object of type builtins.object cannot be rendered"),
        (None, "an object of type builtins.NoneType cannot be rendered"),
        (3.5, "an object of type builtins.float cannot be rendered"),
        (np.zeros((4, 2)), r"positions have shape \(4, 2\), not \(N, 3\)"),
        (np.zeros((0, 3)), "there are no particles"),
        (np.full((4, 3), np.nan), r"particle 0: position \(nan nan nan\) is not finite"),
        (["a", "b"], r"positions must be \(N, 3\) numbers"),
        ([[1, 2, 3], [4, 5]], r"positions must be \(N, 3\) numbers"),
        (
            SimpleNamespace(vertices=CORNERS, faces=[[0, 1, 9]]),
            "face 0 refers to vertex 9; it has 8",
        ),
        (SimpleNamespace(vertices=CORNERS, faces=[[0.0, 1, 2]]), r"faces are float64 of shape"),
        (SimpleNamespace(vertices=CORNERS[:, :2], faces=FACES), r"vertices have shape \(8, 2\)"),
    ],
)
def test_refused(thing: Any, words: str) -> None:
    with pytest.raises(ph.SceneError, match=words):
        ph.render(thing)


def test_unknown_option() -> None:
    with pytest.raises(ph.SceneError, match="unexpected keyword argument 'colour_by'"):
        ph.scene_of(CORNERS, colour_by="x")


def test_options_that_an_object_has_no_use_for_are_refused() -> None:
    with pytest.raises(ph.SceneError, match="'time' is not for objects of type list"):
        ph.scene_of([[0.0, 0.0, 0.0]], time=3.0)
    with pytest.raises(ph.SceneError, match="'color_by' is not for objects of type Scene"):
        ph.scene_of(ph.weekend(), color_by="x")


def test_textured_meshes_of_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    image = pytest.importorskip("PIL.Image")
    picture = image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8))
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, metallicFactor=0.25, roughnessFactor=0.5
    )
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 1]], material=material)
    mesh = trimesh.Trimesh(np.eye(3), [[0, 1, 2]], visual=visual, process=False)
    (made,) = (s for s in ph.scene_of(mesh).shapes if isinstance(s, ph.Mesh))
    np.testing.assert_array_equal(made.uvs, [[0, 0], [1, 0], [0, 1]])
    params = made.material.params
    assert (params["metallic"], params["roughness"]) == (0.25, 0.5)
    np.testing.assert_array_equal(params["color"].params["image"], np.asarray(picture))
