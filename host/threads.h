// When threads are worth their start.
#pragma once
#include <cstddef>

namespace parhelion {

// Loops over fewer elements run on one thread: to wake others takes longer, most of all where other
// programs keep the processors busy.
inline constexpr std::size_t kFewElements = 4096;

}  // namespace parhelion
