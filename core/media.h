// The bodies of glass or liquid that a path is inside of: which of several that overlap counts, and
// how much light it takes away.
// Method: C. Schmidt and B. Budge, "Simple Nested Dielectrics in Ray Traced Images", JGT 7(2),
// 2002.
#pragma once
#include "material.h"
#include "special.h"
#include "view.h"

namespace parhelion::PH_ISA {

// The body that counts: the one entered last, if it has no priority; else that of the highest, and
// of those the one entered last. kNone: outside of all. `except`: one occurrence of this record is
// passed over.
PH_INLINE u32 current_medium(const SceneView& scene, const Media& media, u32 except) {
  u32 best = kNone;
  bool passed = false;
  for (u32 i = media.count; i-- > 0;) {
    const u32 r = media.record[i];
    if (r == except && !passed) {
      passed = true;
      continue;
    }
    if (best == kNone) {
      best = r;
      if (scene.materials[r].priority == 0) return best;
    } else if (scene.materials[r].priority > scene.materials[best].priority) {
      best = r;
    }
  }
  return best;
}

PH_INLINE void leave(Media& media, u32 record) {
  for (u32 i = media.count; i-- > 0;) {
    if (media.record[i] != record) continue;
    for (u32 k = i + 1; k < media.count; ++k) media.record[k - 1] = media.record[k];
    --media.count;
    return;
  }
}

PH_INLINE void enter(Media& media, u32 record) {
  if (media.count < kMaxMedia) media.record[media.count++] = record;
}

// Keeps the account of a path that goes through the surface of a body.
PH_INLINE void cross_boundary(const SceneView& scene, Media& media, const MaterialRecord& m,
                              bool front) {
  if (!m.body) return;
  const u32 record = static_cast<u32>(&m - scene.materials);
  if (front) {
    enter(media, record);
  } else {
    leave(media, record);
  }
}

// The index of refraction of a body; 1 outside of all.
PH_INLINE float index_of(const SceneView& scene, u32 record) {
  if (record == kNone) return 1.0f;
  const ParamBlock& block = scene.materials[record].block;
  return with_material(block, [](const auto& m) {
    if constexpr (requires { m.ior; }) return m.ior;
    return 1.0f;
  });
}

// At the surface of a body with a priority: sets the material's relative index to that of the two
// bodies that meet there. False if the surface lies within one of higher priority: it is not there
// then, and the account is already kept.
template <class Material>
PH_INLINE bool enter_boundary(const SceneView& scene, Media& media, const MaterialRecord& m,
                              bool front, Material& material) {
  if (m.priority == 0) return true;
  const u32 record = static_cast<u32>(&m - scene.materials);
  const u32 other = current_medium(scene, media, front ? kNone : record);
  if (other != kNone && scene.materials[other].priority > m.priority) {
    cross_boundary(scene, media, m, front);
    return false;
  }
  if constexpr (requires { material.ior; }) material.ior /= index_of(scene, other);
  return true;
}

// Beer and Lambert's law over a length within the current body.
PH_INLINE void absorb(const SceneView& scene, const Media& media, float length, Vec3& throughput) {
  if (media.count == 0) return;
  const u32 record = current_medium(scene, media, kNone);
  const Vec3 a = scene.materials[record].absorption;
  if (black(a)) return;
  throughput *= Vec3{exp(-a.x * length), exp(-a.y * length), exp(-a.z * length)};
}

}  // namespace parhelion::PH_ISA
