// Sixteen paths that go in step.
#pragma once
#include "../path.h"
#include "vertices.h"

namespace parhelion::PH_ISA {

inline constexpr u32 kAllLanes = (1u << kBatch) - 1;

struct PathGroup;

struct Wave {
  u32 alive = 0;  // a bit for each path that goes on
  Paths paths = {};
  Features* features = nullptr;  // by lane, if they are asked for
  PathGroup* groups = nullptr;   // of paths that are shared, by their tags, if any are (reuse.h)

  // Light that is direct has been found when the second ray ends.
  PH_INLINE void note_direct(u32 lanes) {
    if (!features) return;
    for_each_bit(lanes, [&](u32 k) {
      if (paths.depth[k] <= 2) features[k].direct = paths.sum.at(k) - features[k].emission;
    });
  }
};

// Calls f.operator()<flag>(), since a loop must not ask.
template <class F>
PH_INLINE void with_flag(bool flag, F&& f) {
  if (flag) {
    f.template operator()<true>();
  } else {
    f.template operator()<false>();
  }
}

// Of some lanes those whose numbers have any of some bits.
PH_INLINE u32 having(u32 bits, const u32 (&numbers)[kBatch], u32 lanes) {
  return any_of(bits, numbers) & lanes;
}

// 1 for each lane of a set of bits, else 0.
PH_INLINE void spread(u32 lanes, u32 (&these)[kBatch]) {
  for (u32 k = 0; k < kBatch; ++k) these[k] = lanes >> k & 1u;
}

}  // namespace parhelion::PH_ISA
