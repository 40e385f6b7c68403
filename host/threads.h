// When threads are worth their start.
#pragma once
#include <cstddef>

namespace parhelion {

// Loops over fewer elements run on one thread: to wake others takes longer, most of all where other
// programs keep the processors busy.
inline constexpr std::size_t kFewElements = 4096;

// f(i) of each i < n, by all threads if these are many.
template <class F>
void for_all(std::size_t n, const F& f) {
#pragma omp parallel for schedule(static) if (n > kFewElements)
  for (std::size_t i = 0; i < n; ++i) f(i);
}

}  // namespace parhelion
