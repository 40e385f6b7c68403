// What a kernel sees of a scene: pointers and counts, all checked by the host before.
//
// Lengths are in the scene's normalised units: the host has multiplied them by the power of two
// that brings the largest coordinate near 1, so nanometres and parsecs look alike here. The
// primitives of a group that is instanced are in units of their own, by another power of two, which
// the instances' matrices undo.
#pragma once
#include "camera.h"
#include "entry.h"
#include "filter.h"
#include "light.h"
#include "light_tree.h"
#include "shapes/curve.h"
#include "shapes/cylinder.h"
#include "shapes/disk.h"
#include "shapes/sphere.h"
#include "shapes/triangle.h"
#include "texture.h"

namespace parhelion {

enum class ShapeKind : u32 {
#define SHAPE(name, Type) name,
#include "shapes.def"
#undef SHAPE
  instance = 7,
};

// Sixteen children and their boxes. Unused ones have low = +inf, high = -inf.
struct alignas(64) Node {
  float low[3][16], high[3][16];
  Child child[16];
};

PH_INLINE constexpr Child make_leaf(ShapeKind kind, u32 index) {
  return kLeafBit | static_cast<u32>(kind) << kLeafKindShift | index;
}
PH_INLINE constexpr ShapeKind leaf_kind(Child leaf) {
  return static_cast<ShapeKind>((leaf >> kLeafKindShift) & 7u);
}
// Whether a primitive may hide one point of a side from another that this side faces.
PH_INLINE constexpr bool may_hide_itself(ShapeKind kind) {
  return kind == ShapeKind::cylinder || kind == ShapeKind::curve;
}

// Levels of nodes in the deepest tree that the builder may make; bounds the traversal's stack.
inline constexpr int kMaxTreeDepth = 24;

// A copy of a group's tree. Matrices are affine, three rows of four, and lead between normalised
// units of the scene and of the group.
struct Instance {
  float to_group[12], to_scene[12];
  Child root;
  u32 group;
  float determinant;  // of to_group's linear part, its size
  u32 shape;          // its record, which names it
  u32 id;             // as a primitive, for its colour
  u32 first_emitter;  // of the group's emitters as seen through this instance
};

// A group that instances show, or, as the last one, the scene's own tree: where its blocks lie.
struct Group {
  Child root;
#define SHAPE(name, Type) u32 first_##name, last_##name;
#include "shapes.def"
#undef SHAPE
  u32 first_instance, last_instance;
};

// An array of numbers over a mesh, for textures.
struct MeshAttribute {
  const float* values;
  u32 name;        // as texture parameters say it
  u32 components;  // 1 to 3
  bool per_face;   // else per vertex
};

// At a vertex: where a normal map's x leads, unit, and on which side of it y lies, 1 for that of
// the cross product normal x x, -1 for the other.
struct Tangent {
  Vec3 x;
  float side;
};

// What all primitives of one shape of the user's have in common. Null pointers: there is none.
struct ShapeRecord {
  u32 first_id;         // ids of its primitives go on from here
  u32 material;         // kNone: material_of says
  u32 first_emitter;    // its primitives' emitters go on from here; kNone if it does not shine
  const u32* faces;     // three vertices a triangle
  const Vec3* normals;  // by vertex, unit
  const Vec2* uvs;      // by vertex
  const Tangent* tangents;
  const MeshAttribute* attributes;
  u32 attribute_count;
  bool inside_out;    // normals point the other way
  float rotation[9];  // of a sphere's own frame to the scene, row-major
};

// What only some materials have, as bits: paths at others are told apart by them at once.
inline constexpr u32 kUsesUv = 1u << 0;    // a texture or anisotropy needs the parametrisation
inline constexpr u32 kTextured = 1u << 1;  // parameters or normals
inline constexpr u32 kShines = 1u << 2;    // on some side, if no texture makes it black
inline constexpr u32 kShinesByTexture = 1u << 3;
inline constexpr u32 kBlends = 1u << 4;
inline constexpr u32 kTwoSided = 1u << 5;  // the back is another
inline constexpr u32 kKindShift = 8;

// A surface's material: its type's own parameters, and what every type has.
struct MaterialRecord {
  u32 traits;  // those bits, and from kKindShift on the block's kind
  ParamBlock block;
  u32 first_binding, binding_count;
  Vec3 emission;  // radiance
  u32 emission_texture;
  float opacity;
  TextureBinding opacity_texture;  // its texture is kNone if there is none
  u32 normal_map, bump_map;
  float bump_scale;               // the map's unit of height in normalised units
  u32 blend_first, blend_second;  // kNone, or a blend: this record stands for one of these
  float blend_weight;             // share of the second
  TextureBinding blend_texture;
  u32 back;  // record of the back; this one's own index if both sides look the same; kNone: black
  u32 priority;
  Vec3 absorption;  // 1 / normalised unit
  bool emits_back;
  bool body;                 // a path keeps account of being inside of it
  bool normal_right_handed;  // the normal map's y is normal x u, not along v
  bool clear;                // what is no hole goes straight on too, but tinted
};

// A light of the scene: an emissive primitive.
using Emitter = Slot;

struct SceneView {
  const Node* nodes;
  Child root;
  Box bounds;
  double unit;  // user's units per normalised unit
#define SHAPE(name, Type)     \
  const Type##Block* name##s; \
  u32 name##_blocks;
#include "shapes.def"
#undef SHAPE
  const Instance* instances;
  const Group* groups;
  u32 group_count;
  const ShapeRecord* shapes;
  // By id >> shift: the shape that the first primitive of these belongs to. One more at the end.
  const u32* shape_guide;
  u32 shape_guide_shift;
  const MaterialRecord* materials;
  TextureTables textures;
  const u32* material_of;  // by primitive id, where a shape's record says so
  const Vec3* color_of;    // by primitive id, NaN in x for the material's own; null if none has one
  bool has_holes;          // some material has holes or is clear
  bool has_bodies;         // paths keep account of what they are inside of

  // Lights: emissive primitives, then those of `lights` that lie in the scene, are the leaves of
  // the light tree; the rest of `lights` shine from outside, last those that are not asked for.
  LightTreeView light_tree;
  const Emitter* emitters;
  u32 emitter_count;
  const LightRecord* lights;
  u32 light_count, outside_first, smooth_first;
  float outside_share;  // of the samples that ask for light
  LightTables tables;
};

enum class Integrator : u32 { path, direct, ambient_occlusion };

// Bodies that a path can be inside of at once; it does not notice more.
inline constexpr u32 kMaxMedia = 8;

// Their materials' indices, in the order in which they were entered.
struct Media {
  u32 record[kMaxMedia];
  u32 count;
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
  Integrator integrator;
  float ao_distance;  // normalised units
  Vec3 backdrop;      // seen where the camera's rays hit nothing; NaN in x: what light is there
  Media media;        // that the camera is inside of
  // The most that light of one sample may bring to it after more than one scattering: kInfinity is
  // the truth, less is darker than that.
  float clamp_indirect = kInfinity;
  u32 width = 0, height = 0;  // of the whole picture, in pixels
  bool reuse_paths = false;   // pixels close by use each other's light (wavefront/reuse.h)
};

}  // namespace parhelion
