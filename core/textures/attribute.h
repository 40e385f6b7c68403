// Numbers that a mesh has at its vertices or faces. They lie with the mesh, not with the texture:
// core/surface.h looks them up.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Attribute {
  float name;  // its index among all names of attributes; from Python, the name itself

  static constexpr const char* doc =
      "numbers that a mesh has by vertex or face, `name` in its attributes; black where it has "
      "none";
  static constexpr ParamInfo params[] = {
      {"name", 1, {0.0f}, 0.0f, 1e6f, "of the attribute"},
  };
};

PH_INLINE Texel lookup(const Attribute&, const ImageView*, const TextureRecord&,
                       const TexturePoint&) {
  return {{0, 0, 0}, 1};
}

}  // namespace parhelion::PH_ISA
