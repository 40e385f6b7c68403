// The product of two colours.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Multiply {
  Vec3 color0, color1;

  static constexpr const char* doc = "the product of `color0` and `color1`";
  static constexpr ParamInfo params[] = {
      {"color0", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "linear RGB"},
      {"color1", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "linear RGB"},
  };
};

PH_INLINE Texel lookup(const Multiply& t, const ImageView*, const TextureRecord&,
                       const TexturePoint&) {
  return {t.color0 * t.color1, 1.0f};
}

}  // namespace parhelion::PH_ISA
