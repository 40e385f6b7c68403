// A point that shines into a cone, full within the beam and fading linearly with the angle from
// there to the cutoff, as Mitsuba's light of this name.
#pragma once
#include "../light_record.h"
#include "../special.h"

namespace parhelion::PH_ISA {

struct Spot {
  Vec3 intensity, position, direction;
  float cutoff_angle, beam_width;

  static constexpr bool outside = false;
  static constexpr const char* doc = "a point that shines into a cone, with a soft edge";
  static constexpr ParamInfo params[] = {
      {"intensity",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "power per solid angle within the beam, linear RGB: radiance times scene unit^2",
       nullptr,
       2},
      {"position", 3, {0.0f, 0.0f, 0.0f}, -1e30f, 1e30f, "where it is", nullptr, 1},
      {"direction",
       3,
       {0.0f, 0.0f, 1.0f},
       -1e6f,
       1e6f,
       "of the cone's axis, in which the light travels; of any length but 0"},
      {"cutoff_angle",
       1,
       {20.0f},
       0.0f,
       180.0f,
       "degrees from the axis beyond which there is no light"},
      {"beam_width",
       1,
       {-1.0f},
       -1.0f,
       180.0f,
       "degrees from the axis within which it is full; below 0, three quarters of cutoff_angle"},
  };
};

PH_INLINE float falloff(const Spot& light, Vec3 local) {
  const float cutoff = light.cutoff_angle;
  const float beam = light.beam_width < 0.0f ? 0.75f * cutoff : light.beam_width;
  // From the half angle's sine, because acos of nearly 1 has few digits.
  const Vec3 off = local - normalize(light.direction);
  const float angle = 2.0f * asin(min(0.5f * length(off), 1.0f)) * (180.0f / kPi);
  if (angle >= cutoff) return 0.0f;
  return angle <= beam ? 1.0f : (cutoff - angle) / (cutoff - beam);
}

PH_INLINE LightSample sample(const Spot& light, const LightRecord& record, const LightTables&,
                             Vec3 from, Vec2) {
  const Vec3 at = record.position + to_world(record, light.position);
  return sample_point(record, at, from,
                      [&](Vec3 local) { return light.intensity * falloff(light, local); });
}

PH_INLINE Vec3 radiance(const Spot&, const LightRecord&, const LightTables&, Vec3) {
  return {0, 0, 0};
}
PH_INLINE float pdf(const Spot&, const LightRecord&, const LightTables&, Vec3) { return 0.0f; }

PH_INLINE LightReach reach(const Spot& light, const LightRecord& record, const LightTables&) {
  return {record.position + to_world(record, light.position),
          to_world(record, normalize(light.direction)), cos_sin_degrees(light.cutoff_angle).c, 1.0f,
          luminance(light.intensity)};
}

}  // namespace parhelion::PH_ISA
