// A mirror whose reflections are blurred by moving the mirrored direction to a random point of a
// sphere around its tip: the classic "fuzz".
//
// The classic program absorbs what that moves below the surface, so a white metal is grey at
// grazing angles; here those directions are folded back above it, and a white metal is white.
#pragma once
#include "../bsdf.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

struct Metal {
  Vec3 color;
  float fuzz;

  using Plain = PlainForms<Metal>;
  static constexpr const char* doc = "mirror, blurred by fuzz";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.8f, 0.8f, 0.8f}, 0.0f, 1.0f, "share of the light that is reflected"},
      {"fuzz", 1, {0.0f}, 0.0f, 1.0f, "0 a mirror; else the radius of the blurring sphere"},
  };

  PH_INLINE static bool fits(const Metal&) { return true; }
  PH_INLINE static Metal of(const Metal& m) { return m; }
  PH_INLINE Metal whole() const { return *this; }
};

// A lobe narrower than this is treated as a mirror: its density would exceed 1e7.
PH_INLINE bool is_delta(const Metal& m) { return m.fuzz < 1e-4f; }

// The lobe's own radius; a sphere through the origin itself would have no bound on its density.
PH_INLINE float lobe_radius(const Metal& m) { return min(m.fuzz, 0.9999f); }

PH_INLINE float pdf(const Metal& m, Vec3 wo, Vec3 wi) {
  const Frame lobe = frame_around({-wo.x, -wo.y, wo.z});
  const float radius = lobe_radius(m);
  const float density = fuzzy_lobe_pdf(to_local(lobe, wi), radius) +
                        fuzzy_lobe_pdf(to_local(lobe, {wi.x, wi.y, -wi.z}), radius);
  return (is_delta(m) | (wo.z * wi.z <= 0.0f)) ? 0.0f : density;
}

PH_INLINE Vec3 eval(const Metal& m, Vec3 wo, Vec3 wi) { return m.color * pdf(m, wo, wi); }

PH_INLINE bool sample(const Metal& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const bool mirror = is_delta(m);
  const Vec3 mirrored = {-wo.x, -wo.y, wo.z};
  Vec3 wi = to_world(frame_around(mirrored), fuzzy_lobe(u.direction, lobe_radius(m)));
  wi.z = copysign(wi.z, wo.z);
  out.wi = select(mirror, mirrored, wi);
  // Rounding may move a direction over the lobe's limb, where the density has its pole.
  const float density = pdf(m, wo, wi);
  out.pdf = mirror ? 0.0f : density > 0.0f ? density : 1e10f;
  out.delta = mirror;
  out.weight = m.color;
  return true;
}

}  // namespace parhelion::PH_ISA
