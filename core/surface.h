// What the path needs to know of the place it has hit, whatever the shape.
#pragma once
#include "material.h"
#include "traverse.h"

namespace parhelion::PH_ISA {

struct Surface {
  Vec3 point;
  Vec3 normal;  // outward, unit
  Slot slot;
  const ParamBlock* material;
  Vec3 color;  // the primitive's own colour, else the material's
};

// Calls f with the primitive in a slot and its id.
template <class F>
PH_INLINE auto with_primitive(const SceneView& scene, Slot slot, F&& f) {
  switch (leaf_kind(slot.leaf)) {
#define SHAPE(name, Type)                                          \
  case ShapeKind::name: {                                          \
    const auto& block = scene.name##s[slot.leaf & kLeafIndexMask]; \
    return f(primitive(block, slot.lane), block.id[slot.lane]);    \
  }
#include "shapes.def"
#undef SHAPE
  }
  compiler::unreachable();
}

PH_INLINE const ParamBlock& material_of(const SceneView& scene, u32 id) {
  return scene.materials[scene.material_of ? scene.material_of[id] : 0];
}

PH_INLINE Vec3 color_of(const SceneView& scene, u32 id, const ParamBlock& material) {
  if (scene.color_of) {
    const Vec3 own = scene.color_of[id];
    if (own.x == own.x) return own;
  }
  return block_color(material);
}

PH_INLINE Surface surface_at(const SceneView& scene, const Ray& ray, const Hit& hit) {
  return with_primitive(scene, hit.slot, [&](const auto& shape, u32 id) {
    Surface s;
    surface(shape, ray, hit.t, s.point, s.normal);
    s.slot = hit.slot;
    s.material = &material_of(scene, id);
    s.color = color_of(scene, id, *s.material);
    return s;
  });
}

}  // namespace parhelion::PH_ISA
