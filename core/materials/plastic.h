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

struct Plastic {
  Vec3 color, specular;
  float ior, roughness, distribution, nonlinear, compensation;

  static constexpr u32 lobe_draws = 1;
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

PH_INLINE Coat coat(const Plastic& m) {
  return make_coat(microfacets(m.roughness, 0.0f, m.distribution), m.ior);
}

// What the coat lets in of the light from w, on either side.
inline float let_in(const Plastic& m, const Coat& c, Vec3 w) {
  return m.compensation < 0.5f ? 1.0f - coat_reflected(c, w) : coat_refracted(c, w);
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
  const bool once = !c.smooth && m.compensation > 0.5f;
  const float inside = once ? coat_mean_within(c) : 1.0f - (1.0f - coat_mean(c)) / (m.ior * m.ior);
  const float a = (1.0f - through) * mean(m.specular), b = through * mean(m.color);
  return {c, through, inside, a + b > 0.0f ? a / (a + b) : 1.0f};
}

struct PlasticValue {
  Vec3 value;  // f |cos|, without a smooth coat's mirror image
  float pdf;
};

inline PlasticValue evaluate(const Plastic& m, const SeenPlastic& seen, Vec3 wo, Vec3 wi) {
  if (!(wo.z * wi.z > 0.0f)) return {{0, 0, 0}, 0.0f};
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const Coat& c = seen.coat;
  const float through = seen.let_in * let_in(m, c, wi);
  const auto base = [&](float color) {
    const float again = m.nonlinear < 0.5f ? seen.inside : seen.inside * color;
    return color / (1.0f - again);
  };
  const float cosine = cosine_hemisphere_pdf(wi);
  PlasticValue r = {Vec3{base(m.color.x), base(m.color.y), base(m.color.z)} *
                        (through * cosine / (m.ior * m.ior)),
                    (1.0f - seen.chance) * cosine};
  if (!c.smooth) {
    const Reflection f = reflection(c.facets, wo, wi, false);
    const float share = fresnel_dielectric(min(f.facing, 1.0f), m.ior).reflected;
    r.value += m.specular * (share * f.value);
    r.pdf += seen.chance * f.pdf;
  }
  return r;
}

inline Vec3 eval(const Plastic& m, Vec3 wo, Vec3 wi) { return evaluate(m, wo, wi).value; }
inline float pdf(const Plastic& m, Vec3 wo, Vec3 wi) { return evaluate(m, wo, wi).pdf; }

inline bool sample(const Plastic& m, const SeenPlastic& seen, Vec3 wo, const BsdfDraws& u,
                   BsdfSample& out) {
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  if (u.lobe < seen.chance) {
    if (seen.coat.smooth) {
      out.wi = {-wo.x, -wo.y, wo.z};
      out.weight = m.specular * (coat_reflected(seen.coat, wo) / seen.chance);
      out.delta = true;
      return true;
    }
    out.wi = mirrored(above, sample_visible_normal(seen.coat.facets, above, u.direction));
  } else {
    out.wi = u.hemisphere;
  }
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
