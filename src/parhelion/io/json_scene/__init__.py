"""Parhelion's own scene format, JSON; docs/scene.md is its manual.

A document has the fields of the dataclasses in parhelion.scene, under the same names. `document`
has them as msgspec structs, which decode the text; what a type cannot say (which materials there
are, how long the arrays must be) is checked where `reading`, `entries` and `shapes` make a Scene of
the structs. Errors begin with a place in the document, such as "$.shapes[0].radii[17]"; load() and
dumps() put the file or the scene in front.
"""

from __future__ import annotations

from .reading import load
from .schema import schema
from .writing import dumps, save

NAME = "Parhelion scene"
OPTIONS = ()

__all__ = ["NAME", "dumps", "load", "save", "schema"]
