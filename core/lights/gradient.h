// The classic sky: from one colour straight down to another straight up, linear in the height of
// the direction, and so sampled.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Gradient {
  Vec3 horizon, zenith, up;

  static constexpr bool outside = true, smooth = true, branchless = true;
  static constexpr const char* doc = "sky that goes from `horizon`, below, to `zenith`, above";
  static constexpr ParamInfo params[] = {
      {"horizon", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "radiance from straight below, linear RGB"},
      {"zenith", 3, {0.5f, 0.7f, 1.0f}, 0.0f, 1e12f, "radiance from straight above, linear RGB"},
      {"up", 3, {0.0f, 1.0f, 0.0f}, -1.0f, 1.0f, "the direction above; of any length but 0"},
  };
};

// 0 straight below, 1 straight above.
PH_INLINE float height(const Gradient& light, const LightRecord& record, Vec3 direction) {
  const Vec3 d = to_local(record, direction);
  return 0.5f * (dot(d, light.up) / length(light.up) + 1.0f);
}

PH_INLINE Vec3 radiance(const Gradient& light, const LightRecord& record, const LightTables&,
                        Vec3 direction) {
  const float t = height(light, record, direction);
  return light.horizon * (1.0f - t) + light.zenith * t;
}

PH_INLINE LightSample sample(const Gradient& light, const LightRecord& record,
                             const LightTables& tables, Vec3, Vec2 u) {
  const float below = luminance(light.horizon), above = luminance(light.zenith);
  const float t = sample_linear(below, above, u.x);
  const Vec3 local =
      to_world(frame_around(normalize(light.up)), direction_at(2.0f - 2.0f * t, u.y));
  const Vec3 direction = to_world(record, local);
  return {direction, kInfinity, linear_pdf(below, above, t) * (1.0f / (4.0f * kPi)),
          radiance(light, record, tables, direction), false};
}

PH_INLINE float pdf(const Gradient& light, const LightRecord& record, const LightTables&,
                    Vec3 direction) {
  const float t = clamp(height(light, record, direction), 0.0f, 1.0f);
  return linear_pdf(luminance(light.horizon), luminance(light.zenith), t) * (1.0f / (4.0f * kPi));
}

}  // namespace parhelion::PH_ISA
