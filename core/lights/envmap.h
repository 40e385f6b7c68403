// An image of all that lies around the scene.
#pragma once
#include "../light_record.h"
#include "../panorama.h"

namespace parhelion::PH_ISA {

struct Envmap {
  Vec3 scale;
  float mapping;

  static constexpr bool outside = true;
  static constexpr bool has_image = true;
  static constexpr const char* doc = "an image of all directions, such as an HDR panorama";
  static constexpr ParamInfo params[] = {
      {"scale", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "factor on the image, linear RGB"},
      {"mapping",
       1,
       {0.0f},
       0.0f,
       1.0f,
       "`latlong`: twice as wide as high, straight up (+y) at the top, -z at the left border, +x a "
       "quarter on; `equal_area`: pbrt's square, +z in the middle",
       "latlong|equal_area"},
  };
};

PH_INLINE bool is_latlong(const Envmap& light) { return light.mapping == 0.0f; }

PH_INLINE LightSample from_panorama(const Envmap& light, const LightRecord& record,
                                    const PanoramaSample& s) {
  return {to_world(record, s.direction), kInfinity, s.pdf, light.scale * s.color, false};
}

PH_INLINE LightSample sample(const Envmap& light, const LightRecord& record,
                             const LightTables& tables, Vec3, Vec2 u) {
  const ImageView& image = tables.images[record.image];
  const Distribution& distribution = tables.distributions[record.distribution];
  const PanoramaSample s = is_latlong(light) ? sample_latlong(image, distribution, u)
                                             : sample_equal_area(image, distribution, u);
  return from_panorama(light, record, s);
}

PH_INLINE Vec3 radiance(const Envmap& light, const LightRecord& record, const LightTables& tables,
                        Vec3 direction) {
  const Vec3 d = to_local(record, direction);
  return light.scale * panorama_color(tables.images[record.image], is_latlong(light), d);
}

PH_INLINE LightSight seen(const Envmap& light, const LightRecord& record, const LightTables& tables,
                          Vec3 direction) {
  const ImageView& image = tables.images[record.image];
  const Distribution& distribution = tables.distributions[record.distribution];
  const Vec3 d = to_local(record, direction);
  if (is_latlong(light)) {
    const LatLongCell c = latlong_cell_at(image, d);
    return {light.scale * latlong_color(c), latlong_pdf(image.width, latlong_rows(image), c,
                                                        cell_probability(distribution, c.x, c.y))};
  }
  const TexelPlace t = equal_area_texel(image, d);
  return {light.scale * fetch(image, 0, t.x, t.y).rgb,
          cell_probability(distribution, t.x, t.y) * static_cast<float>(image.width) *
              static_cast<float>(image.height) / (4.0f * kPi)};
}

// The same for some of sixteen directions at once, where that is faster; false where it is not.
// weighed: of those that want the density.
template <u32 kCount>
inline bool seen(const Envmap& light, const LightRecord& record, const LightTables& tables,
                 u32 lanes, u32 weighed, const Rows<Vec3, kCount>& direction,
                 Rows<LightSight, kCount>& sights) {
  if (!is_latlong(light)) return false;
  PanoramaSights<kCount> s;
  for (u32 k = 0; k < kCount; ++k) s.direction.set(k, to_local(record, direction.at(k)));
  s.look(tables.images[record.image], tables.distributions[record.distribution], lanes, weighed);
  for (u32 k = 0; k < kCount; ++k) {
    sights.set(k, LightSight{light.scale * s.color.at(k), s.pdf[k]});
  }
  return true;
}

}  // namespace parhelion::PH_ISA
