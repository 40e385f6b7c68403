// Clear glass or water, smooth or frosted: reflects and refracts by Fresnel's equations, exactly.
//
// `ior` is the index inside the surface over the index outside. A bubble, or the inner wall of a
// hollow sphere, is a sphere whose ior is below 1: air in glass has 1 / 1.5.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"
#include "../microfacet.h"

namespace parhelion::PH_ISA {

struct Dielectric {
  Vec3 color;
  float ior, roughness, anisotropy, distribution, compensation;
  Vec3 reflectance, transmittance;
  float dispersion;
  float mirror_pull;

  using Plain = PlainForms<struct PlainDielectric>;
  static constexpr bool transmits = true;
  static constexpr bool lobe_draws = true;
  static constexpr const char* doc = "glass, smooth or frosted: reflects and refracts";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of the light at each crossing"},
      {"ior", 1, {1.5f}, 0.1f, 10.0f, "index of refraction, inside over outside"},
      {"roughness", 1, {0.0f}, 0.0f, 1.0f, "square root of the microfacets' alpha; 0 is clear"},
      {"anisotropy", 1, {0.0f}, -0.99f, 0.99f, "above 0 highlights stretch along u"},
      {"distribution", 1, {0.0f}, 0.0f, 1.0f, "of the microfacets' normals", "ggx|beckmann"},
      {"compensation", 1, {0.0f}, 0.0f, 1.0f, "light that bounces between microfacets", "on|off"},
      {"reflectance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what is reflected"},
      {"transmittance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "further tint of what is refracted"},
      {"dispersion", 1, {0.0f}, 0.0f, 10.0f, "20 over Abbe's number: 0.36 is diamond, 0 is none"},
  };
};

PH_INLINE Microfacets microfacets(const Dielectric& m) {
  return microfacets(m.roughness, m.anisotropy, m.distribution);
}

// Clear
struct PlainDielectric {
  Vec3 color;
  float ior;
  Vec3 reflectance, transmittance;
  float mirror_pull;

  PH_INLINE static bool fits(const Dielectric& m) { return m.roughness == 0.0f; }
  PH_INLINE static PlainDielectric of(const Dielectric& m) {
    return {m.color, m.ior, m.reflectance, m.transmittance, m.mirror_pull};
  }
  PH_INLINE Dielectric whole() const {
    return {color, ior, 0.0f, 0.0f, 0.0f, 0.0f, reflectance, transmittance, 0.0f, mirror_pull};
  }
};

// Refraction narrows a lobe by the contrast of the indices. That roughness 0 is smooth is said
// apart for compilers, which know it of the plain form.
PH_INLINE bool smooth(const Dielectric& m, const Microfacets& d) {
  return m.roughness == 0.0f ||
         max(d.alpha_u, d.alpha_v) * min(1.0f, abs(m.ior - 1.0f)) <= kSmoothAlpha;
}

PH_INLINE bool is_delta(const Dielectric& m) { return smooth(m, microfacets(m)); }

// Before masking: density, and what it is tinted by as radiance.
struct DielectricLobe {
  Vec3 tint;
  float pdf;
};

// wo above the surface; eta is the index of the side below over that above.
inline DielectricLobe lobe(const Dielectric& m, const Microfacets& d, float eta, Vec3 wo, Vec3 wi) {
  const bool reflects = wi.z > 0.0f;
  if (!(wo.z > 0.0f) || wi.z == 0.0f) return {{0, 0, 0}, 0.0f};
  // Each half vector is the normal of the facet that takes wo to wi.
  Vec3 half = reflects ? wo + wi : wo + wi * eta;
  half = normalize(half);
  half = half * copysign(1.0f, half.z);
  const float facing = dot(wo, half), beyond = dot(wi, half);
  if (!(facing > 0.0f) || (beyond > 0.0f) != reflects) return {{0, 0, 0}, 0.0f};
  const float share = fresnel_dielectric(min(facing, 1.0f), eta).reflected;
  const float density = visible_density(d, wo, half);
  if (reflects) return {m.color * m.reflectance, share * density / (4.0f * facing)};
  // Walter et al. 2007, equation 17; radiance is squeezed into a narrower cone where the index is
  // higher (Veach 1997, 5.2).
  const float root = facing + eta * beyond;
  return {m.color * m.transmittance * (1.0f / (eta * eta)),
          (1.0f - share) * density * eta * eta * abs(beyond) / (root * root)};
}

struct DielectricValue {
  Vec3 value;  // f |cos|, of radiance
  float pdf;
};

// Glass as seen from above, with the index eta of the side below over that above.
struct SeenDielectric {
  Microfacets facets;
  float eta;
  float albedo;  // of single bounces, where light that bounces on between microfacets counts
};

inline SeenDielectric seen_above(const Dielectric& m, const Microfacets& d, float eta, Vec3 wo) {
  return {d, eta, m.compensation < 0.5f ? glass_albedo(d, wo, eta) : 1.0f};
}

// Of a rough one, from above
inline DielectricValue rough_value(const Dielectric& m, const SeenDielectric& seen, Vec3 wo,
                                   Vec3 wi) {
  const DielectricLobe f = lobe(m, seen.facets, seen.eta, wo, wi);
  if (!(f.pdf > 0.0f)) return {{0, 0, 0}, 0.0f};
  const float left = shadowing(seen.facets, wo, wi, m.compensation < 0.5f) / seen.albedo;
  return {f.tint * (f.pdf * left), f.pdf};
}

// From wo, on either side
PH_INLINE SeenDielectric prepare(const Dielectric& m, Vec3 wo) {
  const Microfacets d = microfacets(m);
  const float eta = copysign(1.0f, wo.z) > 0.0f ? m.ior : 1.0f / m.ior;
  if (smooth(m, d)) return {d, eta, 1.0f};
  return seen_above(m, d, eta, {wo.x, wo.y, abs(wo.z)});
}

PH_INLINE DielectricValue evaluate(const Dielectric& m, const SeenDielectric& seen, Vec3 wo,
                                   Vec3 wi) {
  if (smooth(m, seen.facets)) return {{0, 0, 0}, 0.0f};
  const float side = copysign(1.0f, wo.z);
  wo.z *= side;
  wi.z *= side;
  return rough_value(m, seen, wo, wi);
}

PH_INLINE bool sample(const Dielectric& m, const SeenDielectric& seen, Vec3 wo, const BsdfDraws& u,
                      BsdfSample& out) {
  const float side = copysign(1.0f, wo.z);
  const float eta = seen.eta;  // far side over near side
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  const bool delta = smooth(m, seen.facets);
  const Vec3 normal =
      delta ? Vec3{0, 0, 1} : sample_visible_normal(seen.facets, above, u.direction);
  const float facing = dot(above, normal);
  const Fresnel f = fresnel_dielectric(clamp(facing, 0.0f, 1.0f), eta);
  const float pull = delta ? 1.0f + m.mirror_pull : 1.0f, pulled = f.reflected * pull;
  const float sum = pulled + (1.0f - f.reflected);
  const bool reflects = u.lobe * sum < pulled;
  const float scale = 1.0f / eta;
  if (delta) {
    out.delta = true;
    out.wi =
        reflects ? Vec3{-wo.x, -wo.y, wo.z} : Vec3{-wo.x * scale, -wo.y * scale, -side * f.cos_t};
    out.weight = m.color * (reflects ? m.reflectance * (sum / pull)
                                     : m.transmittance * (scale * scale * sum));
    if (!reflects) out.eta = eta;
    return true;
  }
  out.wi = reflects ? mirrored(above, normal)
                    : normalize(normal * (facing * scale - f.cos_t) - above * scale);
  const DielectricValue v = rough_value(m, seen, above, out.wi);
  if ((out.wi.z > 0.0f) != reflects || !(v.pdf > 0.0f)) return false;
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  if (!reflects) out.eta = eta;
  out.wi.z *= side;
  return true;
}

}  // namespace parhelion::PH_ISA
