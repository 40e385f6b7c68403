// From one colour to another along u.
#pragma once
#include "../lookup.h"

namespace parhelion::PH_ISA {

struct Ramp {
  Vec3 color0, color1;
  float shape;

  static constexpr const char* doc = "from `color0` at u = 0 to `color1` at u = 1, and no further";
  static constexpr ParamInfo params[] = {
      {"color0", 3, {0.0f, 0.0f, 0.0f}, 0.0f, 1e12f, "at u = 0 and below, linear RGB"},
      {"color1", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "at u = 1 and above, linear RGB"},
      {"shape",
       1,
       {0.0f},
       0.0f,
       1.0f,
       "straight, or with flat ends (3 u^2 - 2 u^3)",
       "linear|smooth"},
  };
};

PH_INLINE Texel lookup(const Ramp& t, const ImageView*, const TextureRecord&,
                       const TexturePoint& point) {
  const float u = clamp(point.uv.x, 0.0f, 1.0f);
  const float share = t.shape == 0.0f ? u : u * u * (3.0f - 2.0f * u);
  return {t.color0 * (1.0f - share) + t.color1 * share, 1.0f};
}

}  // namespace parhelion::PH_ISA
