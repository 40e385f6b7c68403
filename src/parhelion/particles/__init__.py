"""Particles, and the scene made of them.

Every particle format ends here, so that a file and a NumPy array give the same picture.

    data        particles as arrays
    scenes      spheres and other bodies, bonds, a box, and a view of them: to_scene
    contents    what there is to choose from, for people
    colors      of kinds and fields, and what they stand for
    bonds, boxes, glyphs   what is drawn besides spheres
    elements    radii and colours of the elements
    limits      what numbers must lie within
"""

from .boxes import Box
from .colors import color_range, field_names, field_of, linear, map_colors, mapped, swatches
from .contents import contents
from .data import Copies, Labels, Particles, biomolecular_labels, element_labels
from .limits import FARTHEST
from .scenes import OPTIONS, STYLES, neighbour_distance, to_scene

__all__ = [
    "FARTHEST",
    "OPTIONS",
    "STYLES",
    "Box",
    "Copies",
    "Labels",
    "Particles",
    "biomolecular_labels",
    "color_range",
    "contents",
    "element_labels",
    "field_names",
    "field_of",
    "linear",
    "map_colors",
    "mapped",
    "neighbour_distance",
    "swatches",
    "to_scene",
]
