// The nearest hits of sixteen rays that lie close together, such as those of a pixel, or whether
// they meet anything. Each node is tested once for all of them, by bounds of what any of them
// meets, down to what is narrow beside all of them: each ray goes there by itself. Of a leaf of
// spheres or triangles those that any may meet are found at once, and each is tested against all
// rays; the box of another is tested once for the sixteen, and its primitives by each that meets
// that box. What is found is what each ray finds by itself.
#pragma once
#include "ray_batch.h"

namespace parhelion::PH_ISA {

// The least and the most of some lanes, of which there is at least one.
PH_INLINE void bounds_of(const Rows<Vec3, kBatch>& rows, u32 lanes, Vec3& low, Vec3& high) {
  const Vec3 first = rows.at(lowest_bit(lanes));
  float own[3][kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const bool one = (lanes >> k & 1u) != 0;
    own[0][k] = one ? rows.row[0][k] : first.x;
    own[1][k] = one ? rows.row[1][k] : first.y;
    own[2][k] = one ? rows.row[2][k] : first.z;
  }
  extremes(own, low, high);
}

// The axis along which all rays of some lanes run fastest, or -1 if it differs.
PH_INLINE int common_axis(const Rows<Vec3, kBatch>& direction, u32 lanes) {
  u32 axis[kBatch];
  for (u32 k = 0; k < kBatch; ++k) axis[k] = static_cast<u32>(fastest_axis(direction.at(k)));
  const u32 first = axis[lowest_bit(lanes)];
  return (lanes & ~equal(first, axis)) == 0 ? static_cast<int>(first) : -1;
}

// Whether each component of some lanes' directions is below 0 in all of them or in none. Of a
// bundle it is; what goes its own ways is told apart by it for least.
PH_INLINE bool same_signs(const Rows<Vec3, kBatch>& direction, u32 lanes) {
  for (u32 axis = 0; axis < 3; ++axis) {
    const u32 below = bits(load(direction.row[axis]) < all(0.0f)) & lanes;
    if (below != 0 && below != lanes) return false;
  }
  return true;
}

// What does not move along an axis counts as if it moved along it by 1 in so many of its length:
// directions are about a unit long.
inline constexpr float kSteep = 0x1p100f;

// False where there are none, as directions differ in sign, are 0 along an axis in some lanes alone
// or run fastest along other axes, or something is no number.
PH_INLINE bool bundle_of(const Rows<Vec3, kBatch>& origin, const Rows<Vec3, kBatch>& direction,
                         u32 lanes, Bundle& b) {
  u32 numbers = 0;
  for (u32 k = 0; k < kBatch; ++k)
    numbers |= (is_number(origin.at(k), direction.at(k)) ? 1u : 0u) << k;
  if ((lanes & ~numbers) != 0) return false;
  Vec3 d_low, d_high;
  bounds_of(origin, lanes, b.low, b.high);
  bounds_of(direction, lanes, d_low, d_high);
  const auto invert = [](float least, float most, float& inverse_low, float& inverse_high,
                         float& from, float& to) {
    const bool still = (least == 0.0f) & (most == 0.0f);
    // Rounding keeps the order of numbers, so that bounds of the inverses are inverses of bounds.
    inverse_low = still ? kSteep : 1.0f / most;
    inverse_high = still ? kSteep : 1.0f / least;
    // At a box's plane, where the product would be 0, it is within the box.
    from -= still ? kBoxPad : 0.0f, to += still ? kBoxPad : 0.0f;
    return still || least * most > 0.0f;
  };
  const bool x = invert(d_low.x, d_high.x, b.inverse_low.x, b.inverse_high.x, b.low.x, b.high.x);
  const bool y = invert(d_low.y, d_high.y, b.inverse_low.y, b.inverse_high.y, b.low.y, b.high.y);
  const bool z = invert(d_low.z, d_high.z, b.inverse_low.z, b.inverse_high.z, b.low.z, b.high.z);
  b.sign[0] = b.inverse_low.x < 0.0f, b.sign[1] = b.inverse_low.y < 0.0f;
  b.sign[2] = b.inverse_low.z < 0.0f;
  const Vec3 pad = {kBoxPad, kBoxPad, kBoxPad};  // for the rounding of the middle
  b.origin = (b.low + b.high) * 0.5f, b.direction = (d_low + d_high) * 0.5f;
  b.origin_off = (b.high - b.low) * 0.5f + pad, b.direction_off = (d_high - d_low) * 0.5f + pad;
  b.radius = length(b.origin_off), b.spread = length(b.direction_off);
  b.along = common_axis(direction, lanes);
  return b.along >= 0 && x && y && z && finite(b.inverse_low) && finite(b.inverse_high);
}

// Bit i: some ray may meet child i's box before `limit`, at near[i] at the earliest.
PH_INLINE u32 test_boxes(const Node& node, const Bundle& rays, float limit, Lanes& near) {
  const LaneVec3 low = load(node.low), high = load(node.high);
  Lanes first = all(0.0f), last = all(limit);
  const auto slab = [&](const Lanes& a, const Lanes& b, int axis) {
    const bool backwards = rays.sign[axis] != 0;
    const float from = component(rays.low, axis), to = component(rays.high, axis);
    const Lanes least = all(component(rays.inverse_low, axis));
    const Lanes most = all(component(rays.inverse_high, axis));
    // Of all products the least and the most
    const Lanes in = (backwards ? b : a) - all(backwards ? from : to);
    const Lanes out = (backwards ? a : b) - all(backwards ? to : from);
    first = max(min(in * least, in * most), first);
    last = min(max(out * least, out * most), last);
  };
  slab(low.x, high.x, 0), slab(low.y, high.y, 1), slab(low.z, high.z, 2);
  near = first;
  return bits(first <= last * all(kSlabSlack));
}

// The nearest hits so far, as NearestHit. t is 0 in lanes that take no part.
struct NearestHits {
  alignas(64) float t[kBatch];
  u32 id[kBatch];
  SlotRows<kBatch> slot;

  PH_INLINE NearestHit at(u32 k) const { return {{t[k], slot.at(k)}, id[k], kNoSlot}; }
  PH_INLINE void set(u32 k, const NearestHit& best) {
    t[k] = best.hit.t, id[k] = best.id;
    slot.set(k, best.hit.slot);
  }
};

// lanes: those that take part; met: of these, where any hit will do, those that have one. What
// takes no part, or none any more, has 0 as its best's t. self and inward: as in Ray.
struct Packet {
  Rows<Vec3, kBatch> origin, direction;
  SlabRows slabs;
  NearestHits best;
  SlotRows<kBatch> self;
  u32 lanes, met, inward;

  PH_INLINE Ray ray(u32 k) const {
    return {origin.at(k), direction.at(k), self.at(k), (inward >> k & 1u) != 0};
  }
};

// Bit k: ray k meets the box of a node's child before its own limit.
PH_INLINE u32 test_box_for_each(const Node& node, u32 child, const Packet& rays,
                                const Bundle& bundle) {
  Lanes first = all(0.0f), last = load(rays.best.t);
  for (u32 axis = 0; axis < 3; ++axis) {
    const float low = node.low[axis][child], high = node.high[axis][child];
    const Lanes o = load(rays.origin.row[axis]), inverse = load(rays.slabs.inverse.row[axis]);
    first = max((all(bundle.sign[axis] ? high : low) - o) * inverse, first);
    last = min((all(bundle.sign[axis] ? low : high) - o) * inverse, last);
  }
  return bits(first <= last * all(kSlabSlack));
}

// What ray k finds by itself: test(k, ray, best) does as test_block.
template <bool kAny, class Test>
PH_INLINE void ask_alone(Packet& rays, u32 k, Test&& test) {
  NearestHit best = rays.best.at(k);
  const bool any = test(k, rays.ray(k), best);
  if constexpr (!kAny) {
    rays.best.set(k, best);
  } else if (any) {
    rays.best.t[k] = 0.0f;
    rays.met |= 1u << k;
  }
}

// One primitive against all rays; one that starts on it has 0 as its best's t. along: as in Bundle.
template <bool kAny, class Shape>
PH_APART inline void test_primitive(const Shape& shape, Child leaf, u32 lane, u32 id, int along,
                                    const Rows<Vec3, kBatch>& __restrict origin,
                                    const Rows<Vec3, kBatch>& __restrict direction,
                                    NearestHits& __restrict best) {
  alignas(64) float distance[kBatch];
  if (!intersect_rays(shape, origin, direction, along, best.t, distance)) return;
  for (u32 k = 0; k < kBatch; ++k) {
    const float t = distance[k];
    if constexpr (kAny) {
      const bool hit = (0.0f < t) & (t <= best.t[k]);
      best.t[k] = hit ? 0.0f : best.t[k];
    } else {
      const bool first = (best.slot.instance[k] != kNone) | (id < best.id[k]);
      const bool nearer = (0.0f < t) & ((t < best.t[k]) | ((t == best.t[k]) & first));
      best.t[k] = nearer ? t : best.t[k];
      best.id[k] = nearer ? id : best.id[k];
      best.slot.leaf[k] = nearer ? leaf : best.slot.leaf[k];
      best.slot.lane[k] = nearer ? lane : best.slot.lane[k];
      best.slot.instance[k] = nearer ? kNone : best.slot.instance[k];
    }
  }
}

// Of a block's primitives those that any ray may meet, each against all rays. What starts on one of
// them tests the block by itself.
template <bool kAny, class Block>
PH_APART inline void test_block_together(const Block& block, Child leaf, const Bundle& bundle,
                                         float limit, Packet& rays) {
  const u32 start = equal(leaf, rays.self.leaf) & rays.lanes & ~rays.met;
  float own[kBatch];
  for_each_bit(start, [&](u32 k) {
    ask_alone<kAny>(rays, k, [&](u32, const Ray& ray, NearestHit& best) {
      return test_block<kAny>(block, leaf, ray, best);
    });
    own[k] = rays.best.t[k];
    rays.best.t[k] = 0.0f;
  });
  const bool others = (rays.lanes & ~rays.met & ~start) != 0;
  for_each_bit(others ? intersect_bundle(block, bundle, limit) : 0, [&](u32 i) {
    test_primitive<kAny>(primitive(block, i), leaf, i, block.id[i], bundle.along, rays.origin,
                         rays.direction, rays.best);
  });
  for_each_bit(start, [&](u32 k) { rays.best.t[k] = own[k]; });
  if constexpr (kAny) rays.met = rays.lanes & ~bits(all(0.0f) < load(rays.best.t));
}

// What lies below a node's child, by each ray that meets its box: test(k, ray, best) for ray k.
template <bool kAny, class Test>
PH_INLINE void test_alone(const Node& node, u32 lane, const Bundle& bundle, Packet& rays,
                          Test&& test) {
  for_each_bit(test_box_for_each(node, lane, rays, bundle) & rays.lanes & ~rays.met,
               [&](u32 k) { ask_alone<kAny>(rays, k, test); });
}
template <bool kAny>
PH_APART inline void walk_alone(const SceneView& scene, const Node& node, u32 lane,
                                const Bundle& bundle, Packet& rays) {
  test_alone<kAny>(node, lane, bundle, rays, [&](u32 k, const Ray& ray, NearestHit& best) {
    typename Stack<kAny>::Room room;
    Stack<kAny> stack(room);
    const Slabs slabs = rays.slabs.at(k, ray.origin);
    return walk_on<kAny, false>(scene, node.child[lane], stack, slabs, ray, best);
  });
}

// What is not as wide as so many half widths of a bundle is narrow: a leaf, and a node, whose
// children are narrower.
inline constexpr float kNarrowLeaf = 4.0f, kNarrowNode = 8.0f;

// Whether a node's child is so narrow beside the bundle, where its box begins, that rays which meet
// it have little in common below it: then a bundle would test for all of them what few meet, as
// where a pixel shows many particles.
PH_INLINE bool is_narrow(const Node& node, u32 lane, const Bundle& bundle, float near) {
  const float x = node.high[0][lane] - node.low[0][lane];
  const float y = node.high[1][lane] - node.low[1][lane];
  const float z = node.high[2][lane] - node.low[2][lane];
  const float narrow = (node.child[lane] & kLeafBit) != 0 ? kNarrowLeaf : kNarrowNode;
  return max(x, max(y, z)) < narrow * (bundle.radius + near * bundle.spread);
}

// A leaf, which is a node's child, and all rays: where a shape can tell which of its primitives any
// of them may meet before `limit`, those one by one; else ray by ray.
template <bool kAny>
PH_INLINE void test_leaf_together(const SceneView& scene, const Node& node, u32 lane,
                                  const Bundle& bundle, float limit, Packet& rays) {
  const Child leaf = node.child[lane];
  const auto each = [&](auto&& test) { test_alone<kAny>(node, lane, bundle, rays, test); };
  const auto block = [&](const auto& own) {
    if constexpr (requires { intersect_bundle(own, bundle, limit); }) {
      test_block_together<kAny>(own, leaf, bundle, limit, rays);
    } else {
      each([&](u32, const Ray& ray, NearestHit& best) {
        return test_block<kAny>(own, leaf, ray, best);
      });
    }
  };
  const u32 index = leaf & kLeafIndexMask;
  switch (leaf_kind(leaf)) {
#define SHAPE(name, Type) \
  case ShapeKind::name: return block(scene.name##s[index]);
#include "shapes.def"
#undef SHAPE
    case ShapeKind::instance:
      return each([&](u32, const Ray& ray, NearestHit& best) {
        return test_instance<kAny>(scene, index, ray, true, best);
      });
  }
  compiler::unreachable();
}

// From an inner node on.
template <bool kAny>
inline void walk_together(const SceneView& scene, Child root, const Bundle& bundle, Packet& rays) {
  // An entry is a node's index times sixteen and the child's lane there, since the child's box is
  // looked at once more, and in the upper half the bits of its distance.
  u64 stack[kStackSize];
  u64* top = stack;
  Child inner = root;
  float limit = most(rays.best.t);
  for (;;) {
    alignas(64) float near[16];
    u64* const start = top;
    Lanes first;
    const u32 hits = test_boxes(scene.nodes[inner], bundle, limit, first);
    store(near, first);
    for_each_bit(hits, [&](u32 lane) {
      const u64 e = static_cast<u64>(__builtin_bit_cast(u32, near[lane])) << 32 | inner << 4 | lane;
      u64* place = top++;
      // Insertion sort, farthest first. Where any hit will do the nearest is as good as another.
      if constexpr (!kAny) {
        for (; place != start && place[-1] < e; --place) *place = place[-1];
      }
      *place = e;
    });
    for (;;) {
      if (top == stack || (kAny && rays.lanes == rays.met)) return;
      const u64 e = *--top;
      const float entered = __builtin_bit_cast(float, static_cast<u32>(e >> 32));
      if (!(entered <= limit * kSlabSlack)) continue;
      const Node& node = scene.nodes[static_cast<u32>(e) >> 4];
      const u32 lane = static_cast<u32>(e) & 15u;
      if (is_narrow(node, lane, bundle, entered)) {
        walk_alone<kAny>(scene, node, lane, bundle, rays);
        limit = most(rays.best.t);
        continue;
      }
      const Child child = node.child[lane];
      if ((child & kLeafBit) == 0) {
        inner = child;
        break;
      }
      test_leaf_together<kAny>(scene, node, lane, bundle, limit, rays);
      limit = most(rays.best.t);
    }
  }
}

// The nearest hits of a packet's rays before their limits, in `best`, whose slots' leaf is kNone
// where nothing is met; or, in `met`, which rays meet anything. Origins, directions and what rays
// start on are given. False, and nothing is told, where they are no bundle, none has a limit above
// 0, or the root is no node.
template <bool kAny>
inline bool walk_close(const SceneView& scene, u32 lanes, const float (&limit)[kBatch],
                       Packet& rays) {
  rays.lanes = lanes & bits(all(0.0f) < load(limit));
  Bundle bundle;
  if (rays.lanes == 0 || (scene.root & kLeafBit) != 0) return false;
  if (!bundle_of(rays.origin, rays.direction, rays.lanes, bundle)) return false;
  // Where they do not move along an axis the bundle's sign there is that of 0, not of -0.
  for (auto& row : rays.direction.row) {
    for (float& d : row) d += 0.0f;
  }
  find_slabs(rays.direction, rays.slabs);
  rays.met = 0;
  for (u32 k = 0; k < kBatch; ++k) {
    rays.best.t[k] = (rays.lanes >> k & 1u) != 0 ? limit[k] : 0.0f;
    rays.best.id[k] = kNone;
    rays.best.slot.set(k, kNoSlot);
  }
  walk_together<kAny>(scene, scene.root, bundle, rays);
  return true;
}

// The nearest hits of rays of some lanes, which start on nothing, bundle or not; of those that meet
// nothing the slot's leaf is kNone.
inline void intersect_close(const SceneView& scene, const Rows<Vec3, kBatch>& origin,
                            const Rows<Vec3, kBatch>& direction, u32 lanes, float (&t)[kBatch],
                            SlotRows<kBatch>& slot) {
  Packet rays;
  rays.origin = origin, rays.direction = direction;
  rays.inward = 0;
  float limit[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    rays.self.set(k, kNoSlot);
    limit[k] = kInfinity;
  }
  if (!walk_close<false>(scene, lanes, limit, rays)) {
    const auto ray_at = [&](u32 k) { return rays.ray(k); };
    return intersect_each(scene, direction, lanes, ray_at, limit, true, t, slot);
  }
  compiler::copy(t, rays.best.t, sizeof(t));
  slot = rays.best.slot;
}

}  // namespace parhelion::PH_ISA
