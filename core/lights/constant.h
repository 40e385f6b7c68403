// The same radiance from everywhere.
#pragma once
#include "../entry.h"
#include "../math.h"

namespace parhelion::PH_ISA {

struct Constant {
  Vec3 color;

  static constexpr const char* doc = "the same radiance from every direction";
  static constexpr ParamInfo params[] = {
      {"radiance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "linear RGB"},
  };
};

PH_INLINE Vec3 radiance(const Constant& light, Vec3) { return light.color; }

}  // namespace parhelion::PH_ISA
