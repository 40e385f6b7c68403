// The nearest hit of a ray, and whether anything is hit at all: one ray against sixteen boxes or
// sixteen primitives at a time.
#pragma once
#include "stack.h"

namespace parhelion::PH_ISA {

// Slack of the box test, which covers its own rounding and that of the primitives' distances. A box
// must never reject a primitive that would report a hit.
inline constexpr float kSlabSlack = 1.0f + 0x1p-20f;

struct NearestHit {
  Hit hit;
  u32 id;       // of two hits at one distance the lower id counts, whatever the order of the tests
  Slot ignore;  // kAny: the light that the ray is on its way to
};

PH_INLINE Vec3 transform_point(const float (&m)[12], Vec3 p) {
  return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3], m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
          m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
}
PH_INLINE Vec3 transform_vector(const float (&m)[12], Vec3 v) {
  return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[4] * v.x + m[5] * v.y + m[6] * v.z,
          m[8] * v.x + m[9] * v.y + m[10] * v.z};
}
// By the transposed matrix: normals, from the frame that m leads to into the one it comes from.
PH_INLINE Vec3 transform_normal(const float (&m)[12], Vec3 n) {
  return {m[0] * n.x + m[4] * n.y + m[8] * n.z, m[1] * n.x + m[5] * n.y + m[9] * n.z,
          m[2] * n.x + m[6] * n.y + m[10] * n.z};
}

// A ray as an instance's group sees it: a distance t of the ray is stretch * t - skipped here.
struct GroupRay {
  Ray ray;
  float stretch, skipped;
};

PH_INLINE GroupRay into_group(const Instance& instance, u32 index, const Ray& ray) {
  const Vec3 d = transform_vector(instance.to_group, ray.direction);
  const float stretch = length(d);
  const Slot self =
      ray.self.instance == index ? Slot{ray.self.leaf, ray.self.lane, kNone} : kNoSlot;
  const Vec3 direction = d * (1.0f / stretch);
  // From far away the ray starts anew before the group, which lies within 1 of 0 along each axis:
  // the rounding of all tests is bounded by the size of what they are about.
  const Vec3 origin = transform_point(instance.to_group, ray.origin);
  const float skipped = max(-dot(origin, direction) - 2.0f, 0.0f);
  return {{origin + direction * skipped, direction, self, ray.inward}, stretch, skipped};
}

// Apart, since x86 has sixteen registers for vectors, and within a walk a block's test gets few of
// them. AVX-512 has thirty-two, as Arm has: where it should be apart there, too, is not measured.
#if defined(__AVX512F__)
#define PH_TEST_BLOCK PH_INLINE
#else
#define PH_TEST_BLOCK PH_APART inline
#endif

// A block's hits that are nearer than the best so far. With kAny, whether there is any. Whoever is
// told of a hit says how far others of the block may be: shapes that are tested one by one look.
template <bool kAny, class Block>
PH_TEST_BLOCK bool test_block(const Block& block, Child leaf, const Ray& ray, NearestHit& best) {
  const u32 self_lane = ray.self.leaf == leaf ? ray.self.lane : kNone;
  const u32 ignored = kAny && best.ignore.leaf == leaf ? 1u << best.ignore.lane : 0;
  if constexpr (kAny && requires { intersect_any(block, ray, best.hit.t, ignored); }) {
    const u32 self = self_lane != kNone ? 1u << self_lane : 0;
    return intersect_any(block, ray, best.hit.t, ignored | self);
  }
  if constexpr (kAny) {
    bool any = false;
    intersect(block, ray, best.hit.t, self_lane, [&](u32 lane, float) {
      any |= (ignored >> lane & 1u) == 0;
      return any ? 0.0f : best.hit.t;
    });
    return any;
  } else {
    intersect(block, ray, best.hit.t, self_lane, [&](u32 lane, float t) {
      const u32 id = block.id[lane];
      // Of one seen through an instance at the same distance, this one counts.
      if (t < best.hit.t ||
          (t == best.hit.t && (best.hit.slot.instance != kNone || id < best.id))) {
        best = {{t, {leaf, lane, kNone}}, id, kNoSlot};
      }
      return best.hit.t;
    });
    return false;
  }
}

template <bool kAny, bool kInside>
inline bool walk_tree(const SceneView& scene, Child root, const Ray& ray, NearestHit& best);
template <bool kAny>
inline bool walk_all(const SceneView& scene, const Group& group, const Ray& ray, NearestHit& best);

// What lies in an instance, by its tree, or, without `tree`, one after the other.
template <bool kAny>
inline bool test_instance(const SceneView& scene, u32 index, const Ray& ray, bool tree,
                          NearestHit& best) {
  const Instance& instance = scene.instances[index];
  const GroupRay local = into_group(instance, index, ray);
  // What lies at just the distance of the best must be found: which of them counts is said below.
  float limit = best.hit.t * local.stretch;
  if constexpr (!kAny) limit *= kSlabSlack;
  limit -= local.skipped;
  if (!(limit > 0.0f)) return false;
  NearestHit inside = {{limit, kNoSlot}, kNone, kNoSlot};
  if (kAny && best.ignore.instance == index) {
    inside.ignore = {best.ignore.leaf, best.ignore.lane, kNone};
  }
  const bool any = tree ? walk_tree<kAny, true>(scene, instance.root, local.ray, inside)
                        : walk_all<kAny>(scene, scene.groups[instance.group], local.ray, inside);
  if constexpr (kAny) return any;
  if (inside.hit.slot.leaf == kNone) return false;
  const float t = (inside.hit.t + local.skipped) / local.stretch;
  // Of two at one distance what is seen through the later instance gives way.
  const Slot known = best.hit.slot;
  const bool first = known.instance != kNone ? index < known.instance : known.leaf == kNone;
  if (t < best.hit.t || (t == best.hit.t && first)) {
    best = {{t, {inside.hit.slot.leaf, inside.hit.slot.lane, index}}, inside.id, kNoSlot};
  }
  return false;
}

template <bool kAny, bool kInside>
PH_INLINE bool test_leaf(const SceneView& scene, Child leaf, const Ray& ray, NearestHit& best) {
  switch (leaf_kind(leaf)) {
#define SHAPE(name, Type) \
  case ShapeKind::name:   \
    return test_block<kAny>(scene.name##s[leaf & kLeafIndexMask], leaf, ray, best);
#include "shapes.def"
#undef SHAPE
    case ShapeKind::instance:
      if constexpr (!kInside) {
        return test_instance<kAny>(scene, leaf & kLeafIndexMask, ray, true, best);
      }
  }
  compiler::unreachable();
}

// What the box test wants to know of a ray.
struct Slabs {
  Vec3 origin, inverse;
  Vec3 inverse_far;  // with the slack, for where boxes are left
  u32 entry[3];      // where a node's bounds begin that the ray enters by, x, y and z
};

PH_INLINE Slabs slabs_of(Vec3 origin, Vec3 d) {
  const Vec3 inverse = {1.0f / d.x, 1.0f / d.y, 1.0f / d.z};
  const auto entry = [](u32 axis, float along) { return 16 * axis + (along < 0.0f ? 48u : 0u); };
  return {origin,
          inverse,
          inverse * kSlabSlack,
          {entry(0, inverse.x), entry(1, inverse.y), entry(2, inverse.z)}};
}

// By lane, whether the ray meets that child's box before `limit`, which has the slack; near: where.
PH_INLINE LaneMask test_boxes(const Node& node, const Slabs& ray, float limit, Lanes& near) {
  static_assert(sizeof(Node) == 2 * sizeof(node.low) + sizeof(node.child));  // no gaps
  const float* const bounds = node.low[0];  // low and high are one array of six rows of sixteen
  const Vec3 o = ray.origin, in = ray.inverse, out = ray.inverse_far;
  const auto entered = [&](u32 axis) { return load(bounds + ray.entry[axis]); };
  // The other of the axis's rows: one begins at 16 axis, the other 48 later.
  const auto left = [&](u32 axis) { return load(bounds + (48 + 32 * axis - ray.entry[axis])); };
  const Lanes x0 = (entered(0) - all(o.x)) * all(in.x), x1 = (left(0) - all(o.x)) * all(out.x);
  const Lanes y0 = (entered(1) - all(o.y)) * all(in.y), y1 = (left(1) - all(o.y)) * all(out.y);
  const Lanes z0 = (entered(2) - all(o.z)) * all(in.z), z1 = (left(2) - all(o.z)) * all(out.z);
  // A ray within a box's plane makes 0 * inf = NaN, which min and max then pass over.
  // By itself only in this order: of max(max(x0, y0), ...) a NaN of y would pass over x, too.
  near = max(x0, max(y0, max(z0, all(0.0f))));
  return near <= min(x1, min(y1, min(z1, all(limit))));
}

// On from a child, and from what the stack holds.
template <bool kAny, bool kInside>
PH_INLINE bool walk_on(const SceneView& scene, Child next, Stack<kAny>& stack, const Slabs& slabs,
                       const Ray& ray, NearestHit& best) {
  for (;;) {
    bool there = false;
    if (next & kLeafBit) {
      if (test_leaf<kAny, kInside>(scene, next, ray, best)) return true;
    } else {
      const Node& node = scene.nodes[next];
      Lanes near;
      const LaneMask hits = test_boxes(node, slabs, best.hit.t * kSlabSlack, near);
      there = stack.push(node, near, hits, next);
    }
    if (!there && !stack.pop(next, best.hit.t * kSlabSlack)) return false;
  }
}

template <bool kAny, bool kInside>
inline bool walk_tree(const SceneView& scene, Child root, const Ray& ray, NearestHit& best) {
  typename Stack<kAny>::Room room;
  Stack<kAny> stack(room);
  return walk_on<kAny, kInside>(scene, root, stack, slabs_of(ray.origin, ray.direction), ray, best);
}

// From some children of a node on.
template <bool kAny>
inline bool walk_from(const SceneView& scene, const typename Stack<kAny>::Start& start,
                      const Slabs& slabs, const Ray& ray, NearestHit& best) {
  typename Stack<kAny>::Room room;
  Stack<kAny> stack(room);
  Child next;
  if (!stack.begin(start, next)) return false;
  return walk_on<kAny, false>(scene, next, stack, slabs, ray, best);
}

template <bool kAny>
inline bool walk_all(const SceneView& scene, const Group& group, const Ray& ray, NearestHit& best) {
#define SHAPE(name, Type)                                                 \
  for (u32 i = group.first_##name; i < group.last_##name; ++i) {          \
    const Child leaf = make_leaf(ShapeKind::name, i);                     \
    if (test_block<kAny>(scene.name##s[i], leaf, ray, best)) return true; \
  }
#include "shapes.def"
#undef SHAPE
  for (u32 i = group.first_instance; i < group.last_instance; ++i) {
    if (test_instance<kAny>(scene, i, ray, false, best)) return true;
  }
  return false;
}

// The scene's own group, after those that instances show.
PH_INLINE const Group& own_group(const SceneView& scene) {
  return scene.groups[scene.group_count - 1];
}

// A ray that is not meets nothing: it would meet all boxes, also those of children that are not
// there.
PH_INLINE bool is_number(Vec3 origin, Vec3 direction) {
  return finite(origin) && finite(direction);
}

// Apart, or sixteen walks that begin together would get fewer registers beside it.
template <bool kAny>
PH_APART inline bool walk(const SceneView& scene, const Ray& ray, bool tree, NearestHit& best) {
  if (!is_number(ray.origin, ray.direction)) return false;
  return tree ? walk_tree<kAny, false>(scene, scene.root, ray, best)
              : walk_all<kAny>(scene, own_group(scene), ray, best);
}

// The nearest hit before `limit`; false for none.
inline bool intersect(const SceneView& scene, const Ray& ray, float limit, bool tree, Hit& hit) {
  NearestHit best{{limit, kNoSlot}, kNone, kNoSlot};
  walk<false>(scene, ray, tree, best);
  hit = best.hit;
  return hit.slot.leaf != kNone;
}

// Whether anything but `ignore` lies before `limit`.
inline bool occluded(const SceneView& scene, const Ray& ray, float limit, Slot ignore, bool tree) {
  NearestHit best{{limit, kNoSlot}, kNone, ignore};
  return walk<true>(scene, ray, tree, best);
}

}  // namespace parhelion::PH_ISA
