// An image thrown from a point, as a slide projector does: the counterpart of a pinhole camera, as
// Mitsuba's light of this name.
#pragma once
#include "../light_record.h"

namespace parhelion::PH_ISA {

struct Projector {
  Vec3 scale, position;
  float fov, wide;

  static constexpr bool outside = false;
  static constexpr bool has_image = true;
  static constexpr const char* doc =
      "an image thrown from a point along +z of its own frame, its top at +y, its left at +x";
  static constexpr ParamInfo params[] = {
      {"scale",
       3,
       {1.0f, 1.0f, 1.0f},
       0.0f,
       1e12f,
       "factor on the image, which times pi is irradiance on a screen at distance 1; linear RGB",
       nullptr,
       2},
      {"position", 3, {0.0f, 0.0f, 0.0f}, -1e30f, 1e30f, "where it is", nullptr, 1},
      {"fov", 1, {45.0f}, 0.001f, 179.999f, "degrees that the image takes along fov_axis"},
      {"fov_axis", 1, {0.0f}, 0.0f, 1.0f, "which side of the image fov is of", "x|y"},
  };
};

// Half the image's sides on a screen at distance 1.
PH_INLINE Vec2 half_sides(const Projector& light, const ImageView& image) {
  const CosSin half = cos_sin_degrees(0.5f * light.fov);
  const float side = half.s / half.c;
  const float aspect = static_cast<float>(image.width) / static_cast<float>(image.height);
  return light.wide == 0.0f ? Vec2{side, side / aspect} : Vec2{side * aspect, side};
}

PH_INLINE LightSample sample(const Projector& light, const LightRecord& record,
                             const LightTables& tables, Vec3 from, Vec2) {
  const ImageView& image = tables.images[record.image];
  const Vec3 at = record.position + to_world(record, light.position);
  return sample_point(record, at, from, [&](Vec3 d) -> Vec3 {
    const Vec2 half = half_sides(light, image);
    const Vec2 uv = {0.5f - 0.5f * d.x / (d.z * half.x), 0.5f + 0.5f * d.y / (d.z * half.y)};
    // Behind, z is not positive, and the comparisons are false for what is not a number.
    const bool inside = d.z > 0.0f && uv.x >= 0.0f && uv.x <= 1.0f && uv.y >= 0.0f && uv.y <= 1.0f;
    if (!inside) return {0, 0, 0};
    const Vec3 color = bilinear(image, 0, uv, Wrap::clamp, Wrap::clamp).rgb;
    // A screen at distance 1 is met at 1 / z and obliquely, so that the image is as bright at its
    // corners as in its middle.
    return light.scale * color * (kPi / (d.z * d.z * d.z));
  });
}

PH_INLINE Vec3 radiance(const Projector&, const LightRecord&, const LightTables&, Vec3) {
  return {0, 0, 0};
}
PH_INLINE float pdf(const Projector&, const LightRecord&, const LightTables&, Vec3) { return 0.0f; }

PH_INLINE LightReach reach(const Projector& light, const LightRecord& record,
                           const LightTables& tables) {
  const ImageView& image = tables.images[record.image];
  const Vec2 half = half_sides(light, image);
  const float corner = 1.0f / sqrt(1.0f + half.x * half.x + half.y * half.y);
  const Vec3 most = light.scale * brightest(image);
  return {record.position + to_world(record, light.position), to_world(record, {0, 0, 1}), corner,
          1.0f, kPi * luminance(most)};
}

}  // namespace parhelion::PH_ISA
