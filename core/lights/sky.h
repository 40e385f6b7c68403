// The clear sky by day, without the sun, and the ground below it.
//
// The host computes it for the sun's place and the air's turbidity (host/sky.h) into an image of
// latitude and longitude, one that is mirrored at the sun's meridian.
#pragma once
#include "../light_record.h"
#include "../panorama.h"

namespace parhelion::PH_ISA {

struct Sky {
  Vec3 scale, sun_direction;
  float turbidity, albedo;

  static constexpr bool outside = true;
  static constexpr const char* doc =
      "the clear sky and the ground below it, +y of its own frame being up; without the sun itself";
  static constexpr ParamInfo params[] = {
      {"scale",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "factor on the sky, whose radiance has a luminance in 1000 cd/m^2"},
      {"sun_direction", 3, {0.0f, 1.0f, 1.0f}, -1e6f, 1e6f, "to the sun; of any length but 0"},
      {"turbidity",
       1,
       {3.0f},
       1.0f,
       10.0f,
       "optical depth of all air over that of its molecules: 2 is very clear, 6 hazy"},
      {"albedo", 1, {0.2f}, 0.0f, 1.0f, "share of light that the ground reflects"},
  };
};

PH_INLINE LightSample sample(const Sky& light, const LightRecord& record, const LightTables& tables,
                             Vec3, Vec2 u) {
  const PanoramaSample s =
      sample_latlong(tables.images[record.image], tables.distributions[record.distribution], u);
  return {to_world(record, s.direction), kInfinity, s.pdf, light.scale * s.color, false};
}

PH_INLINE Vec3 radiance(const Sky& light, const LightRecord& record, const LightTables& tables,
                        Vec3 direction) {
  const ImageView& image = tables.images[record.image];
  return light.scale * latlong_color(latlong_cell_at(image, to_local(record, direction)));
}

PH_INLINE float pdf(const Sky&, const LightRecord& record, const LightTables& tables,
                    Vec3 direction) {
  const ImageView& image = tables.images[record.image];
  const LatLongCell c = latlong_cell_at(image, to_local(record, direction));
  return latlong_pdf(image.width, latlong_rows(image), c,
                     cell_probability(tables.distributions[record.distribution], c.x, c.y));
}

}  // namespace parhelion::PH_ISA
