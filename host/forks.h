// Parts divided in two again and again, and which of these forks become nodes of sixteen.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bins.h"
#include "sah.h"

namespace parhelion {

// What has been divided in two so often is halved from there on.
inline constexpr int kMostForks = 64;

// A part divided in two, and those again, down to leaves or halves of them; and what the best
// nodes of sixteen over it cost: cost[i] as up to i + 1 children of a node above. Of the children
// that it is given, the left half takes first[i], 0 if it is better a child itself.
struct Fork {
  Part part;
  size_t right;  // index; the left one follows
  float cost[15];
  std::uint8_t first[16];
};

// What a node and a leaf cost, however seldom rays visit them, in units of surface.
struct Memory {
  float node, leaf;
};

inline Fork leaf_fork(const Part& part, Memory memory) {
  Fork f{part, 0, {}, {}};
  std::fill(f.cost, f.cost + 15, part.box.half_area() + memory.leaf);
  return f;
}

// Method: H. Ylitie, T. Karras and S. Laine, "Efficient Incoherent Ray Traversal on GPUs Through
// Compressed Wide BVHs", HPG 2017, section 3.1. What fits into a leaf may be two where the node
// above has room, as when something large lies beside what is small.
inline void fork(const Part& part, Memory memory, int levels, std::vector<Fork>& forks) {
  const size_t index = forks.size();
  forks.push_back(leaf_fork(part, memory));
  const bool small = part.size <= kLeafSize;
  // Centres that coincide stay together, unless there are more of them than a leaf holds.
  if (part.size < 2 || (small && (part.is_point() || levels >= kMostForks))) return;
  Part left, right;
  if (levels < kMostForks) {
    split(part, left, right);
  } else {
    split_by_count(part, left, right);
  }
  if (small) {
    const float two = left.box.half_area() + right.box.half_area();
    if (!(two + memory.leaf < part.box.half_area())) return;
    forks.push_back(leaf_fork(left, memory));
    forks[index].right = forks.size();
    forks.push_back(leaf_fork(right, memory));
  } else {
    fork(left, memory, levels + 1, forks);
    forks[index].right = forks.size();
    fork(right, memory, levels + 1, forks);
  }
  Fork& f = forks[index];
  const float* a = forks[index + 1].cost;
  const float* b = forks[f.right].cost;
  const auto best = [&](int children, std::uint8_t& first) {
    float least = a[0] + b[children - 2];
    first = 1;
    for (int k = 2; k < children; ++k) {
      const float c = a[k - 1] + b[children - k - 1];
      if (c < least) least = c, first = static_cast<std::uint8_t>(k);
    }
    return least;
  };
  if (!small) {
    f.cost[0] = best(16, f.first[15]) + part.box.half_area() + memory.node;
  }
  for (int children = 2; children < 16; ++children) {
    const size_t i = static_cast<size_t>(children - 1);
    f.cost[i] = best(children, f.first[i]);
    if (f.cost[0] <= f.cost[i]) f.cost[i] = f.cost[0], f.first[i] = 0;
  }
}

}  // namespace parhelion
