// Rough surfaces as many small mirrors: GGX and Beckmann distributions of their normals,
// anisotropic, with Smith's masking, sampled by what is visible, and the tables that give back the
// light which bounces between the mirrors more than once.
//
// All directions are in a frame whose z axis is the mean normal; wo.z > 0. Where single bounces are
// all that counts, masking is separable, G = G1(wo) G1(wi), as in most renderers; where the lost
// light is given back, heights are correlated, G = 1 / (1 + Lambda(wo) + Lambda(wi)), which loses
// less. Models: Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR
// 2007; Heitz, "Understanding the Masking-Shadowing Function", JCGT 3(2), 2014.
#pragma once
#include "fresnel.h"
#include "special.h"
#include "tables/microfacet.h"
#include "warp.h"

namespace parhelion::PH_ISA {

enum class Facets : u32 { ggx, beckmann };

// A lobe of less than this is treated as a mirror: its normals could not be told apart in float.
inline constexpr float kSmoothAlpha = 1e-4f;

struct Microfacets {
  float alpha_u, alpha_v;  // root mean square slopes (times sqrt 2) along x and y, in [0, 1]
  Facets distribution;
};

// roughness^2 is the geometric mean of the two alphas, (1 + anisotropy) / (1 - anisotropy) their
// ratio. Neither leaves [kSmoothAlpha, 1].
PH_INLINE Microfacets microfacets(float roughness, float anisotropy, float distribution) {
  const float alpha = roughness * roughness;
  const float q = sqrt((1.0f - anisotropy) / (1.0f + anisotropy));
  return {clamp(alpha / q, kSmoothAlpha, 1.0f), clamp(alpha * q, kSmoothAlpha, 1.0f),
          distribution < 0.5f ? Facets::ggx : Facets::beckmann};
}

PH_INLINE bool smooth(const Microfacets& d) { return max(d.alpha_u, d.alpha_v) <= kSmoothAlpha; }

// Density of normals per unit area of the mean surface and steradian.
inline float normal_density(const Microfacets& d, Vec3 m) {
  if (!(m.z > 0.0f)) return 0.0f;
  const float x = m.x / d.alpha_u, y = m.y / d.alpha_v, z2 = m.z * m.z;
  const float area = kPi * d.alpha_u * d.alpha_v;
  const float r2 = x * x + y * y;
  if (d.distribution == Facets::ggx) return 1.0f / (area * (r2 + z2) * (r2 + z2));
  return exp(-r2 / z2) / (area * z2 * z2);
}

// Smith's G1: the share of a microsurface's facing area that is visible from w.
inline float visible_share(const Microfacets& d, Vec3 w) {
  const float x = d.alpha_u * w.x, y = d.alpha_v * w.y, z2 = w.z * w.z;
  const float r2 = x * x + y * y;
  if (d.distribution == Facets::ggx) {
    const float z = abs(w.z);
    return z > 0.0f ? 2.0f * z / (z + sqrt(z2 + r2)) : 0.0f;
  }
  if (!(r2 > z2 * 0.0625f)) return 1.0f;  // steeper than 4 standard slopes
  const float a = sqrt(z2 / r2);
  if (!(a > 0.0f)) return 0.0f;
  return a / (0.5f * a * (1.0f + erf(a)) + exp(-a * a) * (0.5f / 1.77245385f));
}

// Density of the normals visible from wo, per steradian: that of sample_visible_normal.
inline float visible_density(const Microfacets& d, Vec3 wo, Vec3 m) {
  const float facing = dot(wo, m);
  if (!(facing > 0.0f)) return 0.0f;
  return normal_density(d, m) * visible_share(d, wo) * facing / wo.z;
}

// The slope towards a viewer at the angle whose cosine and sine are given, of a Beckmann surface of
// alpha 1: the root of its cumulative distribution, by Newton's method within a bracket that each
// step narrows. Distribution: Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using
// the Distribution of Visible Normals", EGSR 2014.
inline float visible_beckmann_slope(float cosine, float sine, float u) {
  constexpr float kInvTwoSqrtPi = 0.282094792f, kInvSqrtPi = 0.564189584f;
  const float cot = min(cosine / max(sine, 1e-20f), 4.0f);  // erf(4) is 1 in float
  const float erf_cot = erf(cot), tail = exp(-cot * cot);
  // cumulative(q) of slopes in (-cot, q), times a constant
  const float total = 0.5f * cosine * (1.0f + erf_cot) + sine * kInvTwoSqrtPi * tail;
  const float target = u * total;
  float low = -cot, high = 4.0f;
  // The slope if facets were all equally visible
  float q = clamp(erf_inverse((1.0f + erf_cot) * u - erf_cot), low, high);
  for (int i = 0; i < 24; ++i) {
    const float e = exp(-q * q);
    const float value = 0.5f * cosine * (erf(q) + erf_cot) + sine * kInvTwoSqrtPi * (tail - e);
    (value < target ? low : high) = q;
    const float slope = (cosine + q * sine) * e * kInvSqrtPi;
    const float newton = q + (target - value) / slope;
    const float next = newton > low && newton < high ? newton : 0.5f * (low + high);
    if (abs(next - q) < 1e-6f) return next;
    q = next;
  }
  return q;
}

// A normal visible from wo. GGX: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical
// Caps", HPG 2023.
inline Vec3 sample_visible_normal(const Microfacets& d, Vec3 wo, Vec2 u) {
  const Vec3 s = normalize(Vec3{d.alpha_u * wo.x, d.alpha_v * wo.y, wo.z});
  if (d.distribution == Facets::ggx) {
    // uniform over the cap of mirrored directions, z in (-s.z, 1]
    const Vec3 h = direction_at(u.y * (1.0f + s.z), u.x) + s;
    return normalize(Vec3{d.alpha_u * h.x, d.alpha_v * h.y, max(h.z, 1e-7f)});
  }
  const float sine = sqrt(s.x * s.x + s.y * s.y);
  const float along = visible_beckmann_slope(s.z, sine, u.x);
  const float across = clamp(erf_inverse(2.0f * u.y - 1.0f), -4.0f, 4.0f);
  const float c = sine > 0.0f ? s.x / sine : 1.0f, v = sine > 0.0f ? s.y / sine : 0.0f;
  return normalize(
      Vec3{d.alpha_u * (c * along - v * across), d.alpha_v * (v * along + c * across), 1.0f});
}

PH_INLINE Vec3 mirrored(Vec3 wo, Vec3 m) { return m * (2.0f * dot(wo, m)) - wo; }

// What masking leaves of light that leaves a visible normal towards wi: G / G1(wo).
inline float shadowing(const Microfacets& d, Vec3 wo, Vec3 wi, bool correlated) {
  const float i = visible_share(d, wi);
  if (!correlated) return i;
  const float o = visible_share(d, wo);
  return i > 0.0f ? i / (o + i - o * i) : 0.0f;
}

// Reflection
//
// f |cos wi| of mirrors that reflect everything, and the density of wi = mirrored(wo, m) for
// visible normals m: f |cos| / pdf is the shadowing. Both directions above the surface.
struct Reflection {
  Vec3 m;        // half vector
  float facing;  // wo . m
  float value, pdf;
};

inline Reflection reflection(const Microfacets& d, Vec3 wo, Vec3 wi, bool correlated) {
  const Vec3 m = normalize(wo + wi);
  const float facing = dot(wo, m);
  if (!(facing > 0.0f)) return {m, 0.0f, 0.0f, 0.0f};
  const float density = visible_density(d, wo, m) / (4.0f * facing);
  return {m, facing, density * shadowing(d, wo, wi, correlated), density};
}

// Tables, see tables/generate.py for what they hold and their coordinates.

// x in [0, 1] among n nodes by Catmull and Rom's cubic, which continues straight beyond the ends.
struct Cubic {
  u32 first;
  float weight[4];
};

inline Cubic cubic(float x, u32 n) {
  const float at = clamp(x, 0.0f, 1.0f) * static_cast<float>(n - 1);
  const u32 whole = static_cast<u32>(at), k = whole < n - 2 ? whole : n - 2;
  const float f = at - static_cast<float>(k);
  const float a = 0.5f * f * (-1.0f + f * (2.0f - f));
  const float b = 1.0f + 0.5f * f * f * (3.0f * f - 5.0f);
  const float c = 0.5f * f * (1.0f + f * (4.0f - 3.0f * f));
  const float d = 0.5f * f * f * (f - 1.0f);
  if (k == 0) return {0, {b + 2.0f * a, c - a, d, 0.0f}};
  if (k == n - 2) return {n - 4, {0.0f, a, b - d, c + 2.0f * d}};
  return {k - 1, {a, b, c, d}};
}

// A value of a table [index][alpha][angle] of whole numbers, or of its last two or one dimensions.
template <class T>
PH_INLINE float grid(const T* table, const Cubic& x) {
  table += x.first;
  return (x.weight[0] * table[0] + x.weight[1] * table[1] + x.weight[2] * table[2] +
          x.weight[3] * table[3]) *
         0x1p-15f;
}
template <class T>
inline float grid(const T* table, const Cubic& y, const Cubic& x, u32 width) {
  float sum = 0.0f;
  for (u32 i = 0; i < 4; ++i) sum += y.weight[i] * grid(table + (y.first + i) * width, x);
  return sum;
}
template <class T>
inline float grid(const T* table, const Cubic& z, const Cubic& y, const Cubic& x, u32 width) {
  float sum = 0.0f;
  for (u32 i = 0; i < 4; ++i) {
    sum += z.weight[i] * grid(table + (z.first + i) * kAlphas * width, y, x, width);
  }
  return sum;
}

PH_INLINE float mean(Vec3 c) { return (c.x + c.y + c.z) * (1.0f / 3.0f); }

// The cubic root of ln(eta) / ln(10): indices near 1 need the most nodes.
inline float index_coordinate(float eta) {
  return pow(max(log(eta), 0.0f) * (1.0f / kLogMaxIndex), 1.0f / 3.0f);
}

PH_INLINE float angle_coordinate(float cosine, float alpha) {
  const float z = abs(cosine);
  return sqrt(z * (1.0f + 2.0f * alpha) / (z + 2.0f * alpha));
}

// The tables are of isotropic surfaces; others are not compensated. Where a table is used for them
// all the same, they count as isotropic ones of the same mean.
PH_INLINE bool isotropic(const Microfacets& d) { return d.alpha_u == d.alpha_v; }

PH_INLINE float mean_alpha(const Microfacets& d) {
  return isotropic(d) ? d.alpha_u : sqrt(d.alpha_u * d.alpha_v);
}

inline Cubic alpha_place(float alpha) { return cubic(sqrt(alpha), kAlphas); }

// Reflection by metal times metal_gain(wo) metal_gain(wi) loses nothing, and is reciprocal.
inline float metal_gain(const Microfacets& d, Vec3 w) {
  if (!isotropic(d)) return 1.0f;
  const u16* table = kMetalEscape + static_cast<u32>(d.distribution) * kAlphas * kMetalAngles;
  const Cubic x = cubic(angle_coordinate(w.z, d.alpha_u), kMetalAngles);
  return 1.0f / grid(table, alpha_place(d.alpha_u), x, kMetalAngles);
}

// What glass reflects and refracts together of the light from w; eta is the index of the other side
// over that of w's own.
inline float glass_albedo(const Microfacets& d, Vec3 w, float eta) {
  if (!isotropic(d)) return 1.0f;
  const u32 distribution = static_cast<u32>(d.distribution);
  const float alpha = d.alpha_u, z = min(abs(w.z), 1.0f);
  const Cubic y = alpha_place(alpha);
  if (eta >= 1.0f) {
    const u16* table = kGlassOuter + distribution * kIndices * kAlphas * kOuterAngles;
    return grid(table, cubic(index_coordinate(eta), kIndices), y,
                cubic(angle_coordinate(z, alpha), kOuterAngles), kOuterAngles);
  }
  constexpr u32 kWidth = 2 * kInnerAngles;
  const u16* table = kGlassInner + distribution * kIndices * kAlphas * kWidth;
  const float refracted2 = 1.0f - (1.0f - z * z) / (eta * eta);
  Cubic x;
  if (refracted2 > 0.0f) {
    x = cubic(angle_coordinate(sqrt(refracted2), alpha), kInnerAngles);
    x.first += kInnerAngles;
  } else {
    const float share2 = min(z * z / (1.0f - eta * eta), 1.0f);  // of the critical cosine
    const float rising = angle_coordinate(z, alpha);
    const float falling = angle_coordinate(sqrt(1.0f - share2), alpha);
    x = cubic(rising / (rising + falling), kInnerAngles);
  }
  return grid(table, cubic(index_coordinate(1.0f / eta), kIndices), y, x, kWidth);
}

// A dielectric coat of index eta >= 1, whose reflection is not compensated: what does not come back
// may go into what it covers.
struct Coat {
  Microfacets facets;
  float eta;
  bool smooth;
  Cubic index, alpha;
};

inline Coat make_coat(const Microfacets& d, float eta) {
  return {d, eta, smooth(d), cubic(index_coordinate(eta), kIndices), alpha_place(mean_alpha(d))};
}

// Shares of the light from w, in single bounces.
struct CoatAlbedo {
  float reflected, refracted;
};

inline CoatAlbedo coat_albedo(const Coat& c, Vec3 w) {
  const float share = fresnel_dielectric(min(abs(w.z), 1.0f), c.eta).reflected;
  if (c.smooth) return {share, 1.0f - share};
  const u32 first = static_cast<u32>(c.facets.distribution) * kIndices * kAlphas * kCoatAngles;
  const Cubic x = cubic(angle_coordinate(w.z, mean_alpha(c.facets)), kCoatAngles);
  const auto less = [&](const auto* table) {
    return grid(table + first, c.index, c.alpha, x, kCoatAngles);
  };
  return {clamp(share - less(kCoatReflected), 0.0f, 1.0f),
          clamp(1.0f - share - less(kCoatRefracted), 0.0f, 1.0f)};
}

// The mean of what is reflected over diffuse light from outside.
inline float coat_mean(const Coat& c) {
  const float share = grid(kSmoothMean, cubic(index_coordinate(c.eta), kFineIndices));
  if (c.smooth) return share;
  const u32 first = static_cast<u32>(c.facets.distribution) * kIndices * kAlphas;
  return share - grid(kCoatMean + first, c.index, c.alpha, kAlphas);
}

// And over diffuse light from within, in single bounces.
inline float coat_mean_within(const Coat& c) {
  const u32 first = static_cast<u32>(c.facets.distribution) * kIndices * kAlphas;
  return grid(kCoatWithin + first, c.index, c.alpha, kAlphas);
}

}  // namespace parhelion::PH_ISA
