// A thin pane of clear glass: light passes straight on or is mirrored, including what was reflected
// back and forth within the pane. Sum of the geometric series: Stokes 1862.
//
// A frosted pane blurs both alike: what passes is scattered as what is mirrored, to the other side,
// as glTF's KHR_materials_transmission has it. Facets share what they receive among both, so white
// loses nothing, as in conductor.h.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"
#include "../microfacet.h"

namespace parhelion::PH_ISA {

struct ThinDielectric {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;
  float roughness;

  using Plain = PlainForms<struct ClearPane>;
  static constexpr bool transmits = true;
  static constexpr bool thin = true;  // has no inside
  static constexpr bool lobe_draws = true;
  static constexpr const char* doc = "thin pane of glass: mirrors, or lets pass straight on";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of all light"},
      {"ior", 1, {1.5f}, 0.1f, 10.0f, "index of refraction, of the pane over its surroundings"},
      {"reflectance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what is reflected"},
      {"transmittance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what passes"},
      {"roughness", 1, {0.0f}, 0.0f, 1.0f, "square root of the microfacets' alpha; 0 is clear"},
  };
};

PH_INLINE Microfacets microfacets(const ThinDielectric& m) {
  return microfacets(m.roughness, 0.0f, 0.0f);
}

PH_INLINE bool is_delta(const ThinDielectric& m) { return smooth(microfacets(m)); }

struct ClearPane {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;

  PH_INLINE static bool fits(const ThinDielectric& m) { return is_delta(m); }
  PH_INLINE static ClearPane of(const ThinDielectric& m) {
    return {m.color, m.ior, m.reflectance, m.transmittance};
  }
  PH_INLINE ThinDielectric whole() const { return {color, ior, reflectance, transmittance, 0.0f}; }
};

// Share of the light that a pane mirrors at a cosine: r + (1 - r)^2 r (1 + r^2 + r^4 + ...)
PH_INLINE float mirrored_share(const ThinDielectric& m, float cosine) {
  const float once = fresnel_dielectric(cosine, m.ior).reflected;
  return 2.0f * once / (1.0f + once);
}

struct ThinDielectricValue {
  Vec3 value;  // f |cos|
  float pdf;
};

// wo above the pane.
inline ThinDielectricValue evaluate(const ThinDielectric& m, const Microfacets& d, Vec3 wo,
                                    Vec3 wi) {
  const bool mirrors = wi.z > 0.0f;
  wi.z = abs(wi.z);
  if (!(wo.z > 0.0f) || !(wi.z > 0.0f)) return {{0, 0, 0}, 0.0f};
  const Reflection r = reflection(d, wo, wi, true);
  const float share = mirrored_share(m, min(r.facing, 1.0f));
  const float part = mirrors ? share : 1.0f - share;
  const float gain = metal_gain(d, wo) * metal_gain(d, wi);
  return {m.color * (mirrors ? m.reflectance : m.transmittance) * (part * gain * r.value),
          part * r.pdf};
}

inline ThinDielectricValue evaluate(const ThinDielectric& m, Vec3 wo, Vec3 wi) {
  const Microfacets d = microfacets(m);
  if (smooth(d)) return {{0, 0, 0}, 0.0f};
  const float side = copysign(1.0f, wo.z);
  wo.z *= side;
  wi.z *= side;
  return evaluate(m, d, wo, wi);
}

inline bool sample(const ThinDielectric& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const Microfacets d = microfacets(m);
  const bool delta = smooth(d);
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  const Vec3 normal = delta ? Vec3{0, 0, 1} : sample_visible_normal(d, above, u.direction);
  const float facing = clamp(dot(above, normal), 0.0f, 1.0f);
  const bool mirrors = u.lobe < mirrored_share(m, facing);
  if (delta) {
    out.delta = true;
    out.wi = {-wo.x, -wo.y, mirrors ? wo.z : -wo.z};
    out.weight = m.color * select(mirrors, m.reflectance, m.transmittance);
    return true;
  }
  out.wi = mirrored(above, normal);
  if (!(out.wi.z > 0.0f)) return false;
  if (!mirrors) out.wi.z = -out.wi.z;
  const ThinDielectricValue v = evaluate(m, d, above, out.wi);
  if (!(v.pdf > 0.0f)) return false;
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  out.wi.z *= copysign(1.0f, wo.z);
  return true;
}

}  // namespace parhelion::PH_ISA
