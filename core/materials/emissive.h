// A surface that shines with the same radiance in every direction and reflects nothing.
#pragma once
#include "../bsdf.h"

namespace parhelion::PH_ISA {

struct Emissive {
  Vec3 radiance;

  static constexpr const char* doc = "light source: shines, reflects nothing";
  static constexpr ParamInfo params[] = {
      {"radiance", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1e12f, "emitted radiance, linear RGB"},
  };
};

PH_INLINE Vec3 emitted(const Emissive& m) { return m.radiance; }
PH_INLINE bool is_delta(const Emissive&) { return true; }
PH_INLINE float pdf(const Emissive&, Vec3, Vec3) { return 0.0f; }
PH_INLINE Vec3 eval(const Emissive&, Vec3, Vec3) { return {0, 0, 0}; }
PH_INLINE bool sample(const Emissive&, Vec3, const BsdfDraws&, BsdfSample&) { return false; }

}  // namespace parhelion::PH_ISA
