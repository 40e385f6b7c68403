"""What `parhelion info` says there is in a file to choose from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import parhelion as ph
from parhelion import cli, io
from parhelion.errors import unknown_name
from test_camera_choice import gltf

XYZ = """3
Lattice="4 0 0 0 5 0 0 3 3" pbc="T F T" Properties=species:S:1:pos:R:3:force:R:3:charge:R:1
O 0 0 0 1 2 3 -1
H 1 0 0 1 2 3 0.5
H 0 1 0 1 2 3 0.5
"""

DUMP = """ITEM: TIMESTEP
{step}
ITEM: NUMBER OF ATOMS
4
ITEM: BOX BOUNDS pp pp ff
-1 9
-1 9
-1 9
ITEM: ATOMS id type x y z c_pe
1 10 0 0 0 0.1
2 2 1 0 0 0.2
3 10 0 1 0 0.3
4 10 0 0 1 0.4
"""

PDB = """REMARK 350 BIOMOLECULE: 1
REMARK 350 APPLY THE FOLLOWING TO CHAINS: B, A
REMARK 350   BIOMT1   1  1.000000  0.000000  0.000000        0.00000
REMARK 350   BIOMT2   1  0.000000  1.000000  0.000000        0.00000
REMARK 350   BIOMT3   1  0.000000  0.000000  1.000000        0.00000
REMARK 350   BIOMT1   2  1.000000  0.000000  0.000000       50.00000
REMARK 350   BIOMT2   2  0.000000  1.000000  0.000000        0.00000
REMARK 350   BIOMT3   2  0.000000  0.000000  1.000000        0.00000
REMARK 350 BIOMOLECULE: 3
REMARK 350 APPLY THE FOLLOWING TO CHAINS: A
REMARK 350   BIOMT1   1  1.000000  0.000000  0.000000        0.00000
REMARK 350   BIOMT2   1  0.000000  1.000000  0.000000        0.00000
REMARK 350   BIOMT3   1  0.000000  0.000000  1.000000        0.00000
HETATM    1  C1  XXX A   1       0.000   0.000   0.000  1.00  0.00           C
HETATM    2  O1  XXX A   1       1.200   0.000   0.000  1.00  0.00           O
HETATM    3  C1  XXX B   2       9.000   0.000   0.000  1.00  0.00           C
CONECT    1    2
END
"""

STAGE = """#usda 1.0
def Xform "A" (variants = { string size = "small"
string look = "red" }
prepend variantSets = ["size", "look"]) {
    variantSet "size" = { "large" { } "small" {
        def Sphere "s" { }
    } }
    variantSet "look" = { "red" { } }
}
def Xform "B" (prepend variantSets = "size") {
    variantSet "size" = { "huge" { } "large" { } }
}
"""


def contents(file: Path, text: str, **options: Any) -> Any:
    file.write_text(text)
    return io.contents(file, ph.LoadOptions(**options))


def test_particles_tell_of_kinds_fields_and_the_box(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.xyz"
    fields = ["index", "x", "y", "z", "element"]
    fields += ["force", "force_x", "force_y", "force_z", "charge"]
    assert contents(file, XYZ) == {
        "particles": 3,
        "elements": {"H": 2, "O": 1},
        "fields": fields,
        "box": {
            "lengths": pytest.approx([4, 5, 18**0.5]),
            "angles": pytest.approx([45, 90, 90]),
            "corner": [0, 0, 0],
            "periodic": ["a", "c"],
        },
    }
    for name in fields:  # they are what can be asked for
        ph.load(file, ph.LoadOptions(color_by=name))
    assert cli.main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    assert "├── particles: 3\n├── elements: H (2), O (1)\n├── fields: index, x, " in text
    box = "lengths 4, 5, 4.24264; angles 45, 90, 90; corner 0, 0, 0; periodic a, c"
    assert f"├── box: {box}\n" in text


def test_a_dump_tells_of_the_frame_that_is_asked_for(tmp_path: Path) -> None:
    other = DUMP.format(step=1).replace("10 ", "1 ")
    text = DUMP.format(step=0) + other
    found = contents(tmp_path / "a.dump", text)
    assert list(found["types"].items()) == [("2", 1), ("10", 3)]
    assert found["fields"] == ["index", "x", "y", "z", "type", "id", "c_pe"]
    assert found["box"]["periodic"] == ["a", "b"]
    assert contents(tmp_path / "a.dump", text, frame=-1)["types"] == {"1": 3, "2": 1}


def test_a_pdb_file_tells_of_bonds_and_assemblies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("chemfiles")
    file = tmp_path / "a.pdb"
    found = contents(file, PDB)
    assert found["elements"] == {"C": 2, "O": 1}
    assert "types" not in found
    assert found["bonds"] == 1
    assert {"residue", "chain"} < set(found["fields"])
    assert found["assemblies"] == {
        "1": {"chains": ["A", "B"], "copies": 2},
        "3": {"chains": ["A"], "copies": 1},
    }
    assert cli.main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    assert "├── assemblies: 2\n│   ├── 1: chains A, B; copies 2\n│   └── 3: chains A; " in text


def test_a_gsd_file_tells_of_its_types_and_bonds(tmp_path: Path) -> None:
    hoomd = pytest.importorskip("gsd.hoomd")
    frame = hoomd.Frame()
    frame.particles.N, frame.particles.position = 2, [[0, 0, 0], [1, 0, 0]]
    frame.particles.types, frame.particles.typeid = ["A", "B"], [0, 1]
    frame.bonds.N, frame.bonds.group = 1, [[0, 1]]
    with hoomd.open(str(tmp_path / "a.gsd"), "w") as file:
        file.append(frame)
    found = io.contents(tmp_path / "a.gsd")
    assert found is not None
    assert (found["types"], found["bonds"]) == ({"A": 1, "B": 1}, 1)


def test_a_gltf_file_tells_of_variants_and_animations(tmp_path: Path) -> None:
    times = {"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR", "byteOffset": 8}
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    moves = {
        "samplers": [{"input": 1, "output": 0}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
    }
    file = gltf(
        tmp_path,
        accessors=[accessor, times],  # the times are 0 and 1
        animations=[{**moves, "name": "walk"}, {**moves, "name": "walk"}, moves],
        extensionsUsed=["KHR_materials_variants"],
        extensions={"KHR_materials_variants": {"variants": [{"name": "day"}, {"name": "night"}]}},
    )
    found = io.contents(file)
    assert found is not None
    assert found["variants"] == {"names": ["day", "night"], "used": None}
    assert found["animation_seconds"] == {
        "walk": 1.0,
        "animations[1]": 1.0,
        "animations[2]": 1.0,
    }
    found = io.contents(file, ph.LoadOptions(variant="night"))
    assert found is not None
    assert found["variants"]["used"] == "night"


def test_a_stage_tells_of_its_variants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pxr")
    file = tmp_path / "a.usda"
    sets = contents(file, STAGE)["variant_sets"]
    assert sets == {
        "size": {"names": ["large", "small", "huge"], "used": ["small"]},
        "look": {"names": ["red"], "used": ["red"]},
    }
    used = contents(file, STAGE, variant="size=large")["variant_sets"]["size"]["used"]
    assert used == ["large"]
    assert cli.main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    assert "├── variant sets: 2\n│   ├── size: names large, small, huge; used small\n" in text


def test_what_shows_all_it_has_in_the_scene_tells_of_no_contents(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert contents(tmp_path / "a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n") is None
    assert cli.main(["info", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["contents"] is None


def test_many_kinds_stay_short_and_fields_do_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.xyz"
    rows = "\n".join(f"kind{i} {i} 0 0 {' '.join(['1'] * 30)}" for i in range(30))
    file.write_text(f"30\n\n{rows}\n")
    assert cli.main(["info", str(file)]) == 0
    text = capsys.readouterr().out
    assert ", and 14 more\n" in text
    assert ", column34\n" in text
    assert cli.main(["info", str(file), "--all"]) == 0
    assert " more" not in capsys.readouterr().out


def test_a_wrong_name_is_answered_with_all_choices_or_forty() -> None:
    names = [f"f{i:02}" for i in range(60)]
    assert unknown_name("field", "q", names[:40]).endswith(f"(choices: {', '.join(names[:40])})")
    assert unknown_name("field", "q", names).endswith(f"{', '.join(names[:40])} and 20 more)")
    assert unknown_name("variant", "night", ()) == "unknown variant 'night'; there are none"
