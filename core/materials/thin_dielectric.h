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

  using Plain = PlainForms<struct ClearPane, struct RoughPane>;
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

// Clear
struct ClearPane {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;

  PH_INLINE static bool fits(const ThinDielectric& m) { return is_delta(m); }
  PH_INLINE static ClearPane of(const ThinDielectric& m) {
    return {m.color, m.ior, m.reflectance, m.transmittance};
  }
  PH_INLINE ClearPane whole() const { return *this; }
};

// Frosted
struct RoughPane {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;
  float roughness;

  struct From {
    float gain;
  };
  using To = From;
  using FromPlace = MetalPlace;
  using ToPlace = MetalPlace;

  PH_INLINE static bool fits(const ThinDielectric& m) { return !is_delta(m); }
  PH_INLINE static RoughPane of(const ThinDielectric& m) {
    return {m.color, m.ior, m.reflectance, m.transmittance, m.roughness};
  }
  PH_INLINE Microfacets facets() const { return microfacets(roughness, 0.0f, 0.0f); }
};

PH_INLINE MetalPlace place_to(const RoughPane& m, Vec3 wi) { return metal_place(m.facets(), wi); }
PH_INLINE MetalPlace place_from(const RoughPane& m, Vec3 wo) { return place_to(m, wo); }
inline RoughPane::To to(const RoughPane&, const MetalPlace& at) {
  return {metal_gain(Facets::ggx, at)};
}
inline RoughPane::From from(const RoughPane& m, const MetalPlace& at) { return to(m, at); }

// Share of the light that a pane mirrors at a cosine: r + (1 - r)^2 r (1 + r^2 + r^4 + ...)
PH_INLINE float mirrored_share(float ior, float cosine) {
  const float once = fresnel_dielectric(cosine, ior).reflected;
  return 2.0f * once / (1.0f + once);
}

struct ThinDielectricValue {
  Vec3 value;  // f |cos|
  float pdf;
};

// Of a clear one, also as ClearPane
template <class Material>
PH_INLINE bool sample_clear(const Material& m, Vec3 wo, float lobe, BsdfSample& out) {
  const bool mirrors = lobe < mirrored_share(m.ior, min(abs(wo.z), 1.0f));
  out.delta = true;
  out.wi = {-wo.x, -wo.y, mirrors ? wo.z : -wo.z};
  out.weight = m.color * select(mirrors, m.reflectance, m.transmittance);
  return true;
}
PH_INLINE ThinDielectricValue evaluate(const ClearPane&, Vec3, Vec3) { return {{0, 0, 0}, 0.0f}; }
PH_INLINE bool sample(const ClearPane& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  return sample_clear(m, wo, u.lobe, out);
}

// Of a frosted one, with metal_gain of both directions.
template <class Material>
PH_INLINE ThinDielectricValue rough_value(const Material& m, const Microfacets& d, float gain,
                                          Vec3 wo, Vec3 wi) {
  const bool mirrors = wo.z * wi.z > 0.0f, level = wo.z * wi.z == 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const Reflection r = reflection(d, wo, wi, true);
  const float share = mirrored_share(m.ior, min(r.facing, 1.0f));
  const float part = (mirrors ? share : 1.0f - share) * (level ? 0.0f : 1.0f);
  return {m.color * select(mirrors, m.reflectance, m.transmittance) * (part * gain * r.value),
          part * r.pdf};
}
template <class Material>
PH_INLINE bool choose_rough(const Material& m, const Microfacets& d, Vec3 wo, Vec2 number,
                            float lobe, Vec3& wi) {
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  const Vec3 normal = sample_visible_normal(d, above, number);
  const bool mirrors = lobe < mirrored_share(m.ior, clamp(dot(above, normal), 0.0f, 1.0f));
  wi = mirrored(above, normal);
  const bool found = wi.z > 0.0f;
  wi.z = copysign(wi.z, mirrors ? wo.z : -wo.z);
  return found;
}

// All of it is one lobe.
PH_INLINE LobeChances lobes(const RoughPane&, const RoughPane::From&) { return {1.0f, 0.0f}; }
PH_INLINE BsdfValue evaluate(const RoughPane& m, const RoughPane::From& seen,
                             const RoughPane::To& to, Vec3 wo, Vec3 wi) {
  const ThinDielectricValue v = rough_value(m, m.facets(), seen.gain * to.gain, wo, wi);
  return {v.value, v.pdf};
}
PH_INLINE bool choose(const RoughPane& m, const PickedLobe& lobe, Vec3 wo, Vec3& wi) {
  return choose_rough(m, m.facets(), wo, lobe.number, lobe.lobe, wi);
}

inline ThinDielectricValue evaluate(const ThinDielectric& m, Vec3 wo, Vec3 wi) {
  const Microfacets d = microfacets(m);
  if (smooth(d)) return {{0, 0, 0}, 0.0f};
  return rough_value(m, d, metal_gain(d, wo) * metal_gain(d, wi), wo, wi);
}

inline bool sample(const ThinDielectric& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const Microfacets d = microfacets(m);
  if (smooth(d)) return sample_clear(m, wo, u.lobe, out);
  if (!choose_rough(m, d, wo, u.direction, u.lobe, out.wi)) return false;
  const ThinDielectricValue v = evaluate(m, wo, out.wi);
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  return v.pdf > 0.0f;
}

}  // namespace parhelion::PH_ISA
