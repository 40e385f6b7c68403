// In what order a ray that asks for any hit looks into a node's children: first where a hit is
// likeliest for what it costs to look, which is the best order of tests that do not depend on each
// other. What is likely and what it costs is worked out from the leaves up.
// After: N. Feltman, M. Lee and K. Fatahalian, "SRDH: Specializing BVH Construction and Traversal
// Order Using Representative Shadow Ray Sets", HPG 2012, with surfaces in the place of sampled
// rays.
#pragma once
#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "../core/view.h"
#include "boxes.h"

namespace parhelion::tree {

// Of a ray that meets the box of a part: the chance that it hits something there, and how many
// nodes and leaves it looks into until then.
struct Expected {
  float hit, visits;
};

// Of an instance, whose tree is another's.
inline constexpr Expected kOfInstance = {0.5f, 4.0f};

// A line that meets a convex body meets one within it with the chance of the ratio of their
// surfaces. Triangles and spheres have about half the surface of their boxes. Several may hide
// behind each other.
inline Expected expected_of(const Ref* from, const Ref* to) {
  Extent whole;
  float sum = 0.0f;
  for (const Ref* r = from; r != to; ++r) {
    Extent box;
    box.grow(*r);
    whole.grow(box);
    sum += box.half_area();
  }
  const float area = 2.0f * whole.half_area();
  return {area > 0.0f ? sum / (area + sum) : 1.0f, 1.0f};
}

inline bool is_there(const Node& n, int lane) { return n.low[0][lane] <= n.high[0][lane]; }

// Puts a node's children in order, the first to look into last; of(lane): what is expected of one.
template <class Of>
Expected put_in_order(Node& node, const Of& of) {
  std::pair<float, int> order[16];
  float area[16] = {};
  Expected expected[16] = {};
  Extent whole;
  for (int lane = 0; lane < 16; ++lane) {
    order[lane] = {-1.0f, lane};
    if (!is_there(node, lane)) continue;
    const float low[] = {node.low[0][lane], node.low[1][lane], node.low[2][lane], 0.0f};
    const float high[] = {node.high[0][lane], node.high[1][lane], node.high[2][lane], 0.0f};
    const Extent box = {Point::of(low), Point::of(high)};
    whole.grow(box);
    area[lane] = box.half_area();
    expected[lane] = of(lane);
    order[lane].first = expected[lane].hit / expected[lane].visits;
  }
  std::sort(order, order + 16);
  const Node given = node;
  const float all = whole.half_area();
  float missed = 1.0f, visits = 1.0f;
  for (int lane = 16; lane-- > 0;) {
    const int from = order[lane].second;
    for (int k = 0; k < 3; ++k) {
      node.low[k][lane] = given.low[k][from];
      node.high[k][lane] = given.high[k][from];
    }
    node.child[lane] = given.child[from];
    const float met = all > 0.0f ? area[from] / all : 1.0f;
    visits += missed * met * expected[from].visits;
    missed *= 1.0f - met * expected[from].hit;
  }
  return {1.0f - missed, visits};
}

// The same of nodes, each of which comes before those below it; of(i, lane, below): what is
// expected of a child, `below` being what is of the nodes themselves. Returns what is of the first.
template <class Of>
Expected put_all_in_order(std::vector<Node>& nodes, const Of& of) {
  std::vector<Expected> below(nodes.size());
  for (size_t i = nodes.size(); i-- > 0;) {
    below[i] = put_in_order(nodes[i], [&](int lane) { return of(i, lane, below); });
  }
  return below[0];
}

}  // namespace parhelion::tree
