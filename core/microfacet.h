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
#include "simd.h"
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
  return {clamp_positive(alpha / q, kSmoothAlpha, 1.0f),
          clamp_positive(alpha * q, kSmoothAlpha, 1.0f),
          distribution < 0.5f ? Facets::ggx : Facets::beckmann};
}

PH_INLINE bool smooth(const Microfacets& d) { return max(d.alpha_u, d.alpha_v) <= kSmoothAlpha; }

// What follows, up to the tables, has no branches but for the distribution and for correlated
// heights: with these known to a compiler, loops over many surfaces become vectors. Compilers move
// what is selected into branches, which loops with exp do not survive, so where something is 0 it
// is multiplied by 0.

// Density of normals per unit area of the mean surface and steradian; m.z >= 0. Its square's square
// must not be 0.
PH_INLINE float normal_density(const Microfacets& d, Vec3 m) {
  const float x = m.x / d.alpha_u, y = m.y / d.alpha_v, z2 = m.z * m.z + 1e-16f;
  const float area = kPi * d.alpha_u * d.alpha_v;
  const float r2 = x * x + y * y;
  if (d.distribution == Facets::ggx) return 1.0f / (area * (r2 + z2) * (r2 + z2));
  // e^-104 is 0
  return exp_within(-r2 / max(z2, r2 * (1.0f / 104.0f))) / (area * z2 * z2);
}

// Smith's G1: the share of a microsurface's facing area that is visible from w.
PH_INLINE float visible_share(Facets distribution, const Microfacets& d, Vec3 w) {
  const float x = d.alpha_u * w.x, y = d.alpha_v * w.y, z = abs(w.z), r2 = x * x + y * y;
  if (distribution == Facets::ggx) return z > 0.0f ? 2.0f * z / (z + sqrt(z * z + r2)) : 0.0f;
  // Directions steeper than 4 standard slopes see all.
  const float a = z / max(sqrt(r2), 0.25f * z);
  return a / (0.5f * a * (1.0f + erf_within(a)) + exp_within(-a * a) * (0.5f / 1.77245385f));
}

PH_INLINE float visible_share(const Microfacets& d, Vec3 w) {
  return visible_share(d.distribution, d, w);
}

// Density of the normals visible from wo, per steradian: that of sample_visible_normal.
PH_INLINE float visible_density(const Microfacets& d, Vec3 wo, Vec3 m) {
  return normal_density(d, m) * visible_share(d, wo) * max(dot(wo, m), 0.0f) / wo.z;
}

// The slope towards a viewer at the angle whose cosine and sine are given, of a Beckmann surface of
// alpha 1: where its cumulative distribution is u. In erf of the slope that is a smooth and convex
// function, and what a viewer from above and one along the surface see makes a first guess, after
// which two of Chebyshev's steps are enough. Bounds are no constants, of which compilers would make
// branches. Distribution: Heitz and d'Eon, "Importance Sampling Microfacet-Based BSDFs using the
// Distribution of Visible Normals", EGSR 2014; in erf: W. Jakob, "An Improved Visible Normal
// Sampling Routine for the Beckmann Distribution", 2014.
PH_INLINE float visible_beckmann_slope(float cosine, float sine, float u) {
  constexpr float kInvTwoSqrtPi = 0.282094792f, kMost = 1.0f - 0x1p-24f;
  const float cot = cosine / max(sine, 0.25f * cosine);  // erf(4) is 1 in float
  const float erf_cot = erf_within(cot), tail = exp_within(-cot * cot);
  // cumulative(x) of slopes whose erf is in (-erf_cot, x), times a constant
  const float total = 0.5f * cosine * (1.0f + erf_cot) + sine * kInvTwoSqrtPi * tail;
  const float target = u * total, least = erf_cot * -kMost;
  float x = max(((1.0f + erf_cot) * (u + sine * (sqrt(u) - u)) - erf_cot) * kMost, least);
  for (int i = 0; i < 2; ++i) {
    const float q = erf_inverse_within(x), e = exp_within(-q * q);
    const float value = 0.5f * cosine * (x + erf_cot) + sine * kInvTwoSqrtPi * (tail - e);
    const float slope = 0.5f * abs(cosine + q * sine) + 1e-6f;
    const float newton = (value - target) / slope;
    // half the second derivative over the first, times the step; bounded where that is next to 0
    const float bend = 0.221556732f * sine / (e * slope) * newton;
    const float next = x - newton * (1.0f + bend / (1.0f + abs(bend)));
    x = max(min(next, 0.25f * x + 0.75f * kMost), least);
  }
  return erf_inverse_within(x);
}

// A normal visible from wo. GGX: Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical
// Caps", HPG 2023.
PH_INLINE Vec3 sample_visible_normal(const Microfacets& d, Vec3 wo, Vec2 u) {
  const Vec3 s = normalize(Vec3{d.alpha_u * wo.x, d.alpha_v * wo.y, wo.z});
  if (d.distribution == Facets::ggx) {
    // uniform over the cap of mirrored directions, z in (-s.z, 1]
    const Vec3 h = direction_at(u.y * (1.0f + s.z), u.x) + s;
    return normalize(Vec3{d.alpha_u * h.x, d.alpha_v * h.y, max(h.z, 1e-7f)});
  }
  const float sine = sqrt(s.x * s.x + s.y * s.y);
  const float along = visible_beckmann_slope(s.z, sine, u.x);
  const float across = erf_inverse_within((2.0f * u.y - 1.0f) * (1.0f - 0x1p-24f));
  const float c = sine > 0.0f ? s.x / sine : 1.0f, v = sine > 0.0f ? s.y / sine : 0.0f;
  return normalize(
      Vec3{d.alpha_u * (c * along - v * across), d.alpha_v * (v * along + c * across), 1.0f});
}

PH_INLINE Vec3 mirrored(Vec3 wo, Vec3 m) { return m * (2.0f * dot(wo, m)) - wo; }

// The direction of a sample from wo, on either side: mirrored by a visible normal, or matte. False
// where it would be below the surface.
PH_INLINE bool mirror_or_matte(const Microfacets& d, bool mirror, Vec2 u, Vec3 wo, Vec3& wi) {
  const Vec3 above = {wo.x, wo.y, abs(wo.z)};
  wi = select(mirror, mirrored(above, sample_visible_normal(d, above, u)), cosine_hemisphere(u));
  const bool found = wi.z > 0.0f;
  wi.z = copysign(wi.z, wo.z);
  return found;
}

// What masking leaves of light that leaves a visible normal towards wi: G / G1(wo).
PH_INLINE float shadowing(const Microfacets& d, Vec3 wo, Vec3 wi, bool correlated) {
  const float i = visible_share(d, wi);
  if (!correlated) return i;
  const float o = visible_share(d, wo), both = i / (o + i - o * i);
  return i > 0.0f ? both : 0.0f;
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

PH_INLINE Reflection reflection(const Microfacets& d, Vec3 wo, Vec3 wi, bool correlated) {
  wo.z = max(wo.z, 1e-9f);  // opposite directions along the surface have no half vector
  const Vec3 m = normalize(wo + wi);
  const float density = normal_density(d, m) * visible_share(d, wo) / (4.0f * wo.z);
  return {m, max(dot(wo, m), 0.0f), density * shadowing(d, wo, wi, correlated), density};
}

// How much of what a surface scatters is around the mirror image of wo, and how closely: the alpha
// of its microfacets.
struct Gloss {
  float share, alpha;
};
// Of microfacets that reflect a share of all light, beside what is matte: compared at their peaks.
// What is left beside it are the chances of lamps that a mirror image is far from. With less (0.01
// instead of a quarter where much is matte) the few samples that find these would be specks.
PH_INLINE Gloss gloss_of(const Microfacets& d, float share, float matte, Vec3 wo) {
  const float alpha = max(d.alpha_u, d.alpha_v);
  const float peak = share / (4.0f * d.alpha_u * d.alpha_v * max(abs(wo.z), alpha));
  const float most = matte > 0.0f ? 0.75f : 0.99f;
  return {peak > 0.0f ? min(peak / (peak + matte), most) : 0.0f, alpha};
}

// Tables, see tables/generate.py for what they hold and their coordinates.

// x in [0, 1] among n nodes by the cubic through the four around it.
struct Cubic {
  float first;  // a whole number
  float weight[4];
};

PH_INLINE Cubic cubic(float x, int n) {
  const float at = clamp_positive(x, 0.0f, 1.0f) * static_cast<float>(n - 1);
  const float whole = static_cast<float>(static_cast<int>(at));
  const float first = clamp_positive(whole - 1.0f, 0.0f, static_cast<float>(n - 4));
  const float a = at - first, b = a - 1.0f, c = a - 2.0f, d = a - 3.0f;
  return {
      first,
      {b * c * d * (-1.0f / 6.0f), a * c * d * 0.5f, a * b * d * -0.5f, a * b * c * (1.0f / 6.0f)}};
}

// Four neighbours of a table of whole numbers in its last dimension, by the place in the others.
// Before each comes how far apart the numbers of neighbouring places are.
template <class T>
PH_INLINE Quad neighbours(const T* table) {
  return load_quad(table);
}
template <class T, class... Rest>
PH_INLINE Quad neighbours(const T* table, u32 stride, const Cubic& x, const Rest&... rest) {
  table += static_cast<u32>(x.first) * stride;
  Quad sum = neighbours(table, rest...) * x.weight[0];
  for (u32 i = 1; i < 4; ++i) {
    sum = sum + neighbours(table + i * stride, rest...) * x.weight[i];
  }
  return sum;
}

// A value of such a table, by its place in the last dimension, along which its numbers follow each
// other, and then in the others.
template <class T, class... Rest>
inline float grid(const T* table, const Cubic& last, const Rest&... others) {
  float value[4];
  store(value, neighbours(table + static_cast<u32>(last.first), others...));
  return (last.weight[0] * value[0] + last.weight[1] * value[1] + last.weight[2] * value[2] +
          last.weight[3] * value[3]) *
         0x1p-15f;
}

PH_INLINE float mean(Vec3 c) { return (c.x + c.y + c.z) * (1.0f / 3.0f); }

// The fourth root of ln(eta) / ln(10): indices near 1 need the most nodes.
PH_INLINE float index_coordinate(float eta) {
  return sqrt(sqrt(log_within(clamp_positive(eta, 1.0f, kInfinity)) * (1.0f / kLogMaxIndex)));
}

PH_INLINE float angle_coordinate(float cosine, float alpha) {
  const float z = abs(cosine), width = 2.0f * alpha, scale = 1.0f / (z + width);
  const float grazing = sqrt(z * (1.0f + width) * scale);
  const float steep = sqrt(clamp_positive(width * (1.0f - z) * scale, 0.0f, kInfinity));
  return (grazing + kBend * (1.0f - steep)) * (1.0f / (1.0f + kBend));
}

// Along the cosine seen from within glass of the index 1 / eta: a step at the critical angle, as
// wide as roughness blurs it, besides.
PH_INLINE float inner_coordinate(float cosine, float alpha, float eta) {
  const float critical = safe_sqrt(1.0f - eta * eta), width2 = 4.0f * alpha * alpha;
  const auto step = [&](float z) {
    const float x = z - critical;
    return x / sqrt(x * x + width2);
  };
  const float low = step(0.0f);
  return (angle_coordinate(cosine, alpha) + step(cosine) - low) / (1.0f + step(1.0f) - low);
}

// Slopes whose difference does not matter.
PH_INLINE bool isotropic(const Microfacets& d) {
  return abs(d.alpha_u - d.alpha_v) <= 1e-3f * d.alpha_u;
}

// Where the tables of metal have the light from w, if slopes along x and y differ,
struct StretchedPlace {
  Cubic angle, alpha, ratio, azimuth;
};
PH_INLINE StretchedPlace stretched_place(const Microfacets& d, Vec3 w) {
  const float high = max(d.alpha_u, d.alpha_v), low = min(d.alpha_u, d.alpha_v);
  const float x = d.alpha_u * w.x, y = d.alpha_v * w.y, flat2 = w.x * w.x + w.y * w.y;
  const float towards = sqrt((x * x + y * y) / flat2), alpha = flat2 > 0.0f ? towards : high;
  const auto root = [](float a) { return sqrt(sqrt(a)); };
  const float azimuth = (root(alpha) - root(low)) / (root(high) - root(low));
  return {cubic(angle_coordinate(w.z, alpha), kStretchedAngles),
          cubic(sqrt(high), kStretchedAlphas), cubic(sqrt(low / high), kStretchedRatios),
          cubic(azimuth, kStretchedAzimuths)};
}
// and the share of it that comes back, but for a factor that makes it reciprocal.
inline float stretched_escape(Facets distribution, const StretchedPlace& at) {
  constexpr u32 kAngle = kStretchedAngles, kAzimuth = kStretchedAzimuths * kAngle;
  constexpr u32 kRatio = kStretchedRatios * kAzimuth, kAll = kStretchedAlphas * kRatio;
  return grid(kStretchedEscape + static_cast<u32>(distribution) * kAll, at.angle, kRatio, at.alpha,
              kAzimuth, at.ratio, kAngle, at.azimuth);
}

// Where those of isotropic metal have it
struct MetalPlace {
  Cubic angle, alpha;
};
PH_INLINE MetalPlace metal_place(const Microfacets& d, Vec3 w) {
  return {cubic(angle_coordinate(w.z, d.alpha_u), kMetalAngles),
          cubic(sqrt(d.alpha_u), kMetalAlphas)};
}

template <bool kStretched>
PH_INLINE auto place_of_metal(const Microfacets& d, Vec3 w) {
  if constexpr (kStretched) {
    return stretched_place(d, w);
  } else {
    return metal_place(d, w);
  }
}

// Reflection by metal times metal_gain(wo) metal_gain(wi) loses nothing, and is reciprocal.
inline float metal_gain(Facets distribution, const MetalPlace& at) {
  const u16* table = kMetalEscape + static_cast<u32>(distribution) * kMetalAlphas * kMetalAngles;
  return 1.0f / grid(table, at.angle, kMetalAngles, at.alpha);
}
inline float metal_gain(Facets distribution, const StretchedPlace& at) {
  return 1.0f / stretched_escape(distribution, at);
}
inline float metal_gain(const Microfacets& d, Vec3 w) {
  return isotropic(d) ? metal_gain(d.distribution, metal_place(d, w))
                      : metal_gain(d.distribution, stretched_place(d, w));
}

// Shares of the light from w, above the surface, that go each way in single bounces; eta is the
// index of the far side over that of w's own.
struct Bounces {
  float reflected, refracted;
};

// Sums lane by lane, which compilers turn into vectors; the order is the same for all of them.
inline constexpr u32 kBounceLanes = 16;
struct BounceSums {
  float all[kBounceLanes], reflected[kBounceLanes], refracted[kBounceLanes];
};

// m: a normal of any length, of GGX a visible one, of Beckmann any, which counts by how much of it
// is seen; o: the share visible from w, or 1 for separable masking.
PH_INLINE void add_bounces(BounceSums& sums, u32 lane, Facets distribution, const Microfacets& d,
                           Vec3 w, float eta, float o, Vec3 m) {
  m = normalize(m);
  const float facing = clamp(dot(w, m), 0.0f, 1.0f);
  const Fresnel f = fresnel_dielectric(facing, eta);
  const Vec3 up = mirrored(w, m), down = m * (facing / eta - f.cos_t) - w * (1.0f / eta);
  const float i = visible_share(distribution, d, up) * (up.z > 0.0f ? 1.0f : 0.0f);
  const float t = visible_share(distribution, d, down) * (down.z < 0.0f ? 1.0f : 0.0f);
  const float weight = distribution == Facets::ggx ? 1.0f : facing / m.z;
  sums.all[lane] += weight;
  sums.reflected[lane] += weight * f.reflected * (i / (o + i - o * i));
  sums.refracted[lane] += weight * (1.0f - f.reflected) * (t / (o + t - o * t));
}

// By quadrature over the visible normals. It serves where slopes along x and y differ, whose tables
// would have five dimensions and, from within, sharp edges in two of them.
inline Bounces count_bounces(const Microfacets& d, Vec3 w, float eta, bool correlated) {
  const float o = correlated ? max(visible_share(d, w), 1e-20f) : 1.0f;
  const Vec3 s = normalize(Vec3{d.alpha_u * w.x, d.alpha_v * w.y, w.z});
  BounceSums sums = {};
  for (u32 k = 0; k < kLatticeNormals; k += kBounceLanes) {
    const float *c = kNormalLattice + k, *e = c + kLatticeNormals;
    const float *p = e + kLatticeNormals, *slope = p + kLatticeNormals;
    if (d.distribution == Facets::ggx) {
      for (u32 i = 0; i < kBounceLanes; ++i) {  // as in sample_visible_normal
        const float z = 1.0f - p[i] * (1.0f + s.z), r = safe_sqrt(1.0f - z * z);
        const Vec3 m = {d.alpha_u * (r * c[i] + s.x), d.alpha_v * (r * e[i] + s.y),
                        max(z + s.z, 1e-7f)};
        add_bounces(sums, i, Facets::ggx, d, w, eta, o, m);
      }
    } else {
      for (u32 i = 0; i < kBounceLanes; ++i) {
        const Vec3 m = {d.alpha_u * slope[i] * c[i], d.alpha_v * slope[i] * e[i], 1.0f};
        add_bounces(sums, i, Facets::beckmann, d, w, eta, o, m);
      }
    }
  }
  float all = 0.0f;
  Bounces sum = {0.0f, 0.0f};
  for (u32 i = 0; i < kBounceLanes; ++i) {
    all += sums.all[i];
    sum.reflected += sums.reflected[i];
    sum.refracted += sums.refracted[i];
  }
  return {sum.reflected / all, sum.refracted / all};
}

// Where the tables of isotropic glass have the light from w: of that from within where eta, the
// index of the far side, is below 1.
struct GlassPlace {
  Cubic angle, index, alpha;
  float within;  // 1 or 0
};
PH_INLINE GlassPlace glass_place(const Microfacets& d, Vec3 w, float eta) {
  const bool within = eta < 1.0f;
  const float alpha = d.alpha_u, z = clamp_positive(abs(w.z), 0.0f, 1.0f);
  const float inner = inner_coordinate(z, alpha, eta), outer = angle_coordinate(z, alpha);
  return {cubic(within ? inner : outer, within ? kInnerAngles : kOuterAngles),
          cubic(index_coordinate(within ? 1.0f / eta : eta), within ? kInnerIndices : kIndices),
          cubic(sqrt(alpha), within ? kInnerAlphas : kOuterAlphas), within ? 1.0f : 0.0f};
}

// What glass reflects and refracts together of the light from w.
inline float glass_albedo(Facets distribution, const GlassPlace& at) {
  const auto in = [&](const auto* table, u32 indices, u32 alphas, u32 angles) {
    return grid(table + static_cast<u32>(distribution) * indices * alphas * angles, at.angle,
                alphas * angles, at.index, angles, at.alpha);
  };
  return at.within != 0.0f ? in(kGlassInner, kInnerIndices, kInnerAlphas, kInnerAngles)
                           : in(kGlassOuter, kIndices, kOuterAlphas, kOuterAngles);
}
inline float glass_albedo(const Microfacets& d, Vec3 w, float eta) {
  if (isotropic(d)) return glass_albedo(d.distribution, glass_place(d, w, eta));
  const Bounces once = count_bounces(d, w, eta, true);
  return once.reflected + once.refracted;
}

// A dielectric coat of index eta >= 1, whose reflection is not compensated: what does not come back
// may go into what it covers.
struct Coat {
  Microfacets facets;
  float eta, place;  // place: index_coordinate(eta)
  bool smooth;
  Cubic index, alpha;
};

PH_INLINE Coat make_coat(const Microfacets& d, float eta) {
  const float place = index_coordinate(eta);
  return {d, eta, place, smooth(d), cubic(place, kIndices), cubic(sqrt(d.alpha_u), kCoatAlphas)};
}

// What facets all at one angle would reflect, about as much as a rough coat does,
PH_INLINE float rough_coat_share(const Coat& c, float z) {
  const float alpha = c.facets.alpha_u, sine2 = 1.0f - z * z;
  return fresnel_dielectric(sqrt(z * z + alpha * alpha * sine2), c.eta).reflected;
}
PH_INLINE float coat_share(const Coat& c, float z) {
  return c.smooth ? fresnel_dielectric(z, c.eta).reflected : rough_coat_share(c, z);
}
// and where in the tables it says by how much a rough and isotropic one differs from that.
struct CoatPlace {
  float share;
  Cubic angle, index, alpha;
};
PH_INLINE CoatPlace coat_place(const Coat& c, Vec3 w) {
  const float z = clamp_positive(abs(w.z), 0.0f, 1.0f);
  return {rough_coat_share(c, z), cubic(angle_coordinate(z, c.facets.alpha_u), kCoatAngles),
          c.index, c.alpha};
}
template <class T>
PH_INLINE float coat_less(Facets distribution, const CoatPlace& at, const T* table) {
  constexpr u32 kRow = kCoatAngles, kPage = kCoatAlphas * kRow;
  return grid(table + static_cast<u32>(distribution) * kIndices * kPage, at.angle, kPage, at.index,
              kRow, at.alpha);
}

// The share of the light from w, on either side, that a coat reflects,
inline float coat_reflected(Facets distribution, const CoatPlace& at) {
  return clamp(at.share - coat_less(distribution, at, kCoatReflected), 0.0f, 1.0f);
}
inline float coat_reflected(const Coat& c, Vec3 w) {
  const float z = min(abs(w.z), 1.0f);
  if (c.smooth) return coat_share(c, z);
  if (!isotropic(c.facets)) {
    return count_bounces(c.facets, {w.x, w.y, z}, c.eta, false).reflected;
  }
  return coat_reflected(c.facets.distribution, coat_place(c, w));
}
// and the share that an isotropic one lets in, in single bounces.
inline float coat_refracted(Facets distribution, const CoatPlace& at) {
  return clamp(1.0f - at.share - coat_less(distribution, at, kCoatRefracted), 0.0f, 1.0f);
}
inline float coat_refracted(const Coat& c, Vec3 w) {
  return c.smooth ? 1.0f - coat_share(c, min(abs(w.z), 1.0f))
                  : coat_refracted(c.facets.distribution, coat_place(c, w));
}

// The means over diffuse light, of isotropic coats: of what is reflected of light from outside,
inline float coat_mean(const Coat& c) {
  const float share = grid(kSmoothMean, cubic(c.place, kFineIndices));
  if (c.smooth) return share;
  const u32 first = static_cast<u32>(c.facets.distribution) * kIndices * kCoatAlphas;
  return share - grid(kCoatMean + first, c.alpha, kCoatAlphas, c.index);
}

// and of light from within, in single bounces.
inline float coat_mean_within(const Coat& c) {
  const u32 first = static_cast<u32>(c.facets.distribution) * kIndices * kCoatAlphas;
  return grid(kCoatWithin + first, c.alpha, kCoatAlphas, c.index);
}

}  // namespace parhelion::PH_ISA
