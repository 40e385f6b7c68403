// All textures behind one switch, made from textures.def. Not forced inline: it is large, and asked
// for in many places.
#pragma once
#include "lookup.h"
#include "textures/attribute.h"
#include "textures/checker.h"
#include "textures/image.h"
#include "textures/noise.h"
#include "textures/ramp.h"

namespace parhelion {

enum class TextureKind : u32 {
#define TEXTURE(name, Type) name,
#include "textures.def"
#undef TEXTURE
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Calls f with the struct of the record's own texture.
template <class F>
PH_INLINE auto with_texture(const TextureRecord& record, F&& f) {
  switch (static_cast<TextureKind>(record.block.kind)) {
#define TEXTURE(name, Type) \
  case TextureKind::name: return f(from_block<Type>(record.block));
#include "textures.def"
#undef TEXTURE
  }
  compiler::unreachable();
}

// From a surface's uv to the texture's.
PH_INLINE Vec2 own_uv(const TextureRecord& record, Vec2 uv) {
  const float (&m)[6] = record.to_uv;
  return {m[0] * uv.x + m[1] * uv.y + m[2], m[3] * uv.x + m[4] * uv.y + m[5]};
}

// The most that the transform stretches a footprint along u or v.
PH_INLINE float stretch(const TextureRecord& record) {
  const float (&m)[6] = record.to_uv;
  return sqrt(max(m[0] * m[0] + m[3] * m[3], m[1] * m[1] + m[4] * m[4]));
}

PH_INLINE TexturePoint own_point(const TextureRecord& record, const TexturePoint& point) {
  TexturePoint own = point;
  own.uv = own_uv(record, point.uv);
  own.width = point.width * stretch(record);
  return own;
}

// What texture `id` has at a point of a surface.
inline Texel evaluate(const TextureRecord* records, const ImageView* images, u32 id,
                      const TexturePoint& point) {
  const TextureRecord& record = records[id];
  const TexturePoint own = own_point(record, point);
  return with_texture(record,
                      [&](const auto& texture) { return lookup(texture, images, record, own); });
}

// d value / du and d value / dv along a surface whose point moves by dpdu and dpdv (scene units),
// for bump maps: central differences. `value` makes a number of a Texel.
template <class Value>
inline Vec2 slope(const TextureRecord* records, const ImageView* images, u32 id,
                  const TexturePoint& point, Vec3 dpdu, Vec3 dpdv, Value&& value) {
  const TextureRecord& record = records[id];
  const TexturePoint own = own_point(record, point);
  return with_texture(record, [&](const auto& texture) -> Vec2 {
    const float most = stretch(record);
    const float size = sqrt(max(dot(dpdu, dpdu), dot(dpdv, dpdv)));
    const float h = step(texture, images, record, own, {most, size});
    const auto at = [&](float du, float dv) {
      TexturePoint moved = own;
      moved.uv = own_uv(record, {point.uv.x + du, point.uv.y + dv});
      moved.position = point.position + dpdu * du + dpdv * dv;
      return value(lookup(texture, images, record, moved));
    };
    return {(at(h, 0.0f) - at(-h, 0.0f)) / (2.0f * h), (at(0.0f, h) - at(0.0f, -h)) / (2.0f * h)};
  });
}

}  // namespace parhelion::PH_ISA
