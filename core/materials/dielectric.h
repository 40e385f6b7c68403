// Clear, smooth glass or water: reflects and refracts by Fresnel's equations, exactly.
//
// `ior` is the index inside the surface over the index outside. A bubble, or the inner wall of a
// hollow sphere, is a sphere whose ior is below 1: air in glass has 1 / 1.5.
#pragma once
#include "../bsdf.h"

namespace parhelion::PH_ISA {

struct Dielectric {
  Vec3 color;
  float ior;

  static constexpr const char* doc = "smooth glass: reflects and refracts";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of the light at each crossing"},
      {"ior", 1, {1.5f}, 0.1f, 10.0f, "index of refraction, inside over outside"},
  };
};

PH_INLINE bool is_delta(const Dielectric&) { return true; }
PH_INLINE float pdf(const Dielectric&, Vec3, Vec3) { return 0.0f; }
PH_INLINE Vec3 eval(const Dielectric&, Vec3, Vec3) { return {0, 0, 0}; }

PH_INLINE bool sample(const Dielectric& m, Vec3 wo, const Sampler& sampler, u32 draw,
                      BsdfSample& out) {
  const bool entering = wo.z > 0.0f;
  const float eta = entering ? m.ior : 1.0f / m.ior;  // far side over near side
  const float cos_i = abs(wo.z);
  const float sin2_t = (1.0f - cos_i * cos_i) / (eta * eta);
  const float cos_t = safe_sqrt(1.0f - sin2_t);
  const float parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
  const float perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
  const float reflected =
      sin2_t >= 1.0f ? 1.0f : 0.5f * (parallel * parallel + perpendicular * perpendicular);
  out.delta = true;
  out.weight = m.color;
  if (draw1(sampler, draw + kDrawLobe) < reflected) {
    out.wi = {-wo.x, -wo.y, wo.z};
    return true;
  }
  const float scale = 1.0f / eta;
  out.wi = {-wo.x * scale, -wo.y * scale, entering ? -cos_t : cos_t};
  // Radiance is squeezed into a narrower cone where the index is higher (Veach 1997, 5.2).
  out.eta = eta;
  out.weight = m.color * (scale * scale);
  return true;
}

}  // namespace parhelion::PH_ISA
