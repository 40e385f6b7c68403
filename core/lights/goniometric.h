// A point that shines by an image of all directions: the measured distribution of a lamp.
#pragma once
#include "../light_record.h"
#include "../panorama.h"

namespace parhelion::PH_ISA {

struct Goniometric {
  Vec3 intensity, position;
  float mapping;

  static constexpr bool outside = false;
  static constexpr bool has_image = true;
  static constexpr const char* doc = "a point that shines by an image of all directions";
  static constexpr ParamInfo params[] = {
      {"intensity",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "power per solid angle where the image is 1, linear RGB: radiance times scene unit^2",
       nullptr,
       2},
      {"position", 3, {0.0f, 0.0f, 0.0f}, -1e30f, 1e30f, "where it is", nullptr, 1},
      {"mapping", 1, {0.0f}, 0.0f, 1.0f, "as that of `envmap`", "latlong|equal_area"},
  };
};

PH_INLINE LightSample sample(const Goniometric& light, const LightRecord& record,
                             const LightTables& tables, Vec3 from, Vec2) {
  const ImageView& image = tables.images[record.image];
  const Vec3 at = record.position + to_world(record, light.position);
  return sample_point(record, at, from, [&](Vec3 local) {
    return light.intensity * panorama_color(image, light.mapping == 0.0f, local);
  });
}

PH_INLINE Vec3 radiance(const Goniometric&, const LightRecord&, const LightTables&, Vec3) {
  return {0, 0, 0};
}
PH_INLINE float pdf(const Goniometric&, const LightRecord&, const LightTables&, Vec3) {
  return 0.0f;
}

PH_INLINE LightReach reach(const Goniometric& light, const LightRecord& record,
                           const LightTables& tables) {
  const Vec3 most = light.intensity * brightest(tables.images[record.image]);
  return {
      record.position + to_world(record, light.position), {0, 0, 1}, -1.0f, 1.0f, luminance(most)};
}

}  // namespace parhelion::PH_ISA
