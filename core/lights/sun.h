// The sun's disk through the same air as the sky's. The host computes its radiance (host/sky.h) and
// passes it as an image of one texel.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Sun {
  Vec3 scale, sun_direction;
  float turbidity, angle;

  static constexpr bool outside = true;
  static constexpr const char* doc = "the sun's disk as seen through the air of `sky`";
  static constexpr ParamInfo params[] = {
      {"scale",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "factor on the sun, whose radiance has a luminance in 1000 cd/m^2"},
      {"sun_direction", 3, {0.0f, 1.0f, 1.0f}, -1e6f, 1e6f, "to the sun; of any length but 0"},
      {"turbidity", 1, {3.0f}, 1.0f, 10.0f, "as of the sky"},
      {"angle",
       1,
       {0.533f},
       0.01f,
       90.0f,
       "degrees that the disk is wide; another than the sun's own changes the shadows' edges, not "
       "the light"},
  };
};

PH_INLINE Vec3 toward(const Sun& light, const LightRecord& record) {
  return to_world(record, normalize(light.sun_direction));
}
PH_INLINE Vec3 disk_radiance(const Sun& light, const LightRecord& record,
                             const LightTables& tables) {
  return light.scale * fetch(tables.images[record.image], 0, 0, 0).rgb;
}

PH_INLINE LightSample sample(const Sun& light, const LightRecord& record, const LightTables& tables,
                             Vec3, Vec2 u) {
  return sample_disk(toward(light, record), disk_spread(light.angle),
                     disk_radiance(light, record, tables), u);
}

PH_INLINE float pdf(const Sun& light, const LightRecord& record, const LightTables&,
                    Vec3 direction) {
  return disk_pdf(toward(light, record), disk_spread(light.angle), direction);
}

PH_INLINE Vec3 radiance(const Sun& light, const LightRecord& record, const LightTables& tables,
                        Vec3 direction) {
  if (!(pdf(light, record, tables, direction) > 0.0f)) return {0, 0, 0};
  return disk_radiance(light, record, tables);
}

}  // namespace parhelion::PH_ISA
