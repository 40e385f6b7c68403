"""Objects of other libraries, and what stands in for them where they are not installed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import is_encoded, read_pixels

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


def test_what_a_calculator_of_ase_knows() -> None:
    ase = pytest.importorskip("ase")
    from ase.calculators.singlepoint import SinglePointCalculator

    atoms = ase.Atoms("OH2", positions=[[0, 0, 0], [0, 0.76, 0.59], [0, -0.76, 0.59]])
    forces = np.array([[0, 0, 3.0], [0, 0, 0], [4.0, 0, 0]])
    atoms.calc = SinglePointCalculator(atoms, energy=1.0, forces=forces)
    bar = ph.scene_of(atoms, color_by="forces", color_range=(0, 5)).legend
    assert isinstance(bar, ph.ColorBar)
    assert len(np.unique(first(atoms, color_by="forces").colors, axis=0)) == 3
    np.testing.assert_allclose(first(atoms[0]).centers, [[0, 0, 0]])
    np.testing.assert_allclose(first(atoms[0]).radii, [1.52])


def test_frames_of_ase() -> None:
    ase = pytest.importorskip("ase")
    images = [ase.Atoms("CO", positions=[[0, 0, 0], [0, 0, 1.1 + k]]) for k in range(4)]
    with pytest.raises(ph.SceneError, match=r"a list of 4 Atoms is a trajectory: frames_of\(\)"):
        ph.render(images)
    frames = ph.frames_of(images, "1::2", fps=12, up="x", ground=True)
    assert (list(frames.numbers), frames.fps) == ([1, 3], 12)
    for scene, number in zip(frames, (1, 3), strict=True):
        assert [s.name for s in scene.shapes] == ["particles", "key light", "ground"]
        np.testing.assert_allclose(scene.shapes[0].centers[1][2], 1.1 + number)
        assert scene.camera == next(iter(frames)).camera
        assert scene.camera.up == (1, 0, 0)
        assert scene.name == f"list, frame {number}"
    for thing in (images[0], images[0].positions, [images[0].positions], "a.xyz"):
        with pytest.raises(ph.SceneError, match="has no frames"):
            ph.frames_of(thing)
    with pytest.raises(ph.SceneError, match="of 4 frames none is in 9:"):
        ph.frames_of(images, "9:")


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


def test_mdanalysis() -> None:
    mda = pytest.importorskip("MDAnalysis")
    universe = mda.Universe.empty(
        4, n_residues=2, atom_resindex=[0, 0, 1, 1], residue_segindex=[0, 0], trajectory=True
    )
    universe.add_TopologyAttr("names", ["CA", "CB", "CA", "CA"])
    universe.add_TopologyAttr("resnames", ["ALA", "CA"])
    universe.add_TopologyAttr("chainIDs", ["A", "A", "B", "B"])
    steps = np.arange(3)[:, None, None] + 2.0 * np.arange(4)[:, None] * [1, 0, 0]
    universe.load_new(steps, dimensions=np.tile([20, 20, 20, 90, 90, 90], (3, 1)))
    # carbon by the names of an amino acid's atoms, calcium where it is a residue by itself
    np.testing.assert_allclose(first(universe, radius="covalent").radii, [0.76, 0.76, 1.76, 1.76])
    legend = ph.scene_of(universe, color_by="chain").legend
    assert isinstance(legend, ph.Swatches)
    assert [name for name, _ in legend.kinds] == ["A", "B"]
    assert ph.scene_of(universe, color_by="residue").legend.label == "residue"
    assert len(ph.scene_of(universe.select_atoms("chainID B"), box=True).shapes) == 4
    universe.trajectory[1]
    frames = ph.frames_of(universe.atoms, "::2")
    centers = [scene.shapes[0].centers[0][0] for scene in frames]
    np.testing.assert_allclose(centers, [0, 2])
    assert universe.trajectory.frame == 1


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
    assert len(first(ball.strip()).faces) == ball.n_cells
    assert len(first(pyvista.PointSet(CORNERS)).centers) == 8


def test_lines_and_points_of_pyvista() -> None:
    pyvista = pytest.importorskip("pyvista")
    line = pyvista.Line(resolution=4)
    line.point_data["a"] = np.arange(5.0)
    line.cell_data["b"] = [7.0]
    tube = first(line, color_by="a", color_range=(0.5, 3.5), colormap="gray")
    assert isinstance(tube, ph.Curves)
    assert len(tube.points) == 5
    np.testing.assert_allclose(tube.radii, 0.004)
    red = np.asarray(tube.colors)[:, 0]  # of the segments, from 0.5 to 3.5
    assert (red[0], red[3]) == (pytest.approx(0, abs=1e-3), pytest.approx(1, abs=1e-3))
    assert np.all(np.diff(red) > 0)
    assert ph.scene_of(line, color_by="b").legend.low == 7.0
    assert first(line, radius=0.25).radii == 0.25
    with pytest.raises(ph.SceneError, match="the option 'style' is for particles; these are lines"):
        first(line, style="licorice")
    both = pyvista.Sphere() + pyvista.PolyData(CORNERS * 3)
    ball, dots = ph.scene_of(both).shapes[:2]
    assert (len(ball.faces), len(dots.centers)) == (1680, 8)
    both.cell_data["c"] = np.where(np.arange(1688) < 8, 9.0, np.arange(1688) == 10)
    white = np.asarray(
        first(both, color_by="c", colormap="gray", color_range=(0, 1)).attributes["face_color"]
    )[:, 0]  # the first cells are the points
    assert np.flatnonzero(white > 0.5).tolist() == [2]
    quads = pyvista.Plane(i_resolution=2, j_resolution=1) + pyvista.Line(
        (5, 0, 0), (6, 0, 0), resolution=3
    )
    quads.cell_data["c"] = [1.0, 0.0, 1.0]
    plane, line = ph.scene_of(quads, color_by="c", colormap="gray", color_range=(0, 1)).shapes[:2]
    assert np.asarray(plane.attributes["face_color"])[:, 0].round().tolist() == [0, 0, 1, 1]
    assert np.asarray(line.colors)[:, 0].round().tolist() == [1, 1, 1]


class Blocks(list[Any]):
    """What of a MultiBlock is used."""

    @property
    def n_blocks(self) -> int:
        return len(self)

    def get_block_name(self, k: int) -> str:
        return f"b{k}"


def test_blocks_like_those_of_pyvista() -> None:
    line = SimpleNamespace(points=CORNERS, n_points=8, lines=[2, 0, 1, 3, 1, 2, 3], point_data={})
    line.cell_data = Table(level=np.array([5.0, 7.0]))
    empty = SimpleNamespace(points=np.empty((0, 3)), n_points=0, point_data=Table())
    rgb = np.tile(np.array([[255, 0, 0]], np.uint8), (8, 1))
    blocks = Blocks([polydata(FACES, RGB=rgb), None, Blocks([line, empty])])
    mesh, tubes = ph.scene_of(blocks).shapes[:2]
    assert (mesh.name, tubes.name) == ("b0", "b0")
    np.testing.assert_array_equal(mesh.attributes["vertex_color"], np.tile([1.0, 0, 0], (8, 1)))
    np.testing.assert_array_equal(tubes.counts, [2, 3])
    colored = ph.scene_of(blocks, color_by="level", colormap="gray")
    assert colored.legend == ph.ColorBar(
        "level", "gray", *np.percentile([0, 1, 2, 3, 5, 7], (1, 99))
    )
    assert len(np.unique(colored.shapes[1].colors, axis=0)) == 2


class Molecule(SimpleNamespace):
    """What of ASE's Atoms is used."""

    def __len__(self) -> int:
        return 2

    def get_positions(self) -> Any:
        return [[0, 0, 0], [0, 0, self.length]]

    def get_chemical_symbols(self) -> list[str]:
        return ["C", "O"]

    def get_cell(self) -> Any:
        return np.zeros((3, 3))

    def get_pbc(self) -> Any:
        return (False,) * 3


def test_frames_of_what_is_like_ase() -> None:
    images = [Molecule(length=1.0 + k, arrays={}) for k in range(3)]
    lengths = [scene.shapes[0].centers[1][2] for scene in ph.frames_of(images)]
    np.testing.assert_array_equal(lengths, [1, 2, 3])
    with pytest.raises(ph.SceneError, match="a list of 3 Atoms is a trajectory"):
        ph.scene_of(images)


def test_blocks_of_pyvista() -> None:
    pyvista = pytest.importorskip("pyvista")
    ball, dots = pyvista.Sphere(), pyvista.PolyData(np.tile(CORNERS, (100, 1)))
    ball.point_data["h"] = ball.points[:, 2]  # up to 0.5
    dots.point_data["h"] = 10 * dots.points[:, 2]
    inner = pyvista.MultiBlock([None, pyvista.ImageData(dimensions=(2, 2, 2)), pyvista.PolyData()])
    blocks = pyvista.MultiBlock({"ball": ball, "dots": dots, "inner": inner})
    shapes = ph.scene_of(blocks, ground=False).shapes[:-1]  # without the light
    assert [type(shape) for shape in shapes] == [ph.Mesh, ph.Spheres, ph.Mesh]
    assert shapes[0].name == "ball"
    colored = ph.scene_of(blocks, color_by="h", colormap="gray")
    assert isinstance(colored.legend, ph.ColorBar)
    assert colored.legend.high > 9  # of all blocks together
    assert np.asarray(colored.shapes[0].attributes["vertex_color"]).max() < 0.1
    assert colored.shapes[2].material.params.keys() == ph.Material("diffuse").params.keys()
    with pytest.raises(ph.SceneError, match=r"unknown field .* 'g' \(choices: .*h"):
        ph.scene_of(blocks, color_by="g")
    with pytest.raises(ph.SceneError, match="the MultiBlock holds nothing that can be seen"):
        ph.scene_of(pyvista.MultiBlock([None]))


def test_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box()
    assert len(first(box).faces) == 12
    box.visual.face_colors = [255, 0, 0, 255]
    np.testing.assert_array_equal(first(box).attributes["face_color"], [[1, 0, 0]] * 12)
    scene = trimesh.Scene([box, trimesh.creation.icosphere(subdivisions=1)])
    made = ph.scene_of(scene)
    assert sum(isinstance(s, ph.Mesh) for s in made.shapes) == 2
    made = ph.scene_of([box, trimesh.creation.icosphere(subdivisions=1)])
    assert sum(isinstance(s, ph.Mesh) for s in made.shapes) == 2
    with pytest.raises(ph.SceneError, match="the Trimesh holds nothing that can be seen"):
        ph.scene_of(trimesh.Trimesh())


def test_clouds_and_paths_of_trimesh() -> None:
    trimesh = pytest.importorskip("trimesh")
    colors = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]], np.uint8)
    cloud = trimesh.PointCloud(np.eye(3), colors=colors)
    np.testing.assert_array_equal(first(cloud).colors, np.eye(3))
    assert len(first(trimesh.PointCloud(np.eye(3))).centers) == 3
    path = trimesh.load_path(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1.0]]))
    tube = first(path, radius=0.1)
    assert isinstance(tube, ph.Curves)
    np.testing.assert_array_equal(tube.points, path.vertices)
    voxels = trimesh.creation.box().voxelized(0.5)
    assert len(first(voxels).faces) == 12 * voxels.filled_count
    path.entities[0].color = [255, 0, 0, 255]
    np.testing.assert_array_equal(first(path).colors, [[1, 0, 0]] * 2)
    flat = trimesh.load_path(np.array([[0, 0], [1, 0], [1, 1.0]]))
    assert np.asarray(first(flat).points).shape == (3, 3)
    scene = trimesh.Scene([cloud, path, trimesh.creation.box()])
    kinds = [type(shape) for shape in ph.scene_of(scene, ground=False).shapes[:-1]]
    assert sorted(kinds, key=str) == sorted([ph.Spheres, ph.Curves, ph.Mesh], key=str)


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
        (
            SimpleNamespace(vertices=CORNERS, faces=[[0, 1, 2], [0, 1]]),
            r"^SimpleNamespace: faces are no \(F, 3\) indices: not all are of one length",
        ),
    ],
)
def test_refused(thing: Any, words: str) -> None:
    with pytest.raises(ph.SceneError, match=words):
        ph.render(thing)


def test_lists_without_end() -> None:
    box = SimpleNamespace(vertices=CORNERS, faces=FACES)
    round: list[Any] = [box]
    round.append(round)
    deep: list[Any] = [box]
    for _ in range(3000):
        deep = [box, deep]
    for things in (round, deep):
        with pytest.raises(ph.SceneError, match="lists of objects lie more than 32 deep"):
            ph.scene_of(things)
    assert len(ph.scene_of([box, [box, [box]]], ground=False).shapes) == 4  # with the key light


def test_own_shapes_among_others() -> None:
    box = SimpleNamespace(vertices=CORNERS, faces=FACES)
    ball = ph.Spheres([[0, 0, 3]], 0.5)
    for things in ([ball, box], [box, ball]):
        scene = ph.scene_of(things)
        assert ball in scene.shapes
        assert {type(shape) for shape in scene.shapes[:2]} == {ph.Spheres, ph.Mesh}
        ph.prepare(scene)
    with pytest.raises(ph.SceneError, match="unknown field to colour by 'x'"):
        ph.scene_of([ball, box], color_by="x")


def test_a_panorama_that_is_not_there(tmp_path: Any) -> None:
    scene = ph.scene_of(CORNERS, environment=tmp_path / "nope.hdr")
    with pytest.raises(ph.SceneError, match=r"nope\.hdr: no such file$"):
        ph.prepare(scene)


def test_unknown_option() -> None:
    with pytest.raises(ph.SceneError, match="unknown option 'colour_by'; did you mean 'color_by'"):
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


def test_materials_of_trimesh_are_those_of_the_file(tmp_path: Any) -> None:
    trimesh = pytest.importorskip("trimesh")
    image = pytest.importorskip("PIL.Image")
    rng = np.random.default_rng(3)

    def picture(channels: int = 3) -> Any:
        return image.fromarray(rng.integers(1, 255, (4, 4, channels)).astype(np.uint8))

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture(4),
        baseColorFactor=[204, 255, 102, 255],
        metallicRoughnessTexture=picture(),
        roughnessFactor=0.6,
        normalTexture=picture(),
        emissiveTexture=picture(),
        emissiveFactor=[0.5, 1.0, 0.25],
        occlusionTexture=picture(),
        alphaMode="MASK",
        alphaCutoff=0.5,
    )
    uv = [[0, 0], [1, 0], [0, 1], [1, 1]]
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.2]],
        [[0, 1, 2], [2, 1, 3]],
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        process=False,
    )
    mesh.export(tmp_path / "a.glb")
    ours = ph.scene_of(mesh, up="y").shapes[0].material
    theirs = next(iter(ph.load(tmp_path / "a.glb").materials.values()))
    assert ours.params.keys() == theirs.params.keys()
    for name in ("color", "metallic", "roughness", "normal_map", "emission"):
        same(ours.params[name], theirs.params[name])
    holes = ours.params["opacity"].params["image"][:, :, 0]
    alpha = np.asarray(material.baseColorTexture)[:, :, 3]
    np.testing.assert_array_equal(holes, np.where(alpha >= 127.5, 255, 0))
    assert any(s.name == "key light" for s in ph.scene_of(mesh).shapes)  # it glows, but is no lamp


def same(a: Any, b: Any) -> None:
    """Compares numbers, colours and textures; of pictures the channels that both have."""
    if not isinstance(a, ph.Texture):
        assert a == pytest.approx(b, abs=1e-6)
        return
    assert a.type == b.type
    if a.type == "image":
        images = [t.params["image"] for t in (a, b)]
        one, other = ((read_pixels(x) if is_encoded(x) else x)[:, :, :3] for x in images)
        np.testing.assert_array_equal(one, other)
        assert a.params["color_space"] == b.params["color_space"]
        assert a.params.get("channel", "rgb") == b.params["channel"]
    else:
        same(a.params["color0"], b.params["color0"])
        same(a.params["color1"], b.params["color1"])


@pytest.mark.parametrize(("mode", "expected"), [("BLEND", 0.4), ("OPAQUE", None), ("MASK", 0.0)])
def test_factors_alone(mode: str, expected: float | None) -> None:
    trimesh = pytest.importorskip("trimesh")
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 51, 0, 102], alphaMode=mode, emissiveFactor=[0, 0, 0.5]
    )
    visual = trimesh.visual.TextureVisuals(uv=np.zeros((3, 2)), material=material)
    mesh = trimesh.Trimesh(np.eye(3), [[0, 1, 2]], visual=visual, process=False)
    params = first(mesh).material.params
    assert params["color"] == pytest.approx((1, 0.2, 0))
    assert (params["metallic"], params["roughness"]) == (1.0, 1.0)  # as glTF has it
    assert params["emission"] == (0, 0, 0.5)
    assert params.get("opacity") == (None if expected is None else pytest.approx(expected))


def test_different_things_together() -> None:
    ase = pytest.importorskip("ase")
    trimesh = pytest.importorskip("trimesh")
    atoms = ase.Atoms("CO", positions=[[0, 0, 0], [0, 0, 1.1]])
    scene = ph.scene_of([atoms, trimesh.creation.box([9, 9, 9])])
    assert [type(shape) for shape in scene.shapes[:2]] == [ph.Spheres, ph.Mesh]
    np.testing.assert_allclose(scene.shapes[0].radii, [1.7, 1.52])
    with pytest.raises(ph.SceneError, match=r"type builtins\.object cannot"):
        ph.scene_of([atoms, object()])
