#include "tree_cost.h"

#include <vector>

#include "boxes.h"

namespace parhelion {
namespace {

double half_area(const Aabb& box) {
  double side[3];
  for (int k = 0; k < 3; ++k) side[k] = static_cast<double>(box.high[k]) - box.low[k];
  return side[0] * side[1] + side[1] * side[2] + side[2] * side[0];
}

// Calls f(child, box) for what a node has.
template <class F>
void for_each_child(const Node& node, F&& f) {
  for (int i = 0; i < 16; ++i) {
    Aabb box;
    for (int k = 0; k < 3; ++k) box.low[k] = node.low[k][i], box.high[k] = node.high[k][i];
    if (box.low[0] <= box.high[0]) f(node.child[i], box);
  }
}

}  // namespace

TreeCost tree_cost(const SceneView& scene) {
  if (scene.root & kLeafBit) return {0.0, 1.0};
  Aabb all;
  for_each_child(scene.nodes[scene.root], [&](Child, const Aabb& box) {
    all.grow(box.low);
    all.grow(box.high);
  });
  const double whole = half_area(all);
  TreeCost cost = {1.0, 0.0};
  std::vector<Child> left = {scene.root};
  while (!left.empty()) {
    const Node& node = scene.nodes[left.back()];
    left.pop_back();
    for_each_child(node, [&](Child child, const Aabb& box) {
      const bool leaf = (child & kLeafBit) != 0;
      (leaf ? cost.leaves : cost.nodes) += half_area(box) / whole;
      if (!leaf) left.push_back(child);
    });
  }
  return cost;
}

}  // namespace parhelion
