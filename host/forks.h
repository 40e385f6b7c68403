// Parts divided in two again and again, and which of these forks become nodes of sixteen.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "array.h"
#include "bins.h"
#include "grid.h"
#include "sah.h"

namespace parhelion::tree {

// What has been divided in two so often is halved from there on.
inline constexpr int kMostForks = 64;
// For sixteen primitives there are some 2.1 forks, as leaves are not quite full, and some are two:
// with what follows there is room for all, as a rule.
constexpr size_t forks_over(size_t primitives) { return primitives * 9 / 64 + 1; }
// Forks over so many primitives, or fewer, are one thread's.
inline constexpr size_t kForksATask = 4096;

// What a node and a leaf cost, however seldom rays visit them, in units of surface.
struct Upkeep {
  float node, leaf;
};

// Whether all primitives of a part lie in one place, or most in crowded cells of a grid of its own,
// as those of clusters and of many surfaces do.
inline bool leaves_room(const Part& part) {
  if (part.is_point()) return true;
  return crowded(Grid(part.centers, part.size), part.size, 1, kCrowdOfAll,
                 [&](size_t i) -> const Ref& { return part.refs[i]; });
}

// A node costs a share of what rays pay for the uppermost of its part, a leaf one of the surface of
// an average leaf there, as if they filled the part's box. Leaves are smaller in `roomy` parts,
// which have more of them.
inline Upkeep upkeep_of(const Part& part, bool roomy) {
  const float node = 0.01f, leaf = roomy ? 0.06f : 0.2f;
  const float area = part.box.half_area();
  const float leaves = static_cast<float>(part.size) / kLeafSize;
  return {area * node, area / std::pow(leaves, 2.0f / 3.0f) * leaf};
}

// A part divided in two, and those again, down to leaves or halves of them; and what the best
// nodes of sixteen over it cost: cost[i] as up to i + 1 children of a node above. Of the children
// that it is given, the left half takes first[i], 0 if it is better a child itself.
struct Fork {
  static constexpr int kMostCosts = 15;

  Fork *left, *right, *parent;
  Ref* refs;  // of its primitives; none where these are not in one place
  Extent box;
  size_t size;
  Upkeep upkeep;  // of a node or a leaf made of it
  float cost[kMostCosts];
  std::uint8_t first[kMostCosts + 1];
  std::uint8_t leaves;  // below it, up to kMostCosts; to more children it has no use for the rest

  // Stands in cost[0] until it is known.
  static constexpr float kUnknown = -1.0f;

  void cost_as_leaf() {
    std::fill(cost, cost + kMostCosts, box.half_area() + upkeep.leaf);
    std::fill(first, first + kMostCosts + 1, std::uint8_t{0});
    leaves = 1;
  }
  void join(Fork* a, Fork* b) {
    left = a, right = b;
    a->parent = b->parent = this;
  }
};

// Where forks are kept, and stay while others are made.
class ForkRoom {
 public:
  explicit ForkRoom(size_t primitives) : block_(forks_over(primitives)) {}

  Fork& add(const Part& part, Upkeep upkeep) {
    if (next_ == end_) {
      blocks_.emplace_back(blocks_.empty() ? block_ : block_ / 4 + 1);
      next_ = blocks_.back().begin();
      end_ = blocks_.back().end();
    }
    *next_ = {nullptr, nullptr, nullptr, part.refs, part.box, part.size, upkeep, {}, {}, 0};
    next_->cost_as_leaf();
    return *next_++;
  }

 private:
  const size_t block_;
  std::vector<Array<Fork>> blocks_;
  Fork *next_ = nullptr, *end_ = nullptr;
};

inline void halve(const Part& part, int levels, Part& left, Part& right) {
  if (levels < kMostForks) {
    split(part, left, right);
  } else {
    split_by_count(part, left, right);
  }
}

// What a fork costs by what its halves do.
// Method: H. Ylitie, T. Karras and S. Laine, "Efficient Incoherent Ray Traversal on GPUs Through
// Compressed Wide BVHs", HPG 2017, section 3.1.
inline void weigh(Fork& f) {
  const float *a = f.left->cost, *b = f.right->cost;
  const auto best = [&](int children, std::uint8_t& first) {
    float least = a[0] + b[children - 2];
    first = 1;
    for (int k = 2; k < children; ++k) {
      const float c = a[k - 1] + b[children - k - 1];
      if (c < least) least = c, first = static_cast<std::uint8_t>(k);
    }
    return least;
  };
  const int leaves = f.left->leaves + f.right->leaves;
  f.leaves = static_cast<std::uint8_t>(std::min(leaves, Fork::kMostCosts));
  if (f.size > kLeafSize) {
    f.cost[0] = best(std::min(leaves, 16), f.first[15]) + f.box.half_area() + f.upkeep.node;
  }
  for (int children = 2; children <= f.leaves; ++children) {
    const size_t i = static_cast<size_t>(children - 1);
    f.cost[i] = best(children, f.first[i]);
    if (f.cost[0] <= f.cost[i]) f.cost[i] = f.cost[0], f.first[i] = 0;
  }
  std::fill(f.cost + f.leaves, f.cost + Fork::kMostCosts, f.cost[f.leaves - 1]);
  std::fill(f.first + f.leaves, f.first + Fork::kMostCosts, f.first[f.leaves - 1]);
}

// The forks of a part. What fits into a leaf may be two where the node above has room, as when
// something large lies beside what is small.
inline Fork& fork(const Part& part, Upkeep upkeep, int levels, ForkRoom& room) {
  Fork& f = room.add(part, upkeep);
  const bool small = part.size <= kLeafSize;
  // A second leaf costs its upkeep at least, so two are no better where the part's own surface is
  // no more than that. Centres that coincide stay together, unless there are more than a leaf
  // holds.
  if (small && (part.size < 2 || part.box.half_area() <= upkeep.leaf || part.is_point() ||
                levels >= kMostForks)) {
    return f;
  }
  Part left, right;
  if (small) {
    const Plane plane = best_plane<kBins / 2>(part);
    if (!(plane.cost + upkeep.leaf < part.box.half_area())) return f;
    split(part, plane, left, right);
    Fork& first = room.add(left, upkeep);
    f.join(&first, &room.add(right, upkeep));
  } else {
    halve(part, levels, left, right);
    Fork& first = fork(left, upkeep, levels + 1, room);
    f.join(&first, &fork(right, upkeep, levels + 1, room));
  }
  weigh(f);
  return f;
}

// Up to sixteen children of a node, as the costs say; returns how many.
inline int children_of(const Fork& node, const Fork* (&child)[16]) {
  int count = 0;
  const auto visit = [&](const auto& self, const Fork& f, size_t children) -> void {
    const std::uint8_t left = f.first[children - 1];
    if (left == 0) {
      child[count++] = &f;
    } else {
      self(self, *f.left, left);
      self(self, *f.right, children - left);
    }
  };
  visit(visit, node, 16);
  return count;
}

}  // namespace parhelion::tree
