// What every texture answers.
//
// A texture T, textures/NAME.h, has
//   a struct T whose members are its parameters in the order of T::params
//   lookup(t, images, record, point)   what it has at a point; `point` is in its own coordinates
//   step(t, images, record, point, s)  only if its differences need another step than below
//   has_image                          true if the record names an image
#pragma once
#include "entry.h"
#include "image.h"

namespace parhelion {

// Where a texture is looked up. The footprint is the part of the surface that a pixel sees, taken
// as round.
struct TexturePoint {
  Vec2 uv;                    // of the surface
  float width;                // of the footprint in uv; 0 is a point
  Vec3 position;              // in scene units, for textures that fill space
  float solid_width = 0.0f;   // of the footprint in scene units
  Vec2 shift = {0.0f, 0.0f};  // added to uv, whichever uv a texture takes
};

// A texture that stands for some parameters of a material or of another texture.
struct TextureBinding {
  u32 texture;
  u32 offset;       // of the first float that is replaced
  u32 size;         // 1 or 3
  u32 channel;      // 0 rgb, and of a single number its luminance; 1 r, 2 g, 3 b, 4 a
  float low, high;  // of the parameter: what lies beyond is cut to it
};

struct TextureRecord {
  ParamBlock block;
  float to_uv[6];  // from the surface's (u, v, 1) to the texture's uv: two rows of three
  u32 image;       // its index, if the texture has one
  u32 uvs;         // kNone, or the attribute that is taken for the surface's uv
  u32 first_binding, binding_count;  // of textures that came before this one
};

// All textures of a scene.
struct TextureTables {
  const TextureRecord* records;
  const TextureBinding* bindings;
  const ImageView* images;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// What a unit of the surface's uv is at a point, at most: in the texture's uv and in scene units.
struct UvScale {
  float own, solid;
};

// The distance in the surface's uv over which to take differences: half the footprint, or finer
// than what people draw.
template <class Texture>
PH_INLINE float step(const Texture&, const ImageView*, const TextureRecord&,
                     const TexturePoint& point, UvScale scale) {
  return max(0.5f * point.width, 0x1p-10f) / max(scale.own, 1e-6f);
}

}  // namespace parhelion::PH_ISA
