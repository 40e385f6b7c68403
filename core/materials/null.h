// A surface that is not there: everything passes straight through.
#pragma once
#include "../bsdf.h"

namespace parhelion::PH_ISA {

struct Null {
  Vec3 color;

  static constexpr bool transmits = true;
  static constexpr const char* doc = "invisible: light passes straight through";
  static constexpr ParamInfo params[] = {
      {"color", 3, {1.0f, 1.0f, 1.0f}, 0.0f, 1.0f, "share of the light that passes"},
  };
};

PH_INLINE bool is_delta(const Null&) { return true; }
PH_INLINE float pdf(const Null&, Vec3, Vec3) { return 0.0f; }
PH_INLINE Vec3 eval(const Null&, Vec3, Vec3) { return {0, 0, 0}; }

PH_INLINE bool sample(const Null& m, Vec3 wo, const BsdfDraws&, BsdfSample& out) {
  out.wi = -wo;
  out.weight = m.color;
  out.delta = true;
  return true;
}

}  // namespace parhelion::PH_ISA
