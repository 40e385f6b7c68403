// Shading normals of a mesh that brings none.
#pragma once
#include <optional>
#include <vector>

#include "../core/types.h"

namespace parhelion {

struct ShadedMesh {
  std::vector<u32> faces;     // three vertices each
  std::vector<u32> old;       // for each vertex, the one given
  std::vector<Vec3> normals;  // of each vertex, of length 1
};

// The vertices' normals: those of the faces around, weighted by the angle there (G. Thürmer and
// C. A. Wüthrich, "Computing vertex normals from polygonal facets", Journal of Graphics Tools 3(1),
// 1998). A vertex of no face, or of faces that cancel, gets (1, 0, 0).
//
// With a crease, in degrees, each vertex stands for one smooth part of the surface around it, and
// vertices of no face go. All faces at a vertex are one part where they lie within half the crease
// of the first. Else two belong to one part where they share an edge there and their normals differ
// by less than the crease, and so do the neighbours of those; of more than two faces at an edge,
// those next to each other in the order of the file. A face without an area lets the surface pass.
//
// vertices: three coordinates each, finite. faces: three indices each. Throws std::out_of_range for
// an index that is too large. The same to the last bit for any number of threads.
template <class Real>
ShadedMesh shade(const Real* vertices, u32 vertex_count, const u32* faces, u32 face_count,
                 std::optional<double> crease);

}  // namespace parhelion
