#include "tree_cost.h"

#include <vector>

#include "boxes.h"

namespace parhelion {
namespace {

// Calls f(child, box) for what a node has.
template <class F>
void for_each_child(const Node& node, F&& f) {
  for (int i = 0; i < 16; ++i) {
    Ref own = {};
    for (int k = 0; k < 3; ++k) own.low[k] = node.low[k][i], own.high[k] = node.high[k][i];
    if (!(own.low[0] <= own.high[0])) continue;  // none there
    Extent box;
    box.grow(own);
    f(node.child[i], box);
  }
}

}  // namespace

TreeCost tree_cost(const SceneView& scene) {
  if (scene.root & kLeafBit) return {0.0, 1.0};
  Extent all;
  for_each_child(scene.nodes[scene.root], [&](Child, const Extent& box) { all.grow(box); });
  const double whole = all.half_area();
  TreeCost cost = {1.0, 0.0};
  std::vector<Child> left = {scene.root};
  while (!left.empty()) {
    const Node& node = scene.nodes[left.back()];
    left.pop_back();
    for_each_child(node, [&](Child child, const Extent& box) {
      const bool leaf = (child & kLeafBit) != 0;
      (leaf ? cost.leaves : cost.nodes) += box.half_area() / whole;
      if (!leaf) left.push_back(child);
    });
  }
  return cost;
}

}  // namespace parhelion
