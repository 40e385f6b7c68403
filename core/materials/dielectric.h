// Clear glass or water, smooth or frosted: reflects and refracts by Fresnel's equations, exactly.
//
// `ior` is the index inside the surface over the index outside. A bubble, or the inner wall of a
// hollow sphere, is a sphere whose ior is below 1: air in glass has 1 / 1.5.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"
#include "../microfacet.h"

namespace parhelion::PH_ISA {

template <Facets kDistribution>
struct RoughDielectric;
template <Facets kDistribution>
struct CompensatedDielectric;

struct Dielectric {
  Vec3 color;
  float ior, roughness, anisotropy, distribution, compensation;
  Vec3 reflectance, transmittance;
  float dispersion;
  float mirror_pull;

  using Plain = PlainForms<struct PlainDielectric, RoughDielectric<Facets::ggx>,
                           RoughDielectric<Facets::beckmann>, CompensatedDielectric<Facets::ggx>,
                           CompensatedDielectric<Facets::beckmann>>;
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

// Frosted glass as seen from one side: what does not depend on wi.
struct Frosted {
  Vec3 reflectance, transmittance;  // the material's times its colour
  float ior;
  Microfacets facets;
  float albedo;      // of single bounces, where light that bounces on between microfacets counts,
  float correlated;  // which is where this is 1; else it is 0, and the albedo 1
};

// Index of the far side over that of wo's own.
PH_INLINE float far_index(float ior, Vec3 wo) {
  return copysign(1.0f, wo.z) > 0.0f ? ior : 1.0f / ior;
}

PH_INLINE Frosted frosted(Vec3 reflectance, Vec3 transmittance, float ior, const Microfacets& d,
                          float compensation, float albedo) {
  return {reflectance, transmittance, ior, d, albedo, compensation < 0.5f ? 1.0f : 0.0f};
}

inline float frosted_albedo(const Microfacets& d, float ior, float compensation, Vec3 wo) {
  return compensation < 0.5f ? glass_albedo(d, {wo.x, wo.y, abs(wo.z)}, far_index(ior, wo)) : 1.0f;
}

struct DielectricValue {
  Vec3 value;  // f |cos|, of radiance
  float pdf;
};

// Both for wo above the surface, with the index eta of the side below over that above, and without
// branches.
PH_INLINE DielectricValue rough_value(const Frosted& m, float eta, Vec3 wo, Vec3 wi) {
  const bool reflects = wi.z > 0.0f, above = wo.z > 0.0f;
  wo.z = max(wo.z, 1e-9f);
  // Each half vector is the normal of the facet that takes wo to wi.
  Vec3 half = wo + wi * (reflects ? 1.0f : eta);
  half = half * (copysign(1.0f, half.z) / sqrt(max(dot(half, half), 1e-30f)));
  const float facing = dot(wo, half), beyond = dot(wi, half);
  const bool can = above & (facing > 0.0f) & ((beyond > 0.0f) == reflects) & (wi.z != 0.0f);
  const float share = fresnel_dielectric(clamp(facing, 0.0f, 1.0f), eta).reflected;
  const float seen = visible_share(m.facets, wo), lit = visible_share(m.facets, wi);
  const float density = normal_density(m.facets, half) * seen / wo.z * (can ? 1.0f : 0.0f);
  // Walter et al. 2007, equation 17; radiance is squeezed into a narrower cone where the index is
  // higher (Veach 1997, 5.2).
  const float root = facing + eta * beyond, squeezed = 1.0f / (eta * eta);
  const float turned = facing * eta * eta * abs(beyond) / max(root * root, 1e-30f);
  const float pdf = density * (reflects ? share * 0.25f : (1.0f - share) * turned);
  // As in shadowing(), of heights that are correlated or not.
  const float both = m.correlated * (seen + lit - seen * lit) + (1.0f - m.correlated);
  const float left = pdf * lit / (max(both, 1e-30f) * m.albedo);
  return {select(reflects, m.reflectance, m.transmittance * squeezed) * left, pdf};
}

// False where what is reflected would be below the surface, or what is refracted above it.
PH_INLINE bool choose_rough(const Frosted& m, float eta, Vec3 wo, const BsdfDraws& u, Vec3& wi) {
  const Vec3 normal = sample_visible_normal(m.facets, wo, u.direction);
  const float facing = dot(wo, normal), scale = 1.0f / eta;
  const Fresnel f = fresnel_dielectric(clamp(facing, 0.0f, 1.0f), eta);
  const bool reflects = u.lobe < f.reflected;
  wi = select(reflects, mirrored(wo, normal),
              normalize(normal * (facing * scale - f.cos_t) - wo * scale));
  return (wi.z > 0.0f) == reflects;
}

// From wo, on either side
PH_INLINE DielectricValue evaluate(const Frosted& m, Vec3 wo, Vec3 wi) {
  const float side = copysign(1.0f, wo.z);
  return rough_value(m, far_index(m.ior, wo), {wo.x, wo.y, wo.z * side}, {wi.x, wi.y, wi.z * side});
}
PH_INLINE bool sample(const Frosted& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const float side = copysign(1.0f, wo.z);
  const float eta = far_index(m.ior, wo);
  const Vec3 above = {wo.x, wo.y, wo.z * side};
  const bool found = choose_rough(m, eta, above, u, out.wi);
  const DielectricValue v = rough_value(m, eta, above, out.wi);
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  out.eta = out.wi.z > 0.0f ? 1.0f : eta;
  out.wi.z *= side;
  return found & (v.pdf > 0.0f);
}

// Frosted, of single bounces
template <Facets kDistribution>
struct RoughDielectric {
  Vec3 reflectance, transmittance;
  float ior, roughness, anisotropy;

  PH_INLINE static bool fits(const Dielectric& m) {
    const Microfacets d = microfacets(m);
    return d.distribution == kDistribution && m.compensation >= 0.5f && !smooth(m, d);
  }
  PH_INLINE static RoughDielectric of(const Dielectric& m) {
    return {m.color * m.reflectance, m.color * m.transmittance, m.ior, m.roughness, m.anisotropy};
  }
  PH_INLINE Microfacets facets() const {
    return microfacets(roughness, anisotropy, static_cast<float>(kDistribution));
  }
  PH_INLINE Frosted whole() const {
    return frosted(reflectance, transmittance, ior, facets(), 1.0f, 1.0f);
  }
};

// and of all
template <Facets kDistribution>
struct CompensatedDielectric {
  Vec3 reflectance, transmittance;
  float ior, roughness, anisotropy;

  struct From {
    float albedo;
  };
  struct FromPlace {
    GlassPlace place;  // of isotropic ones
    Vec3 wo;
  };

  PH_INLINE static bool fits(const Dielectric& m) {
    const Microfacets d = microfacets(m);
    return d.distribution == kDistribution && m.compensation < 0.5f && !smooth(m, d);
  }
  PH_INLINE static CompensatedDielectric of(const Dielectric& m) {
    return {m.color * m.reflectance, m.color * m.transmittance, m.ior, m.roughness, m.anisotropy};
  }
  PH_INLINE Microfacets facets() const {
    return microfacets(roughness, anisotropy, static_cast<float>(kDistribution));
  }
  PH_INLINE Frosted whole(const From& seen) const {
    return frosted(reflectance, transmittance, ior, facets(), 0.0f, seen.albedo);
  }
};

template <Facets kDistribution>
PH_INLINE auto place_from(const CompensatedDielectric<kDistribution>& m, Vec3 wo) {
  return typename CompensatedDielectric<kDistribution>::FromPlace{
      glass_place(m.facets(), wo, far_index(m.ior, wo)), wo};
}
template <Facets kDistribution>
inline auto from(const CompensatedDielectric<kDistribution>& m,
                 const typename CompensatedDielectric<kDistribution>::FromPlace& at) {
  const Microfacets d = m.facets();
  const float albedo =
      isotropic(d) ? glass_albedo(kDistribution, at.place) : frosted_albedo(d, m.ior, 0.0f, at.wo);
  return typename CompensatedDielectric<kDistribution>::From{albedo};
}

// Glass as seen from wo, on either side
struct SeenDielectric {
  Microfacets facets;
  float albedo;  // as in Frosted
};

PH_INLINE SeenDielectric prepare(const Dielectric& m, Vec3 wo) {
  const Microfacets d = microfacets(m);
  return {d, smooth(m, d) ? 1.0f : frosted_albedo(d, m.ior, m.compensation, wo)};
}

PH_INLINE Frosted frosted(const Dielectric& m, const SeenDielectric& seen) {
  return frosted(m.color * m.reflectance, m.color * m.transmittance, m.ior, seen.facets,
                 m.compensation, seen.albedo);
}

PH_INLINE DielectricValue evaluate(const Dielectric& m, const SeenDielectric& seen, Vec3 wo,
                                   Vec3 wi) {
  if (smooth(m, seen.facets)) return {{0, 0, 0}, 0.0f};
  return evaluate(frosted(m, seen), wo, wi);
}

PH_INLINE bool sample(const Dielectric& m, const SeenDielectric& seen, Vec3 wo, const BsdfDraws& u,
                      BsdfSample& out) {
  if (!smooth(m, seen.facets)) return sample(frosted(m, seen), wo, u, out);
  const float side = copysign(1.0f, wo.z), eta = far_index(m.ior, wo);
  const Fresnel f = fresnel_dielectric(clamp(abs(wo.z), 0.0f, 1.0f), eta);
  const float pull = 1.0f + m.mirror_pull, pulled = f.reflected * pull;
  const float sum = pulled + (1.0f - f.reflected);
  const bool reflects = u.lobe * sum < pulled;
  const float scale = 1.0f / eta;
  out.delta = true;
  out.wi =
      reflects ? Vec3{-wo.x, -wo.y, wo.z} : Vec3{-wo.x * scale, -wo.y * scale, -side * f.cos_t};
  out.weight =
      m.color * (reflects ? m.reflectance * (sum / pull) : m.transmittance * (scale * scale * sum));
  if (!reflects) out.eta = eta;
  return true;
}

}  // namespace parhelion::PH_ISA
