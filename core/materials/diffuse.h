// Matte surfaces: Lambert's cosine law, or, with roughness, the energy-preserving form of Oren and
// Nayar's, which looks flatter and brighter towards the light, as plaster, clay and the moon do.
//
// Rough model: Portsmouth, Kutz and Hill, "EON: A Practical Energy-Preserving Rough Diffuse BRDF",
// JCGT 14(1), 2025. White is white at every angle: what one bounce between facets loses is given
// back by a term whose albedo is exactly that.
#pragma once
#include "../bsdf.h"
#include "../special.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

struct Diffuse {
  Vec3 color;
  float roughness;

  using Plain = PlainForms<struct PlainDiffuse, struct RoughDiffuse>;
  static constexpr const char* doc = "matte, on both sides: Lambert's cosine law, or rough";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.8f, 0.8f, 0.8f}, 0.0f, 1.0f, "share of the light that is reflected"},
      {"roughness", 1, {0.0f}, 0.0f, 1.0f, "0 is Lambert's law, 1 like dry plaster"},
  };
};

// Lambert's
struct PlainDiffuse {
  Vec3 color;

  PH_INLINE static bool fits(const Diffuse& m) { return m.roughness == 0.0f; }
  PH_INLINE static PlainDiffuse of(const Diffuse& m) { return {m.color}; }
  PH_INLINE Diffuse whole() const { return {color, 0.0f}; }
};

PH_INLINE float let_out(const PlainDiffuse&, Vec3) { return 1.0f; }

PH_INLINE bool is_delta(const Diffuse&) { return false; }

// 1 - 1 / A of the paper's A at roughness 1, and the mean loss of a single bounce there over A.
inline constexpr float kRoughLoss = 0.5f - 2.0f / (3.0f * kPi);
inline constexpr float kRoughMeanLoss = kRoughLoss - (2.0f / 3.0f - 28.0f / (15.0f * kPi));

// Loss of a single bounce seen at a cosine, at roughness 1 over A: the albedo in the paper's
// equation for G, in a form that does not cancel.
PH_INLINE float rough_loss(float cosine) {
  const float s = safe_sqrt(1.0f - cosine * cosine);
  // (1 - s^3) / cosine = cosine (1 + s + s^2) / (1 + s)
  const float g = s * (acos(cosine) - s * cosine) +
                  (2.0f / 3.0f) * (s * cosine * (1.0f + s + s * s) / (1.0f + s) - s);
  return kRoughLoss - g * (1.0f / kPi);
}

// The rough ones
struct RoughDiffuse {
  Vec3 color;
  float roughness;

  PH_INLINE static bool fits(const Diffuse& m) { return m.roughness != 0.0f; }
  PH_INLINE static RoughDiffuse of(const Diffuse& m) { return {m.color, m.roughness}; }
  PH_INLINE RoughDiffuse whole() const { return *this; }
};

// f pi, without branches
PH_INLINE Vec3 reflectance(const RoughDiffuse& m, Vec3 wo, Vec3 wi) {
  const float o = abs(wo.z), i = abs(wi.z);
  const float scale = 1.0f / (1.0f + kRoughLoss * m.roughness);
  const float s = wo.x * wi.x + wo.y * wi.y;
  const float once = scale * (1.0f + m.roughness * (s > 0.0f ? s / max(o, i) : s));
  const float r = scale * m.roughness;
  const float again = max(r * rough_loss(o) * rough_loss(i) * (1.0f / kRoughMeanLoss), 0.0f);
  const float lost = r * kRoughMeanLoss;
  const auto both = [&](float c) {
    return c * once + c * c * (1.0f - lost) / (1.0f - c * lost) * again;
  };
  return {both(m.color.x), both(m.color.y), both(m.color.z)};
}

PH_INLINE Vec3 reflectance(const Diffuse& m, Vec3 wo, Vec3 wi) {
  return m.roughness == 0.0f ? m.color : reflectance(RoughDiffuse::of(m), wo, wi);
}

template <class Material>
concept IsDiffuse = requires(const Material& m) { reflectance(m, Vec3{}, Vec3{}); };

template <IsDiffuse Material>
PH_INLINE float pdf(const Material&, Vec3 wo, Vec3 wi) {
  return wo.z * wi.z > 0.0f ? cosine_hemisphere_pdf({wi.x, wi.y, abs(wi.z)}) : 0.0f;
}

template <IsDiffuse Material>
PH_INLINE Vec3 eval(const Material& m, Vec3 wo, Vec3 wi) {
  return reflectance(m, wo, wi) * pdf(m, wo, wi);
}

template <IsDiffuse Material>
PH_INLINE bool sample(const Material& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  out.wi = cosine_hemisphere(u.direction);
  out.pdf = cosine_hemisphere_pdf(out.wi);
  out.wi.z = copysign(out.wi.z, wo.z);
  out.weight = reflectance(m, wo, out.wi);
  return out.pdf > 0.0f;
}

}  // namespace parhelion::PH_ISA
