// What every material answers, in the local frame of the surface: z is the outward normal, wo
// points back to where the path came from, wi on to where light comes from.
//
// A material M, materials/NAME.h, has
//   a struct M whose members are its parameters in the order of M::params; the first is its colour,
//     which a primitive's own colour replaces
//   is_delta(m)             all of it is mirror-like: eval and pdf are 0
//   eval(m, wo, wi)         f |cos wi|
//   pdf(m, wo, wi)          density of sample, per steradian
//   sample(m, wo, ...)      false where the path ends
//   transmits = true        if light can pass: it is then asked for either side of the surface,
//   else
//                           only for wo above it, whichever side is seen
//   albedo(m)               for features, if the colour is not good enough
//   emitted(m)              radiance, only if it shines
#pragma once
#include "entry.h"
#include "random.h"

namespace parhelion::PH_ISA {

struct BsdfSample {
  Vec3 wi;
  Vec3 weight;  // f |cos| / pdf
  float pdf;    // 0 if delta
  float eta;    // index of the far side over the near side if the light passed through, else 1
  bool delta;
};

template <class Material>
PH_INLINE Vec3 emitted(const Material&) {
  return {0, 0, 0};
}

}  // namespace parhelion::PH_ISA
