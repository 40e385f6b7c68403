// Building the tree of lights that core/light_tree.h descends.
#pragma once
#include <cstddef>
#include <vector>

#include "../core/light_tree.h"

namespace parhelion {

// What the tree knows of a light. `axis` (unit) and cos_o bound its normals: cos_o is 1 for a flat
// light and -1 for a sphere, a point, or what shines on both sides. It shines up to the angle of
// cosine cos_e from a normal: 0 for surfaces, the cutoff for a spot. Units of power are arbitrary;
// one of 0 is never chosen.
struct LightLeaf {
  Box bounds;
  Vec3 axis;
  float cos_o, cos_e;
  float power;
  u32 light;  // set by build_light_tree: its place among the leaves
};

struct LightTree {
  std::vector<LightNode> nodes;
  std::vector<u32> slot_of_node, slot_of_light;

  LightTreeView view() const {
    return {nodes.data(), slot_of_node.data(), slot_of_light.data(),
            static_cast<u32>(slot_of_light.size())};
  }
};

// Leaf i is light i; up to 2^31 of them. The leaves are taken over and reordered. The tree does not
// depend on the number of threads.
LightTree build_light_tree(std::vector<LightLeaf> leaves);

// Bytes that the tree of so many lights keeps, about, and those that it takes beside them and the
// leaves while it is made.
struct LightTreeNeeds {
  u64 kept, passing;
};
LightTreeNeeds light_tree_needs(std::size_t lights);

}  // namespace parhelion
