// How good a tree is: what a ray is expected to visit of it.
#pragma once
#include "../core/view.h"

namespace parhelion {

// Of lines that meet the tree's box, all of them equally likely, the mean number that one passes
// through: by the surfaces of their boxes, as a line that meets a convex body meets one within it
// with the chance of the ratio of their surfaces. Rays that end where they hit something visit
// less. Source: the surface area heuristic; see sah.h.
struct TreeCost {
  double nodes = 0.0, leaves = 0.0;
};

// Of the scene's own tree, in which instances are leaves; of nothing one leaf, which nothing hits.
TreeCost tree_cost(const SceneView& scene);

}  // namespace parhelion
