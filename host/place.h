// Where a primitive is, as users know it.
#pragma once
#include "../core/view.h"

namespace parhelion {

// A primitive by the user's shape, its number in it, and, in a copy, the shape of instances and
// the number of the copy; kNone where there is none.
struct PrimitivePlace {
  u32 shape = kNone, primitive = kNone, instances = kNone, copy = kNone;
};

// shape: that of the primitive `id`.
inline PrimitivePlace place_of(const SceneView& scene, const ShapeRecord& shape, u32 id,
                               Slot slot) {
  PrimitivePlace p{static_cast<u32>(&shape - scene.shapes), id - shape.first_id};
  if (slot.instance != kNone) {
    const Instance& instance = scene.instances[slot.instance];
    p.instances = instance.shape;
    p.copy = instance.id - scene.shapes[instance.shape].first_id;
  }
  return p;
}

}  // namespace parhelion
