"""The core's lists of names, and the checks of parameters against them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import tables

STEEL = "material 'steel'"


@pytest.mark.parametrize(
    "kind", ["materials", "textures", "lights", "backgrounds", "samplers", "filters"]
)
def test_every_entry_is_complete(kind: str) -> None:
    entries = tables.tables()[kind]
    assert entries
    for name, entry in entries.items():
        assert tables.entry(kind, name) is entry
        assert entry.name == name
        assert entry.doc
        assert (entry.radius is not None) == (kind == "filters")
        for param in entry.params:
            assert param.doc
            assert len(param.default) == param.size
            assert all(param.low <= x <= param.high for x in param.default)
        if entry.params:
            # the defaults pass their own check, and so do the ends of every range
            where = f"{kind} {name}"
            defaults = {p.name: p.default for p in entry.params}
            assert tables.check(kind, name, {}, where) == defaults
            for p in entry.params:
                for i, choice in enumerate(p.choices):
                    assert tables.check(kind, name, {p.name: choice}, where)[p.name] == (i,)
                for end in () if p.choices else (p.low, p.high):
                    if math.isfinite(end):
                        value = end if p.size == 1 else [end] * p.size
                        checked = tables.check(kind, name, {p.name: value}, where)
                        assert checked[p.name] == (end,) * p.size


def test_numbers_are_those_of_the_def_file() -> None:
    color, fuzz = tables.entry("materials", "metal").params
    assert color.default == (0.8, 0.8, 0.8)  # not 0.800000011920929
    assert (fuzz.low, fuzz.high) == (0, 1)


@pytest.mark.parametrize(
    ("color", "fuzz"),
    [
        ((0.25, 0.5, 1), 0.5),
        ([0.25, 0.5, 1.0], np.float32(0.5)),
        (np.array([0.25, 0.5, 1]), np.array(0.5)),
        (np.array([0.25, 0.5, 1], np.float32), np.float64(0.5)),
    ],
)
def test_values_of_every_kind(color: Any, fuzz: Any) -> None:
    checked = tables.check("materials", "metal", {"fuzz": fuzz, "color": color}, STEEL)
    assert list(checked.items()) == [("color", (0.25, 0.5, 1.0)), ("fuzz", (0.5,))]
    assert all(type(x) is float for values in checked.values() for x in values)


@pytest.mark.parametrize(
    ("type_", "params", "words"),
    [
        ("mettal", {}, f"{STEEL}: unknown material type 'mettal'; did you mean 'metal'?"),
        (None, {}, f"{STEEL}: unknown material type 'None'"),
        (["metal"], {}, f"{STEEL}: unknown material type"),
        ("metal", {"fuz": 1}, f"{STEEL}: unknown parameter 'fuz'; did you mean 'fuzz'?"),
        ("metal", {"fuzz": 2.0}, f"{STEEL}: parameter 'fuzz' is 2.0; must lie in [0, 1]"),
        ("metal", {"fuzz": math.nan}, f"{STEEL}: parameter 'fuzz' is nan; must lie in [0, 1]"),
        ("metal", {"fuzz": "1"}, f"{STEEL}: parameter 'fuzz' is '1'; must be a number"),
        ("metal", {"fuzz": None}, f"{STEEL}: parameter 'fuzz' is None; must be a number"),
        ("metal", {"fuzz": True}, f"{STEEL}: parameter 'fuzz' is True; must be a number"),
        ("metal", {"fuzz": 1j}, f"{STEEL}: parameter 'fuzz' is 1j; must be a number"),
        ("metal", {"fuzz": 10**5000}, f"{STEEL}: parameter 'fuzz' is a huge integer; must lie"),
        ("metal", {"color": 1}, f"{STEEL}: parameter 'color' is 1; must be 3 numbers"),
        ("metal", {"color": "red"}, f"{STEEL}: parameter 'color' is 'red'; must be 3 numbers"),
        ("metal", {"color": [1, 1]}, f"{STEEL}: parameter 'color' has 2 values; must be 3 numbers"),
        (
            "metal",
            {"color": np.eye(3)},
            f"{STEEL}: parameter 'color'[0] is [1.0, 0.0, 0.0]; must be a number",
        ),
        (
            "metal",
            {"color": [1, -0.5, 1]},
            f"{STEEL}: parameter 'color'[1] is -0.5; must lie in [0, 1]",
        ),
    ],
)
def test_bad_parameters(type_: Any, params: dict[str, Any], words: str) -> None:
    with pytest.raises(ph.SceneError) as caught:
        tables.check("materials", type_, params, STEEL)
    assert str(caught.value).startswith(words)


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.0, math.inf, "must be >= 0"),
        (-math.inf, 2.0, "must be <= 2"),
        (-math.inf, math.inf, "must be finite"),
    ],
)
def test_open_ranges(low: float, high: float, words: str) -> None:
    assert tables.Param("x", 1, (1.0,), low, high, "").range() == words


def test_lookup_without_a_place() -> None:
    with pytest.raises(ph.SceneError, match=r"^unknown sampler 'sobl'; did you mean 'sobol'\?"):
        tables.entry("samplers", "sobl")
