// The material of glTF 2.0 (metallic-roughness and its extensions), layered as OpenPBR's: from the
// top sheen, a clear coat, and a base that is metal, or else a clear interface over a matte body or
// over glass.
//
// A layer whose albedo towards wo is A leaves 1 - A to what it covers (albedo scaling, as in
// OpenPBR and in Kulla and Conty 2017), so nothing gains energy, and white loses none. Lobes:
//   sheen     Estevez and Kulla, "Production Friendly Microfacet Sheen BRDF", 2017
//   film      Belcour and Barla, "A Practical Extension to Microfacet Theory for the Modeling of
//             Varying Iridescence", 2017, its Fresnel terms taken at the angle of wo
//   the rest  as in conductor.h, dielectric.h, plastic.h and diffuse.h, by GGX
#pragma once
#include "conductor.h"
#include "dielectric.h"
#include "diffuse.h"

namespace parhelion::PH_ISA {

struct Principled {
  Vec3 color;
  float metallic, roughness, anisotropy, anisotropy_rotation;
  float ior, specular;
  Vec3 specular_color;
  float diffuse_roughness, transmission;
  float clearcoat, clearcoat_roughness, clearcoat_ior;
  Vec3 sheen_color;
  float sheen_roughness;
  float iridescence, iridescence_ior, iridescence_thickness;
  float dispersion;

  using Plain = PlainForms<struct PlainPrincipled, struct LayeredPrincipled,
                           struct BrushedPrincipled, struct GlassPrincipled>;
  static constexpr bool transmits = true;
  static constexpr bool lobe_draws = true;
  static constexpr const char* doc =
      "glTF's metallic-roughness with its extensions: metal, plastic, cloth, car paint, glass";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.8f, 0.8f, 0.8f}, 0.0f, 1.0f, "of the metal, the matte body or the glass"},
      {"metallic", 1, {0.0f}, 0.0f, 1.0f, "0 is no metal, 1 is metal"},
      {"roughness", 1, {0.5f}, 0.0f, 1.0f, "square root of the microfacets' alpha"},
      {"anisotropy", 1, {0.0f}, -0.99f, 0.99f, "above 0 highlights stretch along u"},
      {"anisotropy_rotation", 1, {0.0f}, 0.0f, 360.0f, "degrees from u to that direction"},
      {"ior", 1, {1.5f}, 1.0f, 10.0f, "index of refraction, inside over outside; not for metal"},
      {"specular", 1, {1.0f}, 0.0f, 1.0f, "scales the reflection at normal incidence"},
      {"specular_color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "tint of the reflection; not of metal"},
      {"diffuse_roughness", 1, {0.0f}, 0.0f, 1.0f, "of the matte body, as in diffuse"},
      {"transmission", 1, {0.0f}, 0.0f, 1.0f, "0 is a matte body, 1 is glass"},
      {"clearcoat", 1, {0.0f}, 0.0f, 1.0f, "share that a clear coat covers"},
      {"clearcoat_roughness", 1, {0.0f}, 0.0f, 1.0f, "of the coat"},
      {"clearcoat_ior", 1, {1.5f}, 1.0f, 10.0f, "index of refraction of the coat"},
      {"sheen_color", 3, {0.0f, 0.0f, 0.0f}, 0.0f, 1.0f, "of fibres that stand off, as on velvet"},
      {"sheen_roughness", 1, {0.5f}, 0.0f, 1.0f, "how far the fibres lean"},
      {"iridescence", 1, {0.0f}, 0.0f, 1.0f, "share that a thin film covers"},
      {"iridescence_ior", 1, {1.3f}, 1.0f, 10.0f, "index of refraction of the film"},
      {"iridescence_thickness", 1, {400.0f}, 0.0f, 10000.0f, "of the film, nanometres"},
      {"dispersion", 1, {0.0f}, 0.0f, 10.0f, "of glass: 20 over Abbe's number; 0 is none"},
  };
};

PH_INLINE bool is_delta(const Principled&) { return false; }
PH_INLINE bool is_opaque(const Principled& m) {
  return m.transmission == 0.0f || m.metallic == 1.0f;
}
PH_INLINE Vec3 albedo(const Principled& m) { return m.color; }

// --- Sheen ------------------------------------------------------------------------------------

// With fibres more upright than this the model would reflect more than it receives.
inline constexpr float kLeastSheenAlpha = 0.25f;

PH_INLINE float sheen_alpha(const Principled& m) {
  return max(m.sheen_roughness * m.sheen_roughness, kLeastSheenAlpha);
}

// f |cos wi|, without branches
PH_INLINE float sheen_value(float alpha, Vec3 wo, Vec3 wi) {
  const Vec3 h = normalize(wo + wi);
  const float sine = sqrt(max(1.0f - h.z * h.z, 1e-16f)), power = 1.0f / alpha;
  const float density = (2.0f + power) * exp_within(power * log_within(sine)) * (0.5f / kPi);
  return density * wi.z / max(4.0f * (wo.z + wi.z - wo.z * wi.z), 1e-20f);
}

// Where its table has the light from w, on either side.
struct SheenPlace {
  Cubic angle, alpha;
};
PH_INLINE SheenPlace sheen_place(float alpha, Vec3 w) {
  const float y = (alpha - kLeastSheenAlpha) / (1.0f - kLeastSheenAlpha);
  return {cubic(sqrt(abs(w.z)), kSheenAngles), cubic(y, kSheenAlphas)};
}
inline float sheen_albedo(const SheenPlace& at) {
  return grid(kSheenAlbedo, at.angle, kSheenAngles, at.alpha);
}

// --- Thin film --------------------------------------------------------------------------------

// Amplitudes reflected at a dielectric interface, of the two polarisations.
struct Amplitudes {
  float s, p, cos_t;
};

PH_INLINE Amplitudes amplitudes(float cos_i, float eta) {
  const float cos_t = safe_sqrt(1.0f - (1.0f - cos_i * cos_i) / (eta * eta));
  return {(cos_i - eta * cos_t) / max(cos_i + eta * cos_t, 1e-6f),
          (eta * cos_i - cos_t) / max(eta * cos_i + cos_t, 1e-6f), cos_t};
}

// Airy's sum over reflections within the film.
PH_INLINE float airy(float first, float second, float fringe) {
  const float a = first * first, b = second * second, c = 2.0f * first * second * fringe;
  return (a + b + c) / max(1.0f + a * b + c, 1e-6f);
}

// Share that a film reflects of one channel of linear RGB, by what the eye makes of wavelengths.
// fringe: of each of these, the cosine of the phase that the film adds. The loop over them becomes
// vectors, so the sum is one by itself.
PH_INLINE float film_channel(const Amplitudes& top, const Amplitudes& below,
                             const float (&fringe)[kFilmWavelengths], u32 channel) {
  float share[kFilmWavelengths], sum = 0.0f;
  for (u32 i = 0; i < kFilmWavelengths; ++i) {
    share[i] = 0.5f * (airy(top.s, below.s, fringe[i]) + airy(top.p, below.p, fringe[i]));
  }
  for (u32 i = 0; i < kFilmWavelengths; ++i) sum += kFilmWeights[3 * i + channel] * share[i];
  return clamp(sum, 0.0f, 1.0f);
}

// And of all three; `base` is the index of what lies below, channel by channel.
inline Vec3 film_albedo(float cosine, float ior, float thickness, Vec3 base) {
  const Amplitudes top = amplitudes(cosine, ior);
  float fringe[kFilmWavelengths];
  for (u32 i = 0; i < kFilmWavelengths; ++i) {
    const float turns =
        2.0f * ior * thickness * top.cos_t / (kFilmFirst + kFilmStep * static_cast<float>(i));
    fringe[i] = cos_sin_turns(turns - floor(turns)).c;
  }
  const auto channel = [&](float index, u32 number) {
    return film_channel(top, amplitudes(top.cos_t, index / ior), fringe, number);
  };
  return {channel(base.x, 0), channel(base.y, 1), channel(base.z, 2)};
}

// The index of a dielectric that reflects this much at normal incidence.
PH_INLINE float index_of_reflectance(float f0) {
  const float root = sqrt(min(f0, 0.9999f));
  return (1.0f + root) / (1.0f - root);
}

// --- The base ---------------------------------------------------------------------------------

// Narrower lobes are widened: there is no mirror here. Nor are indices nearer to 1, at which
// refraction could not be told from passing straight on.
inline constexpr float kLeastRoughness = 0.045f, kLeastContrast = 0.02f;

PH_INLINE Vec3 lerp(Vec3 a, Vec3 b, float f) { return a + (b - a) * f; }
PH_INLINE Vec3 rest(Vec3 a) { return {1.0f - a.x, 1.0f - a.y, 1.0f - a.z}; }

// The index that reflects `specular` times as much at normal incidence (OpenPBR 1.1, 3.6).
PH_INLINE float scaled_index(float ior, float specular) {
  const float root = (ior - 1.0f) / (ior + 1.0f);
  const float eta = max(index_of_reflectance(root * root * specular), 1.0f + kLeastContrast);
  return ior >= 1.0f ? eta : 1.0f / eta;
}

// Metal, and gloss over a matte body: how much is left for each of the light towards wo. Metal,
// film and gloss are mirrors that share their normals.
struct Base {
  Vec3 film, gloss, matte;
  float metal;
  float mirror_share, matte_share;  // what each reflects, about
};

// metal, dull: shares of the base that are metal, and matte under gloss. bare: of both, without
// film; film, film_on_body: what it reflects, of all and of what is on the body. gloss_share: what
// gloss reflects.
PH_INLINE Base make_base(Vec3 color, Vec3 specular, float metal, float dull, float gloss_share,
                         float bare, Vec3 film, Vec3 film_on_body) {
  Base b;
  b.metal = metal * bare;
  b.film = film;
  b.gloss = specular * (dull * bare);
  b.matte = rest(film_on_body + Vec3{1, 1, 1} * (bare * gloss_share)) * dull;
  b.mirror_share = b.metal * mean(color) + mean(film) + mean(b.gloss) * gloss_share;
  b.matte_share = mean(b.matte * color);
  return b;
}

struct PrincipledValue {
  Vec3 value;
  float pdf;
};

// What the base adds to `sum`. gain: metal_gain of both directions, which are above the surface.
// chances: of mirrors, and of what is sampled as the body is.
PH_INLINE void add_base(const Base& b, const Microfacets& facets, float ior, Vec3 color,
                        Diffuse body, float gain, float mirror_chance, float matte_chance, Vec3 wo,
                        Vec3 wi, PrincipledValue& sum) {
  const Reflection f = reflection(facets, wo, wi, true);
  const float facing = min(f.facing, 1.0f);
  const Vec3 metal = reflected(lerp(color, {1, 1, 1}, schlick_weight(facing)), gain);
  const float gloss = fresnel_dielectric(facing, ior).reflected;
  const float cosine = cosine_hemisphere_pdf(wi);
  sum.value += (metal * b.metal + b.film * gain) * f.value;
  sum.value += b.gloss * (gloss * f.pdf * visible_share(facets, wi));
  sum.value += b.matte * eval(body, wo, wi);
  sum.pdf += mirror_chance * f.pdf;
  sum.pdf += matte_chance * cosine;
}

// The body is matte from behind, and within what is denser, too.
PH_INLINE float gloss_index(float ior) { return max(ior, 1.0f / ior); }
PH_INLINE Coat gloss_coat(const Microfacets& facets, float ior) {
  return make_coat(facets, gloss_index(ior));
}

// The microfacets' x in the frame of the surface, and directions of that in the frame of theirs.
PH_INLINE CosSin brushed_axis(const Principled& m) {
  return cos_sin_turns(m.anisotropy_rotation * (1.0f / 360.0f));
}
PH_INLINE Vec3 along(CosSin axis, Vec3 w) {
  return {axis.c * w.x + axis.s * w.y, axis.c * w.y - axis.s * w.x, w.z};
}
PH_INLINE Vec3 back_along(CosSin axis, Vec3 w) {
  return {axis.c * w.x - axis.s * w.y, axis.c * w.y + axis.s * w.x, w.z};
}

// What most surfaces are: the base alone, opaque and isotropic.
struct PlainPrincipled {
  Vec3 color;
  float metallic, roughness, ior;  // of the gloss, as scaled_index says
  Vec3 specular_color;

  static constexpr bool opaque = true;

  struct From {
    float gain, gloss_share;
  };
  struct To {
    float gain;
  };
  struct FromPlace {
    MetalPlace metal;
    CoatPlace gloss;
  };
  using ToPlace = MetalPlace;

  PH_INLINE static bool fits(const Principled& m) {
    return m.transmission == 0.0f && m.clearcoat == 0.0f && black(m.sheen_color) &&
           m.iridescence == 0.0f && m.anisotropy == 0.0f && m.diffuse_roughness == 0.0f;
  }
  PH_INLINE static PlainPrincipled of(const Principled& m) {
    return {m.color, m.metallic, max(m.roughness, kLeastRoughness), scaled_index(m.ior, m.specular),
            m.specular_color};
  }
};

PH_INLINE Microfacets facets(const PlainPrincipled& m) {
  return microfacets(m.roughness, 0.0f, 0.0f);
}
PH_INLINE Base base(const PlainPrincipled& m, const PlainPrincipled::From& seen) {
  return make_base(m.color, m.specular_color, m.metallic, 1.0f - m.metallic, seen.gloss_share, 1.0f,
                   {0, 0, 0}, {0, 0, 0});
}
// Of mirrors and of the matte part
PH_INLINE LobeChances lobes(const Base& b) {
  const float sum = b.mirror_share + b.matte_share;
  return {sum > 0.0f ? b.mirror_share / sum : 1.0f, sum > 0.0f ? b.matte_share / sum : 0.0f};
}
PH_INLINE LobeChances lobes(const PlainPrincipled& m, const PlainPrincipled::From& seen) {
  return lobes(base(m, seen));
}

PH_INLINE MetalPlace place_to(const PlainPrincipled& m, Vec3 wi) {
  return metal_place(facets(m), wi);
}
PH_INLINE PlainPrincipled::FromPlace place_from(const PlainPrincipled& m, Vec3 wo) {
  return {place_to(m, wo), coat_place(gloss_coat(facets(m), m.ior), wo)};
}
inline PlainPrincipled::To to(const PlainPrincipled& m, const MetalPlace& at) {
  return {m.metallic > 0.0f ? metal_gain(Facets::ggx, at) : 1.0f};
}
inline PlainPrincipled::From from(const PlainPrincipled& m, const PlainPrincipled::FromPlace& at) {
  return {to(m, at.metal).gain, m.metallic < 1.0f ? coat_reflected(Facets::ggx, at.gloss) : 0.0f};
}

PH_INLINE BsdfValue evaluate(const PlainPrincipled& m, const PlainPrincipled::From& seen,
                             const PlainPrincipled::To& to, Vec3 wo, Vec3 wi) {
  const float above = wo.z * wi.z > 0.0f ? 1.0f : 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const Base b = base(m, seen);
  const LobeChances chance = lobes(b);
  PrincipledValue v = {{0, 0, 0}, 0.0f};
  add_base(b, facets(m), m.ior, m.color, {m.color, 0.0f}, seen.gain * to.gain, chance.first,
           chance.other, wo, wi, v);
  return {v.value * above, v.pdf * above};
}

PH_INLINE Gloss gloss(const PlainPrincipled& m, const PlainPrincipled::From& seen, Vec3 wo) {
  const Base b = base(m, seen);
  return gloss_of(facets(m), b.mirror_share, b.matte_share, wo);
}

PH_INLINE bool choose(const PlainPrincipled& m, const PickedLobe& lobe, Vec3 wo, Vec3& wi) {
  return mirror_or_matte(facets(m), lobe.first, lobe.number, wo, wi);
}

// --- Layers -----------------------------------------------------------------------------------

// The lobes that are sampled.
enum Lobe : u32 { kMirrorLobe, kCoatLobe, kGlassLobe, kMatteLobe, kSheenLobe, kLobes };

// The chances of lobes, by what each reflects.
struct LayerChances {
  float of[kLobes];
};
PH_INLINE LayerChances chances_of(const Base& base, float glass, float coat, float sheen) {
  LayerChances c = {{base.mirror_share, coat, glass, base.matte_share, sheen}};
  float sum = 0.0f;
  for (const float share : c.of) sum += share;
  for (u32 i = 0; i < kLobes; ++i) {
    c.of[i] = sum > 0.0f ? c.of[i] / sum : (i == 0 ? 1.0f : 0.0f);
  }
  return c;
}

// Mirrors are picked before what else there is, and of them the coat with this chance.
PH_INLINE LobeChances lobes(const LayerChances& c) {
  return {c.of[kMirrorLobe] + c.of[kCoatLobe],
          c.of[kGlassLobe] + c.of[kMatteLobe] + c.of[kSheenLobe]};
}
PH_INLINE float upper_part(const LayerChances& c) {
  return c.of[kCoatLobe] > 0.0f ? c.of[kCoatLobe] / (c.of[kMirrorLobe] + c.of[kCoatLobe]) : 0.0f;
}

// What sheen and the coat add to `sum`, which are above the base.
PH_INLINE void add_layers(Vec3 sheen_color, float sheen_alpha, const Microfacets& coat,
                          float coat_ior, float coat_weight, float coat_chance, Vec3 wo, Vec3 wi,
                          PrincipledValue& sum) {
  const Reflection c = reflection(coat, wo, wi, false);
  const float share = fresnel_dielectric(min(c.facing, 1.0f), coat_ior).reflected;
  sum.value += sheen_color * sheen_value(sheen_alpha, wo, wi);
  sum.value += Vec3{1, 1, 1} * (coat_weight * share * c.value);
  sum.pdf += coat_chance * c.pdf;
}

// What layers leave to the base of the light towards wo, and the chances of lobes.
struct LayerShares {
  Base base;
  float coat_weight;
  LayerChances chance;
};

PH_INLINE Microfacets coat_facets(float roughness) {
  return microfacets(max(roughness, kLeastRoughness), 0.0f, 0.0f);
}

// What most of the others are: opaque and isotropic, of a smooth body, without film.
struct LayeredPrincipled {
  PlainPrincipled plain;  // without the layers
  float clearcoat, clearcoat_roughness, clearcoat_ior;
  Vec3 sheen_color;
  float sheen_alpha;

  static constexpr bool opaque = true;

  struct From {
    PlainPrincipled::From plain;
    float coat_share, sheen_share;
  };
  using To = PlainPrincipled::To;
  using FromPlace = PlainPrincipled::FromPlace;
  struct LayerPlace {
    CoatPlace coat;
    SheenPlace sheen;
  };
  using ToPlace = PlainPrincipled::ToPlace;

  PH_INLINE static bool fits(const Principled& m) {
    return m.transmission == 0.0f && m.iridescence == 0.0f && m.anisotropy == 0.0f &&
           m.diffuse_roughness == 0.0f && !PlainPrincipled::fits(m);
  }
  PH_INLINE static LayeredPrincipled of(const Principled& m) {
    return {PlainPrincipled::of(m), m.clearcoat,   max(m.clearcoat_roughness, kLeastRoughness),
            m.clearcoat_ior,        m.sheen_color, PH_ISA::sheen_alpha(m)};
  }
};

PH_INLINE Microfacets coat_facets(const LayeredPrincipled& m) {
  return microfacets(m.clearcoat_roughness, 0.0f, 0.0f);
}

PH_INLINE LayerShares shares(const LayeredPrincipled& m, const LayeredPrincipled::From& seen) {
  LayerShares s;
  float under = 1.0f - max_component(m.sheen_color) * seen.sheen_share;
  s.coat_weight = under * m.clearcoat;
  under *= 1.0f - m.clearcoat * seen.coat_share;
  const float metal = under * m.plain.metallic;
  s.base = make_base(m.plain.color, m.plain.specular_color, metal, under - metal,
                     seen.plain.gloss_share, 1.0f, {0, 0, 0}, {0, 0, 0});
  s.chance = chances_of(s.base, 0.0f, s.coat_weight * seen.coat_share,
                        mean(m.sheen_color) * seen.sheen_share);
  return s;
}

PH_INLINE LayeredPrincipled::ToPlace place_to(const LayeredPrincipled& m, Vec3 wi) {
  return place_to(m.plain, wi);
}
PH_INLINE LayeredPrincipled::FromPlace place_from(const LayeredPrincipled& m, Vec3 wo) {
  return place_from(m.plain, wo);
}
PH_INLINE LayeredPrincipled::LayerPlace layer_place_from(const LayeredPrincipled& m, Vec3 wo) {
  return {coat_place(make_coat(coat_facets(m), m.clearcoat_ior), wo),
          sheen_place(m.sheen_alpha, wo)};
}
inline LayeredPrincipled::To to(const LayeredPrincipled& m, const LayeredPrincipled::ToPlace& at) {
  return to(m.plain, at);
}
inline LayeredPrincipled::From from(const LayeredPrincipled& m,
                                    const LayeredPrincipled::FromPlace& at,
                                    const LayeredPrincipled::LayerPlace& layers) {
  return {from(m.plain, at), m.clearcoat > 0.0f ? coat_reflected(Facets::ggx, layers.coat) : 0.0f,
          black(m.sheen_color) ? 0.0f : sheen_albedo(layers.sheen)};
}

PH_INLINE BsdfValue evaluate(const LayeredPrincipled& m, const LayeredPrincipled::From& seen,
                             const LayeredPrincipled::To& to, Vec3 wo, Vec3 wi) {
  const float above = wo.z * wi.z > 0.0f ? 1.0f : 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const PlainPrincipled& p = m.plain;
  const LayerShares s = shares(m, seen);
  PrincipledValue v = {{0, 0, 0}, 0.0f};
  add_base(s.base, facets(p), p.ior, p.color, {p.color, 0.0f}, seen.plain.gain * to.gain,
           s.chance.of[kMirrorLobe], s.chance.of[kMatteLobe] + s.chance.of[kSheenLobe], wo, wi, v);
  add_layers(m.sheen_color, m.sheen_alpha, coat_facets(m), m.clearcoat_ior, s.coat_weight,
             s.chance.of[kCoatLobe], wo, wi, v);
  return {v.value * above, v.pdf * above};
}

// Of the base and the coat, of the alpha of what mirrors more.
PH_INLINE Gloss gloss(const LayeredPrincipled& m, const LayeredPrincipled::From& seen, Vec3 wo) {
  const LayerShares s = shares(m, seen);
  const float coat = s.coat_weight * seen.coat_share;
  const float matte = s.base.matte_share + mean(m.sheen_color) * seen.sheen_share;
  const Gloss of_base = gloss_of(facets(m.plain), s.base.mirror_share, matte + coat, wo);
  const Gloss of_coat = gloss_of(coat_facets(m), coat, matte + s.base.mirror_share, wo);
  return of_coat.share > of_base.share ? of_coat : of_base;
}

PH_INLINE LobeChances lobes(const LayeredPrincipled& m, const LayeredPrincipled::From& seen) {
  return lobes(shares(m, seen).chance);
}

PH_INLINE float upper_part(const LayeredPrincipled& m, const LayeredPrincipled::From& seen) {
  return upper_part(shares(m, seen).chance);
}

PH_INLINE bool choose(const LayeredPrincipled& m, const PickedLobe& lobe, Vec3 wo, Vec3& wi) {
  const float roughness = lobe.upper ? m.clearcoat_roughness : m.plain.roughness;
  return mirror_or_matte(microfacets(roughness, 0.0f, 0.0f), lobe.first, lobe.number, wo, wi);
}

// The base alone where it is brushed metal.
struct BrushedPrincipled {
  Vec3 color;
  float roughness, anisotropy;
  CosSin axis;  // the microfacets' x in the frame of the surface

  static constexpr bool opaque = true;

  struct From {
    float gain;
  };
  using To = From;
  using FromPlace = StretchedPlace;
  using ToPlace = StretchedPlace;

  PH_INLINE static bool fits(const Principled& m) {
    return m.metallic == 1.0f && m.clearcoat == 0.0f && black(m.sheen_color) &&
           m.iridescence == 0.0f && !isotropic(of(m).facets());
  }
  PH_INLINE static BrushedPrincipled of(const Principled& m) {
    return {m.color, max(m.roughness, kLeastRoughness), m.anisotropy, brushed_axis(m)};
  }
  PH_INLINE Microfacets facets() const { return microfacets(roughness, anisotropy, 0.0f); }
};

PH_INLINE StretchedPlace place_to(const BrushedPrincipled& m, Vec3 wi) {
  return stretched_place(m.facets(), along(m.axis, wi));
}
PH_INLINE StretchedPlace place_from(const BrushedPrincipled& m, Vec3 wo) { return place_to(m, wo); }
inline BrushedPrincipled::To to(const BrushedPrincipled&, const StretchedPlace& at) {
  return {metal_gain(Facets::ggx, at)};
}
inline BrushedPrincipled::From from(const BrushedPrincipled& m, const StretchedPlace& at) {
  return to(m, at);
}

PH_INLINE Gloss gloss(const BrushedPrincipled& m, const BrushedPrincipled::From&, Vec3 wo) {
  return gloss_of(m.facets(), mean(m.color), 0.0f, wo);
}
// All of it is one lobe.
PH_INLINE LobeChances lobes(const BrushedPrincipled&, const BrushedPrincipled::From&) {
  return {1.0f, 0.0f};
}

PH_INLINE BsdfValue evaluate(const BrushedPrincipled& m, const BrushedPrincipled::From& seen,
                             const BrushedPrincipled::To& to, Vec3 wo, Vec3 wi) {
  const float above = wo.z * wi.z > 0.0f ? 1.0f : 0.0f;
  wo.z = abs(wo.z);
  wi.z = abs(wi.z);
  const Reflection f = reflection(m.facets(), along(m.axis, wo), along(m.axis, wi), true);
  const Vec3 share = lerp(m.color, {1, 1, 1}, schlick_weight(min(f.facing, 1.0f)));
  return {reflected(share, seen.gain * to.gain) * (f.value * above), f.pdf * above};
}

PH_INLINE bool choose(const BrushedPrincipled& m, const PickedLobe& lobe, Vec3 wo, Vec3& wi) {
  const bool found = mirror_or_matte(m.facets(), true, lobe.number, along(m.axis, wo), wi);
  wi = back_along(m.axis, wi);
  return found;
}

// And clear ones: frosted glass, isotropic, without metal, layers or film.
struct GlassPrincipled {
  Vec3 color, specular_color;
  float roughness, ior;

  struct From {
    float albedo;
  };
  using FromPlace = GlassPlace;

  PH_INLINE static bool fits(const Principled& m) {
    return m.transmission == 1.0f && m.metallic == 0.0f && m.clearcoat == 0.0f &&
           black(m.sheen_color) && m.iridescence == 0.0f && m.anisotropy == 0.0f;
  }
  PH_INLINE static GlassPrincipled of(const Principled& m) {
    return {m.color, m.specular_color, max(m.roughness, kLeastRoughness),
            scaled_index(m.ior, m.specular)};
  }
  PH_INLINE Microfacets facets() const { return microfacets(roughness, 0.0f, 0.0f); }
  PH_INLINE Frosted whole(const From& seen) const {
    return {specular_color, color, ior, facets(), seen.albedo, 1.0f};
  }
};

PH_INLINE GlassPlace place_from(const GlassPrincipled& m, Vec3 wo) {
  return glass_place(m.facets(), wo, far_index(m.ior, wo));
}
inline GlassPrincipled::From from(const GlassPrincipled& m, const GlassPlace& at) {
  return {glass_albedo(m.facets().distribution, at)};
}

// What any leaves for each lobe of the light towards wo, above the surface as it is seen.
struct Layers {
  Vec3 wo;
  Microfacets facets;
  Coat coat;  // if there is one
  Diffuse body;
  Frosted inner;     // whose albedo is known if it is sampled
  float eta;         // its index of the far side over the near one
  bool compensated;  // there is metal or film, and
  float gain_o;      // metal_gain(wo)
  LayerShares shares;
  Vec3 glass;
};

// In the frame of the microfacets, z towards the side of wo.
PH_INLINE Vec3 to_facets(const Principled& m, Vec3 w, float side) {
  w.z *= side;
  return m.anisotropy == 0.0f ? w : along(brushed_axis(m), w);
}

PH_INLINE Vec3 from_facets(const Principled& m, Vec3 w, float side) {
  w.z *= side;
  return m.anisotropy == 0.0f ? w : back_along(brushed_axis(m), w);
}

inline Layers prepare(const Principled& m, Vec3 world_wo) {
  Layers l = {};
  const float side = copysign(1.0f, world_wo.z);
  l.wo = to_facets(m, world_wo, side);
  const float roughness = max(m.roughness, kLeastRoughness);
  l.facets = microfacets(roughness, m.anisotropy, 0.0f);
  l.body = {m.color, m.diffuse_roughness};
  const float ior = scaled_index(m.ior, m.specular);
  l.inner = {m.specular_color, m.color, ior, l.facets, 1.0f, 1.0f};
  l.eta = far_index(ior, world_wo);
  l.compensated = m.metallic > 0.0f || m.iridescence > 0.0f;
  if (l.compensated) l.gain_o = metal_gain(l.facets, l.wo);

  float under = 1.0f;
  const float sheen = max_component(m.sheen_color);
  float sheen_share = 0.0f;
  if (sheen > 0.0f) {
    sheen_share = sheen_albedo(sheen_place(sheen_alpha(m), l.wo));
    under -= sheen * sheen_share;
  }
  l.shares.coat_weight = under * m.clearcoat;
  float coat_share = 0.0f;
  if (m.clearcoat > 0.0f) {
    l.coat = make_coat(coat_facets(m.clearcoat_roughness), m.clearcoat_ior);
    coat_share = coat_reflected(l.coat, l.wo);
    under *= 1.0f - m.clearcoat * coat_share;
  }
  const float metal = under * m.metallic, other = under - metal;
  const float dull = other * (1.0f - m.transmission), clear = other * m.transmission;
  const float bare = 1.0f - m.iridescence;
  const float gloss_eta = gloss_index(ior);
  const float gloss_share = dull > 0.0f ? coat_reflected(gloss_coat(l.facets, ior), l.wo) : 0.0f;
  Vec3 on_metal = {0, 0, 0}, on_other = {0, 0, 0};
  if (m.iridescence > 0.0f) {
    const auto film = [&](float x, float y, float z) {
      return film_albedo(l.wo.z, m.iridescence_ior, m.iridescence_thickness, {x, y, z}) *
             m.iridescence;
    };
    if (metal > 0.0f) {
      on_metal = film(index_of_reflectance(m.color.x), index_of_reflectance(m.color.y),
                      index_of_reflectance(m.color.z));
    }
    if (other > 0.0f) on_other = film(gloss_eta, gloss_eta, gloss_eta);
  }
  Base& base = l.shares.base;
  base = make_base(m.color, m.specular_color, metal, dull, gloss_share, bare,
                   on_metal * metal + on_other * other, on_other);
  l.glass = rest(on_other) * clear;
  l.shares.chance = chances_of(base, mean(l.glass), l.shares.coat_weight * coat_share,
                               mean(m.sheen_color) * sheen_share);
  if (l.shares.chance.of[kGlassLobe] > 0.0f) l.inner.albedo = glass_albedo(l.facets, l.wo, l.eta);
  return l;
}

// wi in the frame of l.wo.
inline PrincipledValue value_within(const Principled& m, const Layers& l, Vec3 wi) {
  PrincipledValue r = {{0, 0, 0}, 0.0f};
  const float (&chance)[kLobes] = l.shares.chance.of;
  if (chance[kGlassLobe] > 0.0f) {
    const DielectricValue v = rough_value(l.inner, l.eta, l.wo, wi);
    r = {l.glass * v.value, chance[kGlassLobe] * v.pdf};
  }
  if (!(wi.z > 0.0f) || !(l.wo.z > 0.0f)) return r;

  const float gain = l.compensated ? l.gain_o * metal_gain(l.facets, wi) : 1.0f;
  add_base(l.shares.base, l.facets, l.inner.ior, m.color, l.body, gain, chance[kMirrorLobe],
           chance[kMatteLobe] + chance[kSheenLobe], l.wo, wi, r);
  if (chance[kSheenLobe] > 0.0f || l.shares.coat_weight > 0.0f) {
    add_layers(m.sheen_color, sheen_alpha(m), coat_facets(m.clearcoat_roughness), m.clearcoat_ior,
               l.shares.coat_weight, chance[kCoatLobe], l.wo, wi, r);
  }
  return r;
}

inline PrincipledValue evaluate(const Principled& m, const Layers& l, Vec3 wo, Vec3 wi) {
  return value_within(m, l, to_facets(m, wi, copysign(1.0f, wo.z)));
}

inline bool sample(const Principled& m, const Layers& l, Vec3 wo, const BsdfDraws& u,
                   BsdfSample& out) {
  const LayerChances& c = l.shares.chance;
  const LobeChances chances = lobes(c);
  PickedLobe lobe = pick(chances, u);
  Vec3 wi;
  bool glass = false;
  pick_upper(upper_part(c), lobe);
  if (lobe.first) {
    const Microfacets& d = lobe.upper ? l.coat.facets : l.facets;
    wi = mirrored(l.wo, sample_visible_normal(d, l.wo, lobe.number));
  } else {
    // Where rounding leaves the others something though they have no chance, min passes over NaN.
    const float part = c.of[kGlassLobe] / chances.other;
    glass = first_lobe(part, 1.0f - part, lobe.number);
    if (!glass) wi = cosine_hemisphere(lobe.number);
  }
  if (glass) {
    if (!choose_rough(l.inner, l.eta, l.wo, {lobe.number, u.lobe}, wi)) return false;
    if (wi.z < 0.0f) out.eta = l.eta;
  } else if (!(wi.z > 0.0f)) {
    return false;
  }
  const PrincipledValue v = value_within(m, l, wi);
  if (!(v.pdf > 0.0f)) return false;
  out.pdf = v.pdf;
  out.weight = v.value * (1.0f / v.pdf);
  out.wi = from_facets(m, wi, copysign(1.0f, wo.z));
  return true;
}

}  // namespace parhelion::PH_ISA
