// Metal, polished or rough: Fresnel's equations for a complex index of refraction on microfacets.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"
#include "../microfacet.h"

namespace parhelion::PH_ISA {

struct Conductor {
  Vec3 color, eta, k;
  float roughness, anisotropy, distribution, compensation;

  static constexpr const char* doc = "metal by its complex index of refraction, smooth or rough";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of the reflection"},
      {"eta", 3, {0.0f, 0.0f, 0.0f}, 0.0f, 100.0f, "index of refraction; 0 reflects everything"},
      {"k", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 100.0f, "extinction coefficient"},
      {"roughness", 1, {0.0f}, 0.0f, 1.0f, "square root of the microfacets' alpha; 0 a mirror"},
      {"anisotropy", 1, {0.0f}, -0.99f, 0.99f, "above 0 highlights stretch along u"},
      {"distribution", 1, {0.0f}, 0.0f, 1.0f, "of the microfacets' normals", "ggx|beckmann"},
      {"compensation", 1, {0.0f}, 0.0f, 1.0f, "light that bounces between microfacets", "on|off"},
  };
};

PH_INLINE Microfacets microfacets(const Conductor& m) {
  return microfacets(m.roughness, m.anisotropy, m.distribution);
}

PH_INLINE bool is_delta(const Conductor& m) { return smooth(microfacets(m)); }

// Share reflected, all bounces: with one bounce `gain` times too dark for a white metal, the n-th
// bounce adds its power of Fresnel's share.
PH_INLINE Vec3 reflected(Vec3 share, float gain) {
  const auto all = [gain](float f) { return f * gain / (gain - f * (gain - 1.0f)); };
  return {all(share.x), all(share.y), all(share.z)};
}

struct ConductorValue {
  Vec3 value;
  float pdf;
};

inline ConductorValue evaluate(const Conductor& m, const Microfacets& d, Vec3 wo, Vec3 wi) {
  if (!(wo.z * wi.z > 0.0f)) return {{0, 0, 0}, 0.0f};
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const bool all = m.compensation < 0.5f;
  const Reflection r = reflection(d, wo, wi, all);
  Vec3 share = fresnel_conductor(min(r.facing, 1.0f), m.eta, m.k);
  if (all) share = reflected(share, metal_gain(d, wo) * metal_gain(d, wi));
  return {m.color * share * r.value, r.pdf};
}

inline Vec3 eval(const Conductor& m, Vec3 wo, Vec3 wi) {
  const Microfacets d = microfacets(m);
  return smooth(d) ? Vec3{0, 0, 0} : evaluate(m, d, wo, wi).value;
}

inline float pdf(const Conductor& m, Vec3 wo, Vec3 wi) {
  const Microfacets d = microfacets(m);
  if (smooth(d) || !(wo.z * wi.z > 0.0f)) return 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  return reflection(d, wo, wi, false).pdf;
}

inline bool sample(const Conductor& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const Microfacets d = microfacets(m);
  if (smooth(d)) {
    out.wi = {-wo.x, -wo.y, wo.z};
    out.weight = m.color * fresnel_conductor(abs(wo.z), m.eta, m.k);
    out.delta = true;
    return true;
  }
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  out.wi = mirrored(above, sample_visible_normal(d, above, u.direction));
  if (!(out.wi.z > 0.0f)) return false;
  const ConductorValue f = evaluate(m, d, above, out.wi);
  out.pdf = f.pdf;
  if (!(out.pdf > 0.0f)) return false;
  out.weight = f.value * (1.0f / f.pdf);
  out.wi.z = copysign(out.wi.z, wo.z);
  return true;
}

}  // namespace parhelion::PH_ISA
