// Matte paint under a clear coat, smooth or rough: plastic, varnished wood, glazed ceramics.
//
// What the coat lets in is scattered by the base, thrown back by the coat's inside any number of
// times, and let out again: after Weidlich and Wilkie, "Arbitrarily Layered Micro-Facet Surfaces",
// GRAPHITE 2007, and Mitsuba's (rough)plastic. `compensation` "on": what a rough coat does not
// reflect at once goes into the base, and the mean reflected within follows from the mean outside
// by reciprocity, 1 - inside = (1 - outside) / ior^2, so that nothing is lost. "off": single
// bounces of the coat alone, as in Mitsuba.
#pragma once
#include "../bsdf.h"
#include "../microfacet.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

template <Facets kDistribution>
struct RoughPlastic;

struct Plastic {
  Vec3 color, specular;
  float ior, roughness, distribution, nonlinear, compensation;
  float mirror_pull;
  float inside;  // what thrown_back says, or 0 where that has not been asked yet

  using Plain =
      PlainForms<struct SmoothPlastic, RoughPlastic<Facets::ggx>, RoughPlastic<Facets::beckmann>>;
  static constexpr const char* doc = "matte base under a clear coat, smooth or rough";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.5f, 0.5f, 0.5f}, 0.0f, 1.0f, "share that the base reflects"},
      {"specular", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of the coat's reflection"},
      {"ior", 1, {1.49f}, 1.0f, 10.0f, "index of refraction of the coat over its surroundings"},
      {"roughness", 1, {0.0f}, 0.0f, 1.0f, "square root of the microfacets' alpha; 0 is smooth"},
      {"distribution", 1, {0.0f}, 0.0f, 1.0f, "of the microfacets' normals", "ggx|beckmann"},
      {"nonlinear",
       1,
       {0.0f},
       0.0f,
       1.0f,
       "whether light within the coat takes on the base's colour again and again",
       "off|on"},
      {"compensation", 1, {0.0f}, 0.0f, 1.0f, "light that bounces between microfacets", "on|off"},
  };
};

PH_INLINE bool is_delta(const Plastic&) { return false; }

PH_INLINE Microfacets facets(const Plastic& m) {
  return microfacets(m.roughness, 0.0f, m.distribution);
}
PH_INLINE Coat coat(const Plastic& m) { return make_coat(facets(m), m.ior); }

// What the coat lets in of the light from w, on either side.
inline float let_in(const Plastic& m, const Coat& c, Vec3 w) {
  return m.compensation < 0.5f ? 1.0f - coat_reflected(c, w) : coat_refracted(c, w);
}

// Share that the coat's inside throws back.
inline float thrown_back(const Plastic& m, const Coat& c) {
  const bool once = !c.smooth && m.compensation > 0.5f;
  return once ? coat_mean_within(c) : 1.0f - (1.0f - coat_mean(c)) / (m.ior * m.ior);
}

inline void derive(Plastic& m) { m.inside = thrown_back(m, coat(m)); }
inline float inside(const Plastic& m) {
  return m.inside > 0.0f ? m.inside : thrown_back(m, coat(m));
}

struct PlasticValue {
  Vec3 value;  // f |cos|, without a smooth coat's mirror image
  float pdf;
};

// What the base sends out, both directions above the surface. inside: share thrown back by the
// coat's inside; through: what the coat lets in of the light from both.
PH_INLINE Vec3 base_value(Vec3 color, float ior, float nonlinear, float inside, float through,
                          float cosine) {
  const auto base = [&](float c) { return c / (1.0f - inside * (nonlinear < 0.5f ? 1.0f : c)); };
  return Vec3{base(color.x), base(color.y), base(color.z)} * (through * cosine / (ior * ior));
}

// That a sample goes to the coat, `specular` being what counts of its reflection
PH_INLINE float coat_chance(Vec3 color, Vec3 specular, float through) {
  const float a = (1.0f - through) * mean(specular), b = through * mean(color), sum = a + b;
  return sum > 0.0f ? a / sum : 1.0f;
}

// Under a smooth coat
struct SmoothPlastic {
  Vec3 color, specular;
  float ior, nonlinear, inside, mirror_pull;

  PH_INLINE static bool fits(const Plastic& m) { return smooth(facets(m)); }
  PH_INLINE static SmoothPlastic of(const Plastic& m) {
    return {m.color, m.specular, m.ior, m.nonlinear, PH_ISA::inside(m), m.mirror_pull};
  }
  PH_INLINE SmoothPlastic whole() const { return *this; }
};

PH_INLINE float reflected(const SmoothPlastic& m, Vec3 w) {
  return fresnel_dielectric(min(abs(w.z), 1.0f), m.ior).reflected;
}

PH_INLINE float let_out(const SmoothPlastic& m, Vec3 wo) { return 1.0f - reflected(m, wo); }

PH_INLINE LobeChances lobes(const SmoothPlastic& m, Vec3 wo) {
  const float through = 1.0f - reflected(m, wo);
  const float coat = coat_chance(m.color, m.specular * (1.0f + m.mirror_pull), through);
  return {coat, 1.0f - coat};
}

PH_INLINE PlasticValue evaluate(const SmoothPlastic& m, Vec3 wo, Vec3 wi) {
  const float same_side = wo.z * wi.z > 0.0f ? 1.0f : 0.0f, from = 1.0f - reflected(m, wo);
  const float cosine = cosine_hemisphere_pdf({wi.x, wi.y, abs(wi.z)}) * same_side;
  const float through = from * (1.0f - reflected(m, wi));
  return {base_value(m.color, m.ior, m.nonlinear, m.inside, through, cosine),
          lobes(m, wo).other * cosine};
}

PH_INLINE bool sample(const SmoothPlastic& m, Vec3 wo, const PickedLobe& lobe, BsdfSample& out) {
  const float share = reflected(m, wo), chance = lobes(m, wo).first;
  const bool delta = lobe.first;
  const Vec3 above = {wo.x, wo.y, abs(wo.z)}, matte = cosine_hemisphere(lobe.number);
  const PlasticValue v = evaluate(m, above, matte);
  out.wi = select(delta, Vec3{-wo.x, -wo.y, wo.z}, Vec3{matte.x, matte.y, copysign(matte.z, wo.z)});
  out.weight = select(delta, m.specular * (share / chance), v.value * (1.0f / v.pdf));
  out.pdf = delta ? 0.0f : v.pdf;
  out.delta = delta;
  return delta | ((matte.z > 0.0f) & (v.pdf > 0.0f));
}
PH_INLINE bool sample(const SmoothPlastic& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  return sample(m, wo, pick(lobes(m, wo), u), out);
}

// Under a rough coat, on either side, of whose light it lets in `through` from both directions.
template <class Material>
PH_INLINE PlasticValue rough_value(const Material& m, const Microfacets& d, float inside,
                                   float chance, float through, Vec3 wo, Vec3 wi) {
  const float same_side = wo.z * wi.z > 0.0f ? 1.0f : 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const float cosine = cosine_hemisphere_pdf(wi) * same_side;
  const Reflection f = reflection(d, wo, wi, false);
  const float share = fresnel_dielectric(min(f.facing, 1.0f), m.ior).reflected;
  return {base_value(m.color, m.ior, m.nonlinear, inside, through, cosine) +
              m.specular * (share * f.value * same_side),
          (1.0f - chance) * cosine + chance * (f.pdf * same_side)};
}

template <Facets kDistribution>
struct RoughPlastic {
  Vec3 color, specular;
  float ior, roughness, nonlinear, compensation, inside;  // inside: as in Plastic

  struct From {
    float let_in, inside;
  };
  struct To {
    float let_in;
  };
  using FromPlace = CoatPlace;
  using ToPlace = CoatPlace;

  PH_INLINE static bool fits(const Plastic& m) {
    const Microfacets d = facets(m);
    return d.distribution == kDistribution && !smooth(d);
  }
  PH_INLINE static RoughPlastic of(const Plastic& m) {
    return {m.color, m.specular, m.ior, m.roughness, m.nonlinear, m.compensation, m.inside};
  }
  PH_INLINE Plastic whole() const {
    const float distribution = static_cast<float>(kDistribution);
    return {color, specular, ior, roughness, distribution, nonlinear, compensation, 0.0f, inside};
  }
};

template <Facets kDistribution>
PH_INLINE CoatPlace place_to(const RoughPlastic<kDistribution>& m, Vec3 wi) {
  return coat_place(coat(m.whole()), wi);
}
template <Facets kDistribution>
PH_INLINE CoatPlace place_from(const RoughPlastic<kDistribution>& m, Vec3 wo) {
  return place_to(m, wo);
}
template <Facets kDistribution>
inline auto to(const RoughPlastic<kDistribution>& m, const CoatPlace& at) {
  const float let_in = m.compensation < 0.5f ? 1.0f - coat_reflected(kDistribution, at)
                                             : coat_refracted(kDistribution, at);
  return typename RoughPlastic<kDistribution>::To{let_in};
}
template <Facets kDistribution>
inline auto from(const RoughPlastic<kDistribution>& m, const CoatPlace& at) {
  return typename RoughPlastic<kDistribution>::From{to(m, at).let_in, inside(m.whole())};
}

template <Facets kDistribution>
PH_INLINE Gloss gloss(const RoughPlastic<kDistribution>& m,
                      const typename RoughPlastic<kDistribution>::From& seen, Vec3 wo) {
  const float coat = (1.0f - seen.let_in) * mean(m.specular);
  return gloss_of(facets(m.whole()), coat, seen.let_in * mean(m.color), wo);
}

template <Facets kDistribution>
PH_INLINE LobeChances lobes(const RoughPlastic<kDistribution>& m,
                            const typename RoughPlastic<kDistribution>::From& seen) {
  const float coat = coat_chance(m.color, m.specular, seen.let_in);
  return {coat, 1.0f - coat};
}

template <Facets kDistribution>
PH_INLINE BsdfValue evaluate(const RoughPlastic<kDistribution>& m,
                             const typename RoughPlastic<kDistribution>::From& seen,
                             const typename RoughPlastic<kDistribution>::To& to, Vec3 wo, Vec3 wi) {
  const PlasticValue v = rough_value(m, facets(m.whole()), seen.inside, lobes(m, seen).first,
                                     seen.let_in * to.let_in, wo, wi);
  return {v.value, v.pdf};
}

template <Facets kDistribution>
PH_INLINE bool choose(const RoughPlastic<kDistribution>& m, const PickedLobe& lobe, Vec3 wo,
                      Vec3& wi) {
  return mirror_or_matte(facets(m.whole()), lobe.first, lobe.number, wo, wi);
}

// Plastic as seen from wo, on either side: what does not depend on wi.
struct SeenPlastic {
  Coat coat;
  float let_in;
  float inside;  // share thrown back by the coat's inside
  float chance;  // that a sample goes to the coat
};

inline SeenPlastic prepare(const Plastic& m, Vec3 wo) {
  const Coat c = coat(m);
  const float through = let_in(m, c, wo);
  return {c, through, inside(m), coat_chance(m.color, m.specular, through)};
}

PH_INLINE SmoothPlastic smooth_plastic(const Plastic& m, const SeenPlastic& seen) {
  return {m.color, m.specular, m.ior, m.nonlinear, seen.inside, m.mirror_pull};
}

inline PlasticValue evaluate(const Plastic& m, const SeenPlastic& seen, Vec3 wo, Vec3 wi) {
  if (seen.coat.smooth) return evaluate(smooth_plastic(m, seen), wo, wi);
  return rough_value(m, seen.coat.facets, seen.inside, seen.chance,
                     seen.let_in * let_in(m, seen.coat, wi), wo, wi);
}

inline bool sample(const Plastic& m, const SeenPlastic& seen, Vec3 wo, const BsdfDraws& u,
                   BsdfSample& out) {
  if (seen.coat.smooth) return sample(smooth_plastic(m, seen), wo, u, out);
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  Vec2 number = u.direction;
  out.wi = first_lobe(seen.chance, 1.0f - seen.chance, number)
               ? mirrored(above, sample_visible_normal(seen.coat.facets, above, number))
               : cosine_hemisphere(number);
  if (!(out.wi.z > 0.0f)) return false;
  const PlasticValue v = evaluate(m, seen, above, out.wi);
  if (!(v.pdf > 0.0f)) return false;
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  out.wi.z = copysign(out.wi.z, wo.z);
  return true;
}

// Colour for pictures of albedo.
PH_INLINE Vec3 albedo(const Plastic& m) { return m.color; }

}  // namespace parhelion::PH_ISA
