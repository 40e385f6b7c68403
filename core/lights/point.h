// A point that shines alike in all directions.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Point {
  Vec3 intensity, position;

  static constexpr bool outside = false;
  static constexpr const char* doc = "a point that shines alike in all directions";
  static constexpr ParamInfo params[] = {
      {"intensity",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "power per solid angle, linear RGB: radiance times scene unit^2",
       nullptr,
       2},
      {"position", 3, {0.0f, 0.0f, 0.0f}, -1e30f, 1e30f, "where it is", nullptr, 1},
  };
};

PH_INLINE LightSample sample(const Point& light, const LightRecord& record, const LightTables&,
                             Vec3 from, Vec2) {
  const Vec3 at = record.position + to_world(record, light.position);
  return sample_point(record, at, from, [&](Vec3) { return light.intensity; });
}

PH_INLINE Vec3 radiance(const Point&, const LightRecord&, const LightTables&, Vec3) {
  return {0, 0, 0};
}
PH_INLINE float pdf(const Point&, const LightRecord&, const LightTables&, Vec3) { return 0.0f; }

PH_INLINE LightReach reach(const Point& light, const LightRecord& record, const LightTables&) {
  return {record.position + to_world(record, light.position),
          {0, 0, 1},
          -1.0f,
          1.0f,
          luminance(light.intensity)};
}

}  // namespace parhelion::PH_ISA
