// Direct light: which emissive primitive to ask, and a direction towards it.
//
// A light's weight is its area times the luminance of what it emits: its power, up to a constant.
#pragma once
#include "surface.h"

namespace parhelion::PH_ISA {

template <class Shape>
PH_INLINE float emitter_weight(const Shape& shape, Vec3 emitted_radiance) {
  return area(shape) * luminance(emitted_radiance);
}

struct LightSample {
  Vec3 direction;
  float distance;
  float pdf;  // per steradian, the choice of the light included; 0 if there is none
  Vec3 radiance;
  Slot slot;
};

// Density with which sample_light picks a direction that meets the given emissive primitive.
PH_INLINE float light_pdf(const SceneView& scene, Slot slot, Vec3 radiance, Vec3 from) {
  return with_primitive(scene, slot, [&](const auto& shape, u32) {
    return emitter_weight(shape, radiance) / scene.emitter_total * pdf_towards(shape, from);
  });
}

PH_INLINE LightSample sample_light(const SceneView& scene, Vec3 from, float u, Vec2 v) {
  u32 low = 0, high = scene.emitter_count - 1;  // the first with cumulative > u
  while (low < high) {
    const u32 middle = low + (high - low) / 2;
    if (scene.emitters[middle].cumulative > u) {
      high = middle;
    } else {
      low = middle + 1;
    }
  }
  const Emitter& e = scene.emitters[low];
  return with_primitive(scene, e.slot, [&](const auto& shape, u32 id) {
    const ParamBlock& material = material_of(scene, id);
    const Vec3 radiance = with_material(material, color_of(scene, id, material),
                                        [](const auto& m) { return emitted(m); });
    const TowardsSample s = sample_towards(shape, from, v);
    const float choice = emitter_weight(shape, radiance) / scene.emitter_total;
    return LightSample{s.direction, s.distance, s.pdf * choice, radiance, e.slot};
  });
}

}  // namespace parhelion::PH_ISA
