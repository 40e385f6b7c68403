// What rays see that leave the scene.
#pragma once
#include "wave.h"

namespace parhelion::PH_ISA {

// Adds what rays see of a light from outside that is not asked for.
template <class Light>
PH_APART inline void add_smooth(const Light& __restrict light, const LightRecord& __restrict record,
                                const LightTables& tables, const u32 (&__restrict these)[kBatch],
                                float most_indirect, Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 sum = p.sum.at(k);
    const Vec3 shine = radiance(light, record, tables, p.direction.at(k));
    const Vec3 seen = bounded(p.throughput.at(k) * shine, p.depth[k] - 1, most_indirect);
    p.sum.set(k, select(these[k] != 0, sum + seen, sum));
  }
}

// Adds what rays see of a light from outside that may be asked for, with `share` of the light
// samples.
PH_APART inline void add_sights(const Rows<LightSight, kBatch>& __restrict sights, float share,
                                const u32 (&__restrict these)[kBatch], float most_indirect,
                                Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 sum = p.sum.at(k);
    const LightSight sight = sights.at(k);
    const float own = p.scatter_pdf[k], both = power_heuristic(own, share * sight.pdf);
    const float weight = own > 0.0f ? both : 1.0f;
    const Vec3 light = p.throughput.at(k) * sight.radiance * weight;
    const Vec3 seen = bounded(light, p.depth[k] - 1, most_indirect);
    p.sum.set(k, select(these[k] != 0, sum + seen, sum));
  }
}

// Adds what the rays see that meet nothing.
inline void add_backgrounds(const SceneView& scene, const RenderView& view, u32 lanes, Paths& p) {
  if (view.backdrop.x == view.backdrop.x) {
    for_each_bit(lanes, [&](u32 k) {
      if (p.depth[k] > 1) return;
      p.sum.set(k, p.sum.at(k) + p.throughput.at(k) * view.backdrop);
      lanes &= ~(1u << k);
    });
  }
  if (view.integrator == Integrator::ambient_occlusion) {
    for_each_bit(lanes, [&](u32 k) { p.sum.set(k, Vec3{1, 1, 1}); });
    return;
  }
  u32 these[kBatch], scattered[kBatch];
  spread(lanes, these);
  for (u32 k = 0; k < kBatch; ++k) scattered[k] = p.scatter_pdf[k] > 0.0f ? 1 : 0;
  const u32 weighed = having(1, scattered, lanes);
  for (u32 i = scene.outside_first; lanes != 0 && i < scene.light_count; ++i) {
    const LightRecord& record = scene.lights[i];
    with_light(record.block, [&]<class Light>(const Light& light) {
      if constexpr (requires { Light::branchless; }) {
        static_assert(Light::smooth);  // so there is no density to weigh it by
        add_smooth(light, record, scene.tables, these, view.clamp_indirect, p);
        return;
      }
      if constexpr (requires(Rows<LightSight, kBatch>& sights) {
                      seen(light, record, scene.tables, lanes, lanes, p.direction, sights);
                    }) {
        static_assert(!requires { Light::smooth; });  // else some give no light samples
        Rows<LightSight, kBatch> sights;
        if (seen(light, record, scene.tables, lanes, weighed, p.direction, sights)) {
          add_sights(sights, scene.outside_share * record.share, these, view.clamp_indirect, p);
          return;
        }
      }
      for_each_bit(lanes, [&](u32 k) { add_outside(scene, view, i, p, k); });
    });
  }
}

}  // namespace parhelion::PH_ISA
