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

  static constexpr const char* doc = "mirror, blurred by fuzz";
  static constexpr ParamInfo params[] = {
      {"color", 3, {0.8f, 0.8f, 0.8f}, 0.0f, 1.0f, "share of the light that is reflected"},
      {"fuzz", 1, {0.0f}, 0.0f, 1.0f, "0 a mirror; else the radius of the blurring sphere"},
  };
};

// A lobe narrower than this is treated as a mirror: its density would exceed 1e7.
PH_INLINE bool is_delta(const Metal& m) { return m.fuzz < 1e-4f; }

// The lobe's own radius; a sphere through the origin itself would have no bound on its density.
PH_INLINE float lobe_radius(const Metal& m) { return min(m.fuzz, 0.9999f); }

PH_INLINE float pdf(const Metal& m, Vec3 wo, Vec3 wi) {
  if (is_delta(m) || wo.z * wi.z <= 0.0f) return 0.0f;
  const Frame lobe = frame_around({-wo.x, -wo.y, wo.z});
  const float radius = lobe_radius(m);
  return fuzzy_lobe_pdf(to_local(lobe, wi), radius) +
         fuzzy_lobe_pdf(to_local(lobe, {wi.x, wi.y, -wi.z}), radius);
}

PH_INLINE Vec3 eval(const Metal& m, Vec3 wo, Vec3 wi) { return m.color * pdf(m, wo, wi); }

PH_INLINE bool sample(const Metal& m, Vec3 wo, const BsdfDraws& u, BsdfSample& out) {
  const Vec3 mirrored = {-wo.x, -wo.y, wo.z};
  out.weight = m.color;
  if (is_delta(m)) {
    out.wi = mirrored;
    out.delta = true;
    return true;
  }
  out.wi = to_world(frame_around(mirrored), fuzzy_lobe(u.direction, lobe_radius(m)));
  out.wi.z = copysign(out.wi.z, wo.z);
  out.pdf = pdf(m, wo, out.wi);
  // Rounding may move a direction over the lobe's limb, where the density has its pole.
  if (!(out.pdf > 0.0f)) out.pdf = 1e10f;
  return true;
}

}  // namespace parhelion::PH_ISA
