// Sixteen rays, each of which goes its own way. What all of them begin with, the inverses of their
// directions, the boxes of the root's children and (stack.h) the order of those that are met, is
// worked out for all before any walks on, so that a processor has several under way; after that
// each walks alone.
#pragma once
#include "rows.h"
#include "traverse.h"

namespace parhelion::PH_ISA {

// By lane, as in Slabs.
struct SlabRows {
  Rows<Vec3, kBatch> inverse, inverse_far;
  u32 entry[3][kBatch];

  PH_INLINE Slabs at(u32 k, Vec3 origin) const {
    return {origin, inverse.at(k), inverse_far.at(k), {entry[0][k], entry[1][k], entry[2][k]}};
  }
};

PH_APART inline void find_slabs(const Rows<Vec3, kBatch>& __restrict direction,
                                SlabRows& __restrict slabs) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Slabs own = slabs_of({0, 0, 0}, direction.at(k));
    slabs.inverse.set(k, own.inverse);
    slabs.inverse_far.set(k, own.inverse_far);
    for (u32 axis = 0; axis < 3; ++axis) slabs.entry[axis][k] = own.entry[axis];
  }
}

// For rays of some lanes what intersect and occluded do for one: of lane k, ray_at(k) is the ray
// and best[k] what counts as found before. Returns, with kAny, the lanes of those that hit
// something.
template <bool kAny, class RayAt>
PH_INLINE u32 walk_each(const SceneView& scene, const Rows<Vec3, kBatch>& direction, u32 lanes,
                        RayAt&& ray_at, bool tree, NearestHit (&best)[kBatch]) {
  u32 any = 0;
  if (!tree || (scene.root & kLeafBit) != 0) {
    for_each_bit(
        lanes, [&](u32 k) { any |= (walk<kAny>(scene, ray_at(k), tree, best[k]) ? 1u : 0u) << k; });
    return any;
  }
  if (lanes == 0) return 0;
  SlabRows slabs;
  find_slabs(direction, slabs);
  const Node& root = scene.nodes[scene.root];
  typename Stack<kAny>::Start start[kBatch];
  for_each_bit(lanes, [&](u32 k) {
    Lanes near;
    const Ray ray = ray_at(k);
    const Slabs own = slabs.at(k, ray.origin);
    // A ray that is none meets nothing.
    const bool good = is_number(ray.origin, ray.direction);
    const float limit = good ? best[k].hit.t * kSlabSlack : -1.0f;
    const LaneMask hits = test_boxes(root, own, limit, near);
    Stack<kAny>::prepare(root, near, hits, start[k]);
  });
  for_each_bit(lanes, [&](u32 k) {
    const Ray ray = ray_at(k);
    const bool hit = walk_from<kAny>(scene, start[k], slabs.at(k, ray.origin), ray, best[k]);
    any |= (hit ? 1u : 0u) << k;
  });
  return any;
}

// The lanes, of those given, whose rays meet anything but ignored(k) before their limits.
template <class RayAt, class Ignored>
PH_INLINE u32 occluded_each(const SceneView& scene, const Rows<Vec3, kBatch>& direction, u32 lanes,
                            RayAt&& ray_at, const float (&limit)[kBatch], Ignored&& ignored,
                            bool tree) {
  NearestHit best[kBatch];
  for_each_bit(lanes, [&](u32 k) { best[k] = {{limit[k], kNoSlot}, kNone, ignored(k)}; });
  return walk_each<true>(scene, direction, lanes, ray_at, tree, best);
}

// The nearest hits of rays of some lanes; of those that meet nothing the slot's leaf is kNone.
template <class RayAt>
PH_INLINE void intersect_each(const SceneView& scene, const Rows<Vec3, kBatch>& direction,
                              u32 lanes, RayAt&& ray_at, const float (&limit)[kBatch], bool tree,
                              float (&t)[kBatch], SlotRows<kBatch>& slot) {
  NearestHit best[kBatch];
  for_each_bit(lanes, [&](u32 k) { best[k] = {{limit[k], kNoSlot}, kNone, kNoSlot}; });
  walk_each<false>(scene, direction, lanes, ray_at, tree, best);
  for_each_bit(lanes, [&](u32 k) {
    t[k] = best[k].hit.t;
    slot.set(k, best[k].hit.slot);
  });
}
// However far away.
template <class RayAt>
PH_INLINE void intersect_each(const SceneView& scene, const Rows<Vec3, kBatch>& direction,
                              u32 lanes, RayAt&& ray_at, bool tree, float (&t)[kBatch],
                              SlotRows<kBatch>& slot) {
  float limit[kBatch];
  for (float& most : limit) most = kInfinity;
  intersect_each(scene, direction, lanes, ray_at, limit, tree, t, slot);
}

}  // namespace parhelion::PH_ISA
