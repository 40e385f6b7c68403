// All textures behind one switch, made from textures.def. Not forced inline: it is large, and asked
// for in many places.
#pragma once
#include "lookup.h"
#include "textures/attribute.h"
#include "textures/checker.h"
#include "textures/image.h"
#include "textures/mix.h"
#include "textures/multiply.h"
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

template <class Attributes>
PH_INLINE TexturePoint own_point(const TextureRecord& record, const TexturePoint& point,
                                 const Attributes& attribute) {
  TexturePoint own = point;
  Vec2 uv = point.uv;
  if (record.uvs != kNone) {
    const Vec3 other = attribute(record.uvs).rgb;
    uv = {other.x, other.y};
  }
  own.uv = own_uv(record, {uv.x + point.shift.x, uv.y + point.shift.y});
  own.width = point.width * stretch(record);
  return own;
}

PH_INLINE float channel_of(const Texel& t, u32 channel) {
  switch (channel) {
    case 1: return t.rgb.x;
    case 2: return t.rgb.y;
    case 3: return t.rgb.z;
    case 4: return t.a;
    default: return luminance(t.rgb);
  }
}

// Puts what a texture has in the place of the parameters that it stands for.
PH_INLINE void put(ParamBlock& block, const TextureBinding& binding, const Texel& t) {
  float* value = block.value + binding.offset;
  const float c = channel_of(t, binding.channel);
  const bool colored = binding.size == 3 && binding.channel == 0;
  const float part[3] = {colored ? t.rgb.x : c, colored ? t.rgb.y : c, colored ? t.rgb.z : c};
  for (u32 i = 0; i < binding.size; ++i) value[i] = clamp(part[i], binding.low, binding.high);
}

// An image whose texels are mixed, from the surface's own uv: image_batch.h looks up many at once.
PH_INLINE bool is_smooth_image(const TextureRecord& record) {
  return static_cast<TextureKind>(record.block.kind) == TextureKind::image &&
         record.binding_count == 0 && record.uvs == kNone &&
         !is_nearest(from_block<Image>(record.block));
}

// What texture `id` has at a point of a surface. attribute(name): what the surface's mesh has
// there.
template <class Attributes>
inline Texel evaluate(const TextureTables& tables, u32 id, const TexturePoint& point,
                      const Attributes& attribute) {
  const TextureRecord& listed = tables.records[id];
  if (static_cast<TextureKind>(listed.block.kind) == TextureKind::attribute) {
    return attribute(static_cast<u32>(listed.block.value[0]));
  }
  const auto look = [&](const TextureRecord& record) {
    const TexturePoint own = own_point(record, point, attribute);
    return with_texture(record,
                        [&](const auto& t) { return lookup(t, tables.images, record, own); });
  };
  if (listed.binding_count == 0) return look(listed);
  TextureRecord record = listed;
  for (u32 i = 0; i < listed.binding_count; ++i) {
    const TextureBinding& b = tables.bindings[listed.first_binding + i];
    put(record.block, b, evaluate(tables, b.texture, point, attribute));
  }
  return look(record);
}

// The distance in the surface's uv over which a texture, and those it is made of, change little.
// size: of a unit of uv in scene units, at most.
template <class Attributes>
inline float step_of(const TextureTables& tables, u32 id, const TexturePoint& point, float size,
                     const Attributes& attribute) {
  const TextureRecord& record = tables.records[id];
  const TexturePoint own = own_point(record, point, attribute);
  float least = with_texture(record, [&](const auto& texture) {
    return step(texture, tables.images, record, own, {stretch(record), size});
  });
  for (u32 i = 0; i < record.binding_count; ++i) {
    const u32 other = tables.bindings[record.first_binding + i].texture;
    least = min(least, step_of(tables, other, point, size, attribute));
  }
  return least;
}

// d value / du and d value / dv along a surface whose point moves by dpdu and dpdv (scene units),
// for bump maps: central differences. `value` makes a number of a Texel. Attributes count as
// constant.
template <class Value, class Attributes>
inline Vec2 slope(const TextureTables& tables, u32 id, const TexturePoint& point, Vec3 dpdu,
                  Vec3 dpdv, Value&& value, const Attributes& attribute) {
  const float size = sqrt(max(dot(dpdu, dpdu), dot(dpdv, dpdv)));
  const float h = step_of(tables, id, point, size, attribute);
  const auto at = [&](float du, float dv) {
    TexturePoint moved = point;
    moved.shift = {du, dv};
    moved.position = point.position + dpdu * du + dpdv * dv;
    return value(evaluate(tables, id, moved, attribute));
  };
  return {(at(h, 0.0f) - at(-h, 0.0f)) / (2.0f * h), (at(0.0f, h) - at(0.0f, -h)) / (2.0f * h)};
}

}  // namespace parhelion::PH_ISA
