// A thin pane of clear glass: light passes straight on or is mirrored, including what was reflected
// back and forth within the pane. Sum of the geometric series: Stokes 1862.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"

namespace parhelion::PH_ISA {

struct ThinDielectric {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;

  static constexpr bool transmits = true;
  static constexpr bool thin = true;  // has no inside
  static constexpr const char* doc = "thin pane of glass: mirrors, or lets pass straight on";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of all light"},
      {"ior", 1, {1.5f}, 0.1f, 10.0f, "index of refraction, of the pane over its surroundings"},
      {"reflectance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what is reflected"},
      {"transmittance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what passes"},
  };
};

PH_INLINE bool is_delta(const ThinDielectric&) { return true; }
PH_INLINE float pdf(const ThinDielectric&, Vec3, Vec3) { return 0.0f; }
PH_INLINE Vec3 eval(const ThinDielectric&, Vec3, Vec3) { return {0, 0, 0}; }

PH_INLINE bool sample(const ThinDielectric& m, Vec3 wo, const Sampler& sampler, u32 draw,
                      BsdfSample& out) {
  const float once = fresnel_dielectric(abs(wo.z), m.ior).reflected;
  // r + (1 - r)^2 r (1 + r^2 + r^4 + ...)
  const float reflected = 2.0f * once / (1.0f + once);
  out.delta = true;
  if (draw1(sampler, draw + kDrawLobe) < reflected) {
    out.wi = {-wo.x, -wo.y, wo.z};
    out.weight = m.color * m.reflectance;
  } else {
    out.wi = -wo;
    out.weight = m.color * m.transmittance;
  }
  return true;
}

}  // namespace parhelion::PH_ISA
