// Who looks on while paths go in step.
#pragma once
#include "wave.h"

namespace parhelion::PH_ISA {

// When a path may be looked at: after each of these.
enum class Step : u32 { begins, leaves, meets, approaches, asks, receives, scatters };

// Looks at nothing, and is nothing once it is compiled. vertices: what paths have met, null before
// `meets`; the light that is asked for is there from `asks` on. lit: whether the surface scatters
// any of that.
struct Unwatched {
  PH_INLINE void operator()(Step, const Wave&, const Vertices*, u32 /*lane*/, Fate,
                            bool /*lit*/ = false) const {}
};

}  // namespace parhelion::PH_ISA
