// Numbers, vectors and rays: the plain types that host and kernels share.
//
// Nothing in core/ includes a standard header (simd.h takes the processor's intrinsics), allocates,
// throws or keeps state, so the same text
// compiles for every instruction set of a CPU and, through NVRTC, for a GPU. Types that cross from
// host to kernel are plain data in namespace parhelion. All functions live in parhelion::PH_ISA,
// a namespace per instruction set: the linker must never take an AVX-512 body for an SSE4.2 caller.
#pragma once
#include "compiler.h"

#ifndef PH_ISA
#define PH_ISA baseline
#endif

namespace parhelion {

using u8 = unsigned char;
using u16 = unsigned short;
using u32 = unsigned int;
using u64 = unsigned long long;
using i64 = long long;

static_assert(sizeof(u16) == 2 && sizeof(u32) == 4 && sizeof(u64) == 8 && sizeof(float) == 4);

inline constexpr float kInfinity = __builtin_bit_cast(float, 0x7f800000u);
inline constexpr float kBelowOne = 0x1.fffffep-1f;  // the largest float there
inline constexpr float kPi = 3.14159265358979324f;
inline constexpr u32 kNone = ~0u;

// A point, direction or linear RGB colour.
struct Vec3 {
  float x, y, z;
};

struct Vec2 {
  float x, y;
};

struct Box {
  Vec3 low, high;
};

// A child of a tree node: another node's index, or, with the top bit set, a leaf: the shape's kind
// in the next three bits and in the rest the index of its block, or of the instance itself.
using Child = u32;
inline constexpr u32 kLeafBit = 1u << 31;
inline constexpr int kLeafKindShift = 28;
inline constexpr u32 kLeafIndexMask = (1u << kLeafKindShift) - 1;

// Where a primitive lies: its leaf, its lane in the leaf's block, and the instance that it is seen
// through, kNone for one of the scene itself.
struct Slot {
  Child leaf;
  u32 lane;
  u32 instance;
};
inline constexpr Slot kNoSlot = {kNone, 0, kNone};

// A ray in the scene's normalised units (see host/scene.h). `self` is the primitive that the ray
// starts on, or kNoSlot: it is never hit at distance 0, without any offset of the origin. `inward`
// says that the ray sets off into that primitive and may meet its far side.
struct Ray {
  Vec3 origin;
  Vec3 direction;  // unit length
  Slot self;
  bool inward;
};

// The nearest intersection: distance along the ray, and the primitive.
struct Hit {
  float t;
  Slot slot;
};

// So many samples, or rays, are dealt with at once, each step for all of them before the next:
// loops of a fixed length, which compilers turn into vectors.
inline constexpr u32 kBatch = 16;

// Rays, each of which looks up to its limit, and what they hit, by component, as they cross from
// host to kernel.
struct SlotBatch {
  u32 leaf[kBatch], lane[kBatch], instance[kBatch];
};
struct RayBatch {
  alignas(64) float origin[3][kBatch], direction[3][kBatch], limit[kBatch];
  SlotBatch self;
  u32 inward;  // bit k: ray k
  u32 lanes;   // those that are asked; the others are numbers
};
struct HitBatch {  // of lanes that are not asked it tells nothing
  alignas(64) float t[kBatch];
  SlotBatch slot;
};

}  // namespace parhelion
