// The surface area heuristic: a ray meets a box as often as the box is large, so what is within it
// costs its surface times what has to be tested there.
// Method: J. D. MacDonald and K. S. Booth, "Heuristics for Ray Tracing using Space Subdivision",
// The Visual Computer 6(3), 1990.
#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

#include "boxes.h"

namespace parhelion::tree {

inline constexpr size_t kLeafSize = 16;

struct Bin {
  Extent box;
  size_t count = 0;
  void add(const Ref& r) {
    box.grow(r);
    ++count;
  }
  void grow(const Bin& b) {
    box.grow(b.box);
    count += b.count;
  }
};

// Calls f(first, count) for [0, n), some at a time: where these go is worked out before any is
// added to its bin. A processor that has not yet worked out where it stores something holds back
// what it reads from bins, or reads too early and begins again.
inline constexpr size_t kSome = 16;
template <class F>
void for_some(size_t n, const F& f) {
  for (size_t first = 0; first < n; first += kSome) f(first, std::min(kSome, n - first));
}

inline float cost(const Extent& box, size_t count) {
  return box.half_area() * static_cast<float>((count + kLeafSize - 1) / kLeafSize);
}

// The least expected cost of dividing bins into those before a cut and those after; infinite
// if one side would be empty. Sixteen primitives are as soon tested as one.
inline float best_of(const Bin* bins, size_t n, size_t& best) {
  float best_cost = INFINITY;
  constexpr size_t kFew = 64;
  float few[kFew];
  std::vector<float> many;
  float* after = few;  // of what lies from bin i on
  if (n > kFew) many.resize(n), after = many.data();
  Bin sum;
  for (size_t i = n; i-- > 1;) {
    sum.grow(bins[i]);
    after[i] = sum.count > 0 ? cost(sum.box, sum.count) : INFINITY;
  }
  sum = Bin();
  for (size_t i = 1; i < n; ++i) {
    sum.grow(bins[i - 1]);
    if (sum.count == 0) continue;
    const float c = cost(sum.box, sum.count) + after[i];
    if (c < best_cost) best_cost = c, best = i;
  }
  return best_cost;
}

}  // namespace parhelion::tree
