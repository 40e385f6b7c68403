// The same radiance from everywhere.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Constant {
  Vec3 color;

  static constexpr bool outside = true, smooth = true, branchless = true;
  static constexpr const char* doc = "the same radiance from every direction";
  static constexpr ParamInfo params[] = {
      {"radiance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "linear RGB"},
  };
};

PH_INLINE Vec3 radiance(const Constant& light, const LightRecord&, const LightTables&, Vec3) {
  return light.color;
}

PH_INLINE LightSample sample(const Constant& light, const LightRecord&, const LightTables&, Vec3,
                             Vec2 u) {
  const Vec3 direction = uniform_sphere(u);
  return {direction, kInfinity, uniform_sphere_pdf(direction), light.color, false};
}

PH_INLINE float pdf(const Constant&, const LightRecord&, const LightTables&, Vec3 direction) {
  return uniform_sphere_pdf(direction);
}

}  // namespace parhelion::PH_ISA
