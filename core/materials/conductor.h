// Metal, polished or rough: Fresnel's equations for a complex index of refraction on microfacets.
#pragma once
#include "../bsdf.h"
#include "../fresnel.h"
#include "../microfacet.h"

namespace parhelion::PH_ISA {

template <Facets kDistribution>
struct PlainConductor;
template <Facets kDistribution, bool kBrushed>
struct CompensatedConductor;

struct Conductor {
  Vec3 color, eta, k;
  float roughness, anisotropy, distribution, compensation;

  using Plain = PlainForms<
      struct Mirror, PlainConductor<Facets::ggx>, PlainConductor<Facets::beckmann>,
      CompensatedConductor<Facets::ggx, false>, CompensatedConductor<Facets::beckmann, false>,
      CompensatedConductor<Facets::ggx, true>, CompensatedConductor<Facets::beckmann, true>>;
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

struct Mirror {
  Vec3 color, eta, k;

  PH_INLINE static bool fits(const Conductor& m) { return is_delta(m); }
  PH_INLINE static Mirror of(const Conductor& m) { return {m.color, m.eta, m.k}; }
  PH_INLINE Mirror whole() const { return *this; }
};

// Rough, of single bounces
template <Facets kDistribution>
struct PlainConductor {
  Vec3 color, eta, k;
  float roughness, anisotropy;

  PH_INLINE static bool fits(const Conductor& m) {
    const Microfacets d = microfacets(m);
    return d.distribution == kDistribution && m.compensation >= 0.5f && !smooth(d);
  }
  PH_INLINE static PlainConductor of(const Conductor& m) {
    return {m.color, m.eta, m.k, m.roughness, m.anisotropy};
  }
  PH_INLINE PlainConductor whole() const { return *this; }
  PH_INLINE Microfacets facets() const {
    return microfacets(roughness, anisotropy, static_cast<float>(kDistribution));
  }
};

template <Facets kDistribution>
PH_INLINE Gloss gloss(const PlainConductor<kDistribution>& m, Vec3 wo) {
  return gloss_of(m.facets(), 1.0f, 0.0f, wo);
}

struct ConductorValue {
  Vec3 value;
  float pdf;
};

// A conductor as seen from wo, on either side: what does not depend on wi.
struct SeenConductor {
  Microfacets facets;
  float gain;  // metal_gain(wo), where light that bounces between microfacets counts
};

PH_INLINE SeenConductor prepare(const Conductor& m, Vec3 wo) {
  const Microfacets d = microfacets(m);
  const bool all = m.compensation < 0.5f;
  return {d, all && !smooth(d) ? metal_gain(d, {wo.x, wo.y, abs(wo.z)}) : 1.0f};
}

// Of a rough one: of single bounces, or of all, with metal_gain of both directions.
template <class Material>
PH_INLINE ConductorValue rough_value(const Material& m, const Microfacets& facets, bool all,
                                     float gain, Vec3 wo, Vec3 wi) {
  const float same_side = wo.z * wi.z > 0.0f ? 1.0f : 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const Reflection r = reflection(facets, wo, wi, all);
  Vec3 share = fresnel_conductor(min(r.facing, 1.0f), m.eta, m.k);
  if (all) share = reflected(share, gain);
  return {m.color * share * (same_side * r.value), same_side * r.pdf};
}

// Samples a rough one, of which value(wo, wi) is known, by what is visible from wo of its facets.
template <class Value>
PH_INLINE bool sample_rough(const Microfacets& facets, Vec3 wo, Vec2 u, BsdfSample& out,
                            Value&& value) {
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  const Vec3 wi = mirrored(above, sample_visible_normal(facets, above, u));
  const ConductorValue f = value(above, wi);
  out.wi = {wi.x, wi.y, copysign(wi.z, wo.z)};
  out.weight = f.value * (1.0f / f.pdf);
  out.pdf = f.pdf;
  return (wi.z > 0.0f) & (f.pdf > 0.0f);
}

template <Facets kDistribution>
PH_INLINE ConductorValue evaluate(const PlainConductor<kDistribution>& m, Vec3 wo, Vec3 wi) {
  return rough_value(m, m.facets(), false, 1.0f, wo, wi);
}
template <Facets kDistribution>
PH_INLINE bool sample(const PlainConductor<kDistribution>& m, Vec3 wo, const BsdfDraws& u,
                      BsdfSample& out) {
  return sample_rough(m.facets(), wo, u.direction, out,
                      [&](Vec3 from, Vec3 to) { return evaluate(m, from, to); });
}

// A smooth one, also as Mirror
template <class Material>
PH_INLINE bool mirror(const Material& m, Vec3 wo, BsdfSample& out) {
  out.wi = {-wo.x, -wo.y, wo.z};
  out.weight = m.color * fresnel_conductor(abs(wo.z), m.eta, m.k);
  out.delta = true;
  return true;
}
PH_INLINE ConductorValue evaluate(const Mirror&, Vec3, Vec3) { return {{0, 0, 0}, 0.0f}; }
PH_INLINE bool sample(const Mirror& m, Vec3 wo, const BsdfDraws&, BsdfSample& out) {
  return mirror(m, wo, out);
}

// Rough, isotropic or brushed, of all bounces
template <Facets kDistribution, bool kBrushed>
struct CompensatedConductor {
  Vec3 color, eta, k;
  float roughness, anisotropy;

  struct From {
    float gain;
  };
  using To = From;

  PH_INLINE Microfacets facets() const {
    return microfacets(roughness, kBrushed ? anisotropy : 0.0f, static_cast<float>(kDistribution));
  }
  using ToPlace = decltype(place_of_metal<kBrushed>(Microfacets{}, Vec3{}));
  using FromPlace = ToPlace;

  PH_INLINE static bool fits(const Conductor& m) {
    const Microfacets d = microfacets(m);
    return d.distribution == kDistribution && m.compensation < 0.5f &&
           (kBrushed ? !isotropic(d) : m.anisotropy == 0.0f) && !smooth(d);
  }
  PH_INLINE static CompensatedConductor of(const Conductor& m) {
    return {m.color, m.eta, m.k, m.roughness, m.anisotropy};
  }
};

template <Facets kDistribution, bool kBrushed>
PH_INLINE auto place_to(const CompensatedConductor<kDistribution, kBrushed>& m, Vec3 wi) {
  return place_of_metal<kBrushed>(m.facets(), wi);
}
template <Facets kDistribution, bool kBrushed>
PH_INLINE auto place_from(const CompensatedConductor<kDistribution, kBrushed>& m, Vec3 wo) {
  return place_to(m, wo);
}
template <Facets kDistribution, bool kBrushed>
inline auto to(const CompensatedConductor<kDistribution, kBrushed>&,
               const typename CompensatedConductor<kDistribution, kBrushed>::ToPlace& at) {
  return typename CompensatedConductor<kDistribution, kBrushed>::To{metal_gain(kDistribution, at)};
}
template <Facets kDistribution, bool kBrushed>
inline auto from(const CompensatedConductor<kDistribution, kBrushed>& m,
                 const typename CompensatedConductor<kDistribution, kBrushed>::ToPlace& at) {
  return to(m, at);
}

template <Facets kDistribution, bool kBrushed>
PH_INLINE Gloss gloss(const CompensatedConductor<kDistribution, kBrushed>& m,
                      const typename CompensatedConductor<kDistribution, kBrushed>::From&,
                      Vec3 wo) {
  return gloss_of(m.facets(), 1.0f, 0.0f, wo);
}

// All of it is one lobe.
template <Facets kDistribution, bool kBrushed>
PH_INLINE LobeChances lobes(const CompensatedConductor<kDistribution, kBrushed>&,
                            const typename CompensatedConductor<kDistribution, kBrushed>::From&) {
  return {1.0f, 0.0f};
}

template <Facets kDistribution, bool kBrushed>
PH_INLINE BsdfValue
evaluate(const CompensatedConductor<kDistribution, kBrushed>& m,
         const typename CompensatedConductor<kDistribution, kBrushed>::From& seen,
         const typename CompensatedConductor<kDistribution, kBrushed>::To& to, Vec3 wo, Vec3 wi) {
  const ConductorValue v = rough_value(m, m.facets(), true, seen.gain * to.gain, wo, wi);
  return {v.value, v.pdf};
}

template <Facets kDistribution, bool kBrushed>
PH_INLINE bool choose(const CompensatedConductor<kDistribution, kBrushed>& m,
                      const PickedLobe& lobe, Vec3 wo, Vec3& wi) {
  return mirror_or_matte(m.facets(), true, lobe.number, wo, wi);
}

PH_INLINE ConductorValue rough_value(const Conductor& m, const SeenConductor& seen, Vec3 wo,
                                     Vec3 wi) {
  const bool all = m.compensation < 0.5f;
  const float gain = all ? seen.gain * metal_gain(seen.facets, {wi.x, wi.y, abs(wi.z)}) : 1.0f;
  return rough_value(m, seen.facets, all, gain, wo, wi);
}

PH_INLINE ConductorValue evaluate(const Conductor& m, const SeenConductor& seen, Vec3 wo, Vec3 wi) {
  if (smooth(seen.facets)) return {{0, 0, 0}, 0.0f};
  return rough_value(m, seen, wo, wi);
}

PH_INLINE bool sample(const Conductor& m, const SeenConductor& seen, Vec3 wo, const BsdfDraws& u,
                      BsdfSample& out) {
  if (smooth(seen.facets)) return mirror(m, wo, out);
  return sample_rough(seen.facets, wo, u.direction, out,
                      [&](Vec3 from, Vec3 to) { return rough_value(m, seen, from, to); });
}

}  // namespace parhelion::PH_ISA
