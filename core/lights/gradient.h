// The classic sky: from one colour straight down to another straight up, linear in the height of
// the direction.
#pragma once
#include "../entry.h"
#include "../math.h"

namespace parhelion::PH_ISA {

struct Gradient {
  Vec3 horizon, zenith, up;

  static constexpr const char* doc = "sky that goes from `horizon`, below, to `zenith`, above";
  static constexpr ParamInfo params[] = {
      {"horizon", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "radiance from straight below, linear RGB"},
      {"zenith", 3, {0.5f, 0.7f, 1.0f}, 0.0f, 1e12f, "radiance from straight above, linear RGB"},
      {"up", 3, {0.0f, 1.0f, 0.0f}, -1.0f, 1.0f, "the direction above; of any length but 0"},
  };
};

PH_INLINE Vec3 radiance(const Gradient& light, Vec3 direction) {
  const float cosine = dot(direction, light.up) / length(light.up);
  const float t = 0.5f * (cosine + 1.0f);
  return light.horizon * (1.0f - t) + light.zenith * t;
}

}  // namespace parhelion::PH_ISA
