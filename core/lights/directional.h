// Light from one direction: a point, or a disk of constant radiance, infinitely far away.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Directional {
  Vec3 irradiance, direction;
  float angle;

  static constexpr bool outside = true;
  static constexpr const char* doc = "light from one direction, such as a distant lamp or the sun";
  static constexpr ParamInfo params[] = {
      {"irradiance",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "on a surface that faces the light, linear RGB"},
      {"direction",
       3,
       {0.0f, -1.0f, 0.0f},
       -1e6f,
       1e6f,
       "in which the light travels; of any length but 0"},
      {"angle",
       1,
       {0.0f},
       0.0f,
       180.0f,
       "degrees that the light's disk is wide (the sun: 0.53); 0 gives sharp shadows"},
  };
};

PH_INLINE Vec3 toward(const Directional& light, const LightRecord& record) {
  return to_world(record, -normalize(light.direction));
}
// A disk of half angle a and radiance L gives pi sin^2 a L.
PH_INLINE Vec3 disk_radiance(const Directional& light, float spread) {
  return light.irradiance * (1.0f / (kPi * spread * (2.0f - spread)));
}

PH_INLINE LightSample sample(const Directional& light, const LightRecord& record,
                             const LightTables&, Vec3, Vec2 u) {
  const float spread = disk_spread(light.angle);
  if (!(spread > 0.0f)) {
    return {toward(light, record), kInfinity, 1.0f, light.irradiance, true};
  }
  return sample_disk(toward(light, record), spread, disk_radiance(light, spread), u);
}

PH_INLINE float pdf(const Directional& light, const LightRecord& record, const LightTables&,
                    Vec3 direction) {
  const float spread = disk_spread(light.angle);
  return spread > 0.0f ? disk_pdf(toward(light, record), spread, direction) : 0.0f;
}

PH_INLINE Vec3 radiance(const Directional& light, const LightRecord& record,
                        const LightTables& tables, Vec3 direction) {
  if (!(pdf(light, record, tables, direction) > 0.0f)) return {0, 0, 0};
  return disk_radiance(light, disk_spread(light.angle));
}

}  // namespace parhelion::PH_ISA
