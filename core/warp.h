// From two uniform numbers to directions and points: each mapping beside its density.
//
// Directions are in a local frame whose z axis is the normal or the cone's axis; densities are per
// steradian, or per unit area for points.
#pragma once
#include "math.h"

namespace parhelion {

enum class WarpKind : u32 {
#define WARP(name, parameter, doc) name,
#include "warps.def"
#undef WARP
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// z comes from the first number and the azimuth from the second. 1 - z is what is passed, because
// a narrow cone has z so close to 1 that float could not tell its directions apart.
PH_INLINE Vec3 direction_at(float one_minus_z, float u) {
  const CosSin azimuth = cos_sin_turns(u);
  const float r = safe_sqrt(one_minus_z * (2.0f - one_minus_z));
  return {r * azimuth.c, r * azimuth.s, 1.0f - one_minus_z};
}

PH_INLINE Vec3 uniform_sphere(Vec2 u) { return direction_at(2.0f * u.x, u.y); }
PH_INLINE float uniform_sphere_pdf(Vec3) { return 1.0f / (4.0f * kPi); }

PH_INLINE Vec3 cosine_hemisphere(Vec2 u) {
  const CosSin azimuth = cos_sin_turns(u.y);
  const float r = sqrt(u.x);
  return {r * azimuth.c, r * azimuth.s, sqrt(1.0f - u.x)};
}
PH_INLINE float cosine_hemisphere_pdf(Vec3 w) { return max(w.z, 0.0f) * (1.0f / kPi); }

// Directions within a cone around z whose half angle has 1 - cos = spread.
PH_INLINE Vec3 uniform_cone(Vec2 u, float spread) { return direction_at(u.x * spread, u.y); }
PH_INLINE float uniform_cone_pdf(Vec3 w, float spread) {
  const float one_minus_z = w.z > 0.0f ? (w.x * w.x + w.y * w.y) / (1.0f + w.z) : 1.0f - w.z;
  return one_minus_z <= spread ? 1.0f / (2.0f * kPi * spread) : 0.0f;
}

// Points of the unit disk, in x and y.
PH_INLINE Vec3 uniform_disk(Vec2 u) {
  const CosSin azimuth = cos_sin_turns(u.y);
  const float r = sqrt(u.x);
  return {r * azimuth.c, r * azimuth.s, 0.0f};
}
PH_INLINE float uniform_disk_pdf(Vec3 p) {
  return p.x * p.x + p.y * p.y <= 1.0f ? 1.0f / kPi : 0.0f;
}

// Directions from the origin to a sphere of radius fuzz < 1 around the point (0, 0, 1), its points
// equally likely: the lobe of the classic fuzzy mirror. A direction meets the sphere twice, at
// distances c -+ s; each counts t^2 / (area cos), and cos = s / fuzz at both.
PH_INLINE Vec3 fuzzy_lobe(Vec2 u, float fuzz) {
  const Vec3 s = uniform_sphere(u);
  return normalize(Vec3{fuzz * s.x, fuzz * s.y, 1.0f + fuzz * s.z});
}
PH_INLINE float fuzzy_lobe_pdf(Vec3 w, float fuzz) {
  const float sine2 = w.x * w.x + w.y * w.y;
  const float s2 = fuzz * fuzz - sine2;
  const float density = (1.0f - sine2 + s2) / (2.0f * kPi * fuzz * sqrt(s2));
  return ((s2 > 0.0f) & (w.z > 0.0f)) ? density : 0.0f;
}

}  // namespace parhelion::PH_ISA
