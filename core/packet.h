// The nearest hits of sixteen rays that lie close together, such as those of a pixel. Each node is
// tested once for all of them, by bounds of what any of them meets; a leaf's box once for the
// sixteen; and its primitives by each that meets that box. What is found is what each ray finds by
// itself.
#pragma once
#include "ray_batch.h"

namespace parhelion::PH_ISA {

// Bounds of rays' origins and of the inverses of their directions, whose signs are the same.
struct RayBounds {
  Vec3 low, high, inverse_low, inverse_high;
  u32 sign[3];
};

// False where there are none, as directions differ in sign or have a 0.
PH_INLINE bool bounds_of(const Rows<Vec3, kBatch>& origin, const Rows<Vec3, kBatch>& direction,
                         u32 lanes, RayBounds& b) {
  const u32 first = lowest_bit(lanes);
  b.low = b.high = origin.at(first);
  Vec3 least = direction.at(first), most = least;
  for_each_bit(lanes, [&](u32 k) {
    const Vec3 o = origin.at(k), d = direction.at(k);
    b.low = min(o, b.low), b.high = max(o, b.high);  // in this order NaN is passed over
    least = min(d, least), most = max(d, most);
  });
  // Rounding keeps the order of numbers, so that bounds of the inverses are inverses of bounds.
  b.inverse_low = {1.0f / most.x, 1.0f / most.y, 1.0f / most.z};
  b.inverse_high = {1.0f / least.x, 1.0f / least.y, 1.0f / least.z};
  b.sign[0] = b.inverse_low.x < 0.0f, b.sign[1] = b.inverse_low.y < 0.0f;
  b.sign[2] = b.inverse_low.z < 0.0f;
  return least.x * most.x > 0.0f && least.y * most.y > 0.0f && least.z * most.z > 0.0f &&
         finite(b.inverse_low) && finite(b.inverse_high);
}

// Bit i: some ray may meet child i's box before `limit`, at near[i] at the earliest.
PH_INLINE u32 test_boxes_for_any(const Node& node, const RayBounds& rays, float limit,
                                 float* near) {
  Lanes first = all(0.0f), last = all(limit);
  const auto slab = [&](u32 axis, float low, float high, float inverse_low, float inverse_high) {
    const Lanes entry = load(rays.sign[axis] ? node.high[axis] : node.low[axis]);
    const Lanes exit = load(rays.sign[axis] ? node.low[axis] : node.high[axis]);
    // Of all products the least and the most
    const Lanes in = entry - all(rays.sign[axis] ? low : high);
    const Lanes out = exit - all(rays.sign[axis] ? high : low);
    first = max(min(in * all(inverse_low), in * all(inverse_high)), first);
    last = min(max(out * all(inverse_low), out * all(inverse_high)), last);
  };
  slab(0, rays.low.x, rays.high.x, rays.inverse_low.x, rays.inverse_high.x);
  slab(1, rays.low.y, rays.high.y, rays.inverse_low.y, rays.inverse_high.y);
  slab(2, rays.low.z, rays.high.z, rays.inverse_low.z, rays.inverse_high.z);
  store(near, first);
  return bits(first <= last * all(kSlabSlack));
}

struct Packet {
  Rows<Vec3, kBatch> origin;
  SlabRows slabs;
  Ray ray[kBatch];
  float limit[kBatch];  // 0 in lanes that take no part
  NearestHit best[kBatch];
};

// Bit k: ray k meets the box of a node's child before its own limit.
PH_INLINE u32 test_box_for_each(const Node& node, u32 child, const Packet& rays,
                                const RayBounds& bounds) {
  Lanes first = all(0.0f), last = load(rays.limit);
  for (u32 axis = 0; axis < 3; ++axis) {
    const float low = node.low[axis][child], high = node.high[axis][child];
    const Lanes o = load(rays.origin.row[axis]), inverse = load(rays.slabs.inverse.row[axis]);
    first = max((all(bounds.sign[axis] ? high : low) - o) * inverse, first);
    last = min((all(bounds.sign[axis] ? low : high) - o) * inverse, last);
  }
  return bits(first <= last * all(kSlabSlack));
}

// From an inner node on.
inline void walk_together(const SceneView& scene, Child root, u32 lanes, const RayBounds& bounds,
                          Packet& rays) {
  // An entry is a node's index times sixteen and the child's lane there, since the child's box is
  // looked at once more, and in the upper half the bits of its distance.
  u64 stack[kStackSize];
  u64* top = stack;
  Child inner = root;
  float limit = kInfinity;
  for (;;) {
    alignas(64) float near[16];
    u64* const start = top;
    for_each_bit(test_boxes_for_any(scene.nodes[inner], bounds, limit, near), [&](u32 lane) {
      // Insertion sort on top of the stack, farthest first.
      const u64 e = static_cast<u64>(__builtin_bit_cast(u32, near[lane])) << 32 | inner << 4 | lane;
      u64* place = top++;
      for (; place != start && place[-1] < e; --place) *place = place[-1];
      *place = e;
    });
    for (;;) {
      if (top == stack) return;
      const u64 e = *--top;
      if (!(__builtin_bit_cast(float, static_cast<u32>(e >> 32)) <= limit * kSlabSlack)) continue;
      const Node& node = scene.nodes[static_cast<u32>(e) >> 4];
      const u32 lane = static_cast<u32>(e) & 15u;
      const Child child = node.child[lane];
      if ((child & kLeafBit) == 0) {
        inner = child;
        break;
      }
      for_each_bit(test_box_for_each(node, lane, rays, bounds) & lanes, [&](u32 k) {
        test_leaf<false, false>(scene, child, rays.ray[k], rays.best[k]);
        rays.limit[k] = rays.best[k].hit.t;
      });
      limit = 0.0f;
      for (u32 k = 0; k < kBatch; ++k) limit = max(limit, rays.limit[k]);
    }
  }
}

// Hits of the rays of some lanes; of those that meet nothing the slot's leaf is kNone.
inline void intersect_close(const SceneView& scene, const Rows<Vec3, kBatch>& origin,
                            const Rows<Vec3, kBatch>& direction, u32 lanes, Hit (&hit)[kBatch]) {
  RayBounds bounds;
  const bool bounded =
      lanes != 0 && (scene.root & kLeafBit) == 0 && bounds_of(origin, direction, lanes, bounds);
  if (!bounded) {
    const auto ray_at = [&](u32 k) -> Ray {
      return {origin.at(k), direction.at(k), kNoSlot, false};
    };
    intersect_each(scene, direction, lanes, ray_at, true, hit);
    return;
  }
  Packet rays;
  rays.origin = origin;
  find_slabs(direction, rays.slabs);
  for (float& limit : rays.limit) limit = 0.0f;
  for_each_bit(lanes, [&](u32 k) {
    rays.ray[k] = {origin.at(k), direction.at(k), kNoSlot, false};
    rays.limit[k] = kInfinity;
    rays.best[k] = {{kInfinity, kNoSlot}, kNone, kNoSlot};
  });
  walk_together(scene, scene.root, lanes, bounds, rays);
  for_each_bit(lanes, [&](u32 k) { hit[k] = rays.best[k].hit; });
}

}  // namespace parhelion::PH_ISA
