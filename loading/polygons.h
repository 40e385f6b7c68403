// Polygons as triangles.
#pragma once
#include <vector>

#include "../core/types.h"

namespace parhelion {

// Corners of a polygon that is not convex, at most.
inline constexpr u32 kMostCorners = 1u << 14;

// Three places in `corners` for each triangle, polygon after polygon, of which one of n corners
// becomes n - 2. A convex one is a fan around its first corner. Of others, seen along G. Newell's
// normal, ears are cut off one after the other: G. H. Meisters, "Polygons have ears", American
// Mathematical Monthly 82(6), 1975. One that crosses itself becomes some triangles.
//
// vertices: three coordinates each. counts: corners of each polygon, at least 3. corners: the
// vertex of each, in range. Throws std::length_error for a polygon of more than kMostCorners, not
// convex.
std::vector<u32> triangulate(const double* vertices, const u32* counts, u32 polygon_count,
                             const u32* corners);

}  // namespace parhelion
