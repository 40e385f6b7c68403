// What a kernel sees of a scene: pointers and counts, all checked by the host before.
//
// Lengths are in the scene's normalised units: the host has multiplied them by the power of two
// that brings the largest coordinate near 1, so nanometres and parsecs look alike here.
#pragma once
#include "camera.h"
#include "entry.h"
#include "filter.h"
#include "shapes/sphere.h"

namespace parhelion {

enum class ShapeKind : u32 {
#define SHAPE(name, Type) name,
#include "shapes.def"
#undef SHAPE
};

// Sixteen children and their boxes. Unused ones have low = +inf, high = -inf.
struct alignas(64) Node {
  float low[3][16], high[3][16];
  Child child[16];
};

PH_INLINE constexpr Child make_leaf(ShapeKind kind, u32 block) {
  return kLeafBit | static_cast<u32>(kind) << kLeafKindShift | block;
}
PH_INLINE constexpr ShapeKind leaf_kind(Child leaf) {
  return static_cast<ShapeKind>((leaf >> kLeafKindShift) & 7u);
}

// Levels of nodes in the deepest tree that the builder may make; bounds the traversal's stack.
inline constexpr int kMaxTreeDepth = 24;

// A light of the scene: an emissive primitive. Picked with probability weight / total.
struct Emitter {
  Slot slot;
  float cumulative;  // sum of the weights up to and including this one, over the total
};

struct SceneView {
  const Node* nodes;
  Child root;
  Box bounds;
#define SHAPE(name, Type)     \
  const Type##Block* name##s; \
  u32 name##_blocks;
#include "shapes.def"
#undef SHAPE
  const ParamBlock* materials;
  const u32* material_of;  // by primitive id; null if all have material 0
  const Vec3* color_of;    // by primitive id, NaN in x for the material's own; null if none has one
  const Emitter* emitters;
  u32 emitter_count;
  float emitter_total;  // sum of emitter weights
  ParamBlock background;
};

// Everything else that a picture depends on.
struct RenderView {
  Camera camera;
  FilterTable filter;
  SamplerKind sampler;
  u64 seed;
  u32 max_depth;  // rays in a path, at most
  bool roulette;
  bool tree;  // false: test every primitive
};

}  // namespace parhelion
