// The place that a ray has hit, whatever the shape: point, normals, parametrisation, material.
#pragma once
#include "material.h"
#include "traverse.h"

namespace parhelion::PH_ISA {

// Frame: the scene, normalised units.
struct Surface {
  Vec3 point;
  Vec3 normal;   // geometric, outward, unit
  Vec3 shading;  // interpolated normal on the same side, unit
  Vec2 parameter;
  float error;  // the true surface is no farther from the point than this
  Slot slot;
  u32 id;
  const ShapeRecord* shape;
  const MaterialRecord* material;
  Vec3 color;  // the primitive's own colour, NaN in x if it has none
  // If the material uses them, or they were asked for:
  Vec2 uv;
  Vec3 dpdu, dpdv;
  float uv_rate;  // of uv per unit of length
};

// Calls f with the primitive in a slot and its id, in the frame of its group.
template <class F>
PH_INLINE auto with_primitive(const SceneView& scene, Slot slot, F&& f) {
  switch (leaf_kind(slot.leaf)) {
#define SHAPE(name, Type)                                          \
  case ShapeKind::name: {                                          \
    const auto& block = scene.name##s[slot.leaf & kLeafIndexMask]; \
    return f(primitive(block, slot.lane), block.id[slot.lane]);    \
  }
#include "shapes.def"
#undef SHAPE
    case ShapeKind::instance: break;
  }
  compiler::unreachable();
}

PH_INLINE const Instance* instance_of(const SceneView& scene, Slot slot) {
  return slot.instance == kNone ? nullptr : &scene.instances[slot.instance];
}

// Of these shapes the last that begins at or before a primitive's id.
PH_APART inline const ShapeRecord& last_shape(const SceneView& scene, u32 id, u32 low, u32 high) {
  while (low < high) {
    const u32 middle = low + (high - low + 1) / 2;
    if (scene.shapes[middle].first_id <= id) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  return scene.shapes[low];
}

// The record of the shape that a primitive belongs to.
PH_INLINE const ShapeRecord& shape_of(const SceneView& scene, u32 id) {
  const u32* guide = scene.shape_guide + (id >> scene.shape_guide_shift);
  const bool known = scene.shape_guide_shift == 0 || guide[0] == guide[1];
  return known ? scene.shapes[guide[0]] : last_shape(scene, id, guide[0], guide[1]);
}

PH_INLINE const MaterialRecord& material_of(const SceneView& scene, const ShapeRecord& shape,
                                            u32 id) {
  return scene.materials[shape.material == kNone ? scene.material_of[id] : shape.material];
}

PH_INLINE bool has_color(Vec3 own) { return own.x == own.x; }
// That of a primitive, or else of the instance that it is seen through.
PH_INLINE Vec3 own_color(const SceneView& scene, u32 id, const Instance* instance) {
  const float nan = kInfinity - kInfinity;
  if (!scene.color_of) return {nan, nan, nan};
  const Vec3 color = scene.color_of[id];
  return instance && !has_color(color) ? scene.color_of[instance->id] : color;
}

// Of a triangle's vertices, by barycentric weights.
template <class T>
PH_INLINE T interpolate(const T* of_vertex, const u32* face, Vec2 b) {
  return of_vertex[face[0]] * (1.0f - b.x - b.y) + of_vertex[face[1]] * b.x +
         of_vertex[face[2]] * b.y;
}
PH_INLINE Vec2 operator*(Vec2 a, float s) { return {a.x * s, a.y * s}; }
PH_INLINE Vec2 operator+(Vec2 a, Vec2 b) { return {a.x + b.x, a.y + b.y}; }

PH_INLINE const u32* face_of(const ShapeRecord& shape, u32 id) {
  return shape.faces + 3 * static_cast<u64>(id - shape.first_id);
}

// Sets x and y to the axes of the mesh's own tangent space around a shading normal, if it has one.
PH_INLINE void own_axes(const SceneView& scene, const Surface& s, Vec3 normal, Vec3& x, Vec3& y) {
  const Tangent* tangents = s.shape->tangents;
  if (!tangents) return;
  const u32* face = face_of(*s.shape, s.id);
  const Tangent &a = tangents[face[0]], &b = tangents[face[1]], &c = tangents[face[2]];
  Vec3 along =
      a.x * (1.0f - s.parameter.x - s.parameter.y) + b.x * s.parameter.x + c.x * s.parameter.y;
  if (!(dot(along, along) > 1e-12f)) return;
  bool left = (a.side < 0.0f) != s.shape->inside_out;
  if (const Instance* instance = instance_of(scene, s.slot)) {
    const float (&m)[12] = instance->to_scene;
    along = transform_vector(m, along);
    // what is mirrored has its cross product on the other side
    const Vec3 rows[3] = {{m[0], m[1], m[2]}, {m[4], m[5], m[6]}, {m[8], m[9], m[10]}};
    if (dot(cross(rows[0], rows[1]), rows[2]) < 0.0f) left = !left;
  }
  x = along;
  y = cross(normal, along) * (left ? -1.0f : 1.0f);
}

// Which side is outside: that of the mesh's own normals, where it has some, else that of its
// winding. normal: geometric, in the group's frame; shading is set to the interpolated one.
PH_INLINE void orient(const ShapeRecord& shape, u32 id, Vec2 parameter, Vec3& normal,
                      Vec3& shading) {
  shading = normal;
  if (shape.normals) {
    const Vec3 n = interpolate(shape.normals, face_of(shape, id), parameter);
    const float size = dot(n, n);
    if (size > 1e-12f) {
      shading = n * (1.0f / sqrt(size));
      if (dot(shading, normal) < 0.0f) normal = -normal;
    }
  }
  if (shape.inside_out) {
    normal = -normal;
    shading = -shading;
  }
}

// uv and how the point moves with it, in the group's frame.
template <class Shape>
PH_INLINE void parametrise(const ShapeRecord& record, const Shape& shape, u32 id,
                           const SurfacePoint& p, Surface& s) {
  if constexpr (requires { parametrise(shape, record.rotation, p, s.uv, s.dpdu, s.dpdv); }) {
    (void)id;
    parametrise(shape, record.rotation, p, s.uv, s.dpdu, s.dpdv);
  } else if constexpr (requires { parametrise(shape, p, s.uv, s.dpdu, s.dpdv); }) {
    (void)id;
    parametrise(shape, p, s.uv, s.dpdu, s.dpdv);
  } else {  // triangles
    Vec2 a = {0, 0}, b = {1, 0}, c = {0, 1};
    if (record.uvs) {
      const u32* face = face_of(record, id);
      a = record.uvs[face[0]], b = record.uvs[face[1]], c = record.uvs[face[2]];
    }
    s.uv = a * (1.0f - p.parameter.x - p.parameter.y) + b * p.parameter.x + c * p.parameter.y;
    const Vec2 ab = {b.x - a.x, b.y - a.y}, ac = {c.x - a.x, c.y - a.y};
    const Vec3 e1 = shape.vertex[1] - shape.vertex[0], e2 = shape.vertex[2] - shape.vertex[0];
    const float determinant = ab.x * ac.y - ab.y * ac.x;
    if (determinant != 0.0f) {
      const float inverse = 1.0f / determinant;
      s.dpdu = (e1 * ac.y - e2 * ab.y) * inverse;
      s.dpdv = (e2 * ab.x - e1 * ac.x) * inverse;
    }
    if (determinant == 0.0f || !finite(s.dpdu) || !finite(s.dpdv)) {
      s.dpdu = e1;
      s.dpdv = e2;
    }
  }
}

// uv per unit of length.
PH_INLINE float uv_rate(Vec3 dpdu, Vec3 dpdv) {
  const Vec3 n = cross(dpdu, dpdv);
  const float rate = 1.0f / sqrt(sqrt(dot(n, n)));
  return finite(rate) ? rate : 0.0f;
}

// Fills everything but the point itself, which `p` has, into s.
template <class Shape>
PH_INLINE void complete(const SceneView& scene, const Shape& shape, u32 id, SurfacePoint p,
                        const Instance* instance, bool wants_uv, Surface& s) {
  s.id = id;
  s.shape = &shape_of(scene, id);
  s.material = &material_of(scene, *s.shape, id);
  s.color = own_color(scene, id, instance);
  s.parameter = p.parameter;
  s.point = p.point;
  s.error = p.error;
  Vec3 normal = p.normal, shading;
  orient(*s.shape, id, p.parameter, normal, shading);
  s.uv = {0, 0};
  s.dpdu = s.dpdv = {0, 0, 0};
  s.uv_rate = 0.0f;
  const bool parametrised = wants_uv || (s.material->traits & kUsesUv) != 0;
  if (parametrised) parametrise(*s.shape, shape, id, p, s);
  if (instance) {
    // Rounding of the transform: four products a coordinate, each of at most |m| |p|.
    const float (&m)[12] = instance->to_scene;
    float most = 0.0f, stretch = 0.0f;
    for (int row = 0; row < 3; ++row) {
      const float* r = m + 4 * row;
      most = max(most,
                 abs(r[0] * p.point.x) + abs(r[1] * p.point.y) + abs(r[2] * p.point.z) + abs(r[3]));
      stretch = max(stretch, abs(r[0]) + abs(r[1]) + abs(r[2]));
    }
    s.error = 1.75f * (p.error * stretch + most * 0x1p-22f);
    s.point = transform_point(m, p.point);
    normal = normalize(transform_normal(instance->to_group, normal));
    shading = normalize(transform_normal(instance->to_group, shading));
    if (parametrised) {
      s.dpdu = transform_vector(m, s.dpdu);
      s.dpdv = transform_vector(m, s.dpdv);
    }
  }
  s.normal = normal;
  s.shading = shading;
  if (parametrised) s.uv_rate = uv_rate(s.dpdu, s.dpdv);
}

// wants_uv: even if the material does not use it.
PH_INLINE Surface surface_at(const SceneView& scene, const Ray& ray, const Hit& hit,
                             bool wants_uv = false) {
  Surface s;
  s.slot = hit.slot;
  const Instance* instance = instance_of(scene, hit.slot);
  GroupRay local = {ray, 1.0f, 0.0f};
  if (instance) local = into_group(*instance, hit.slot.instance, ray);
  with_primitive(scene, hit.slot, [&](const auto& shape, u32 id) {
    SurfacePoint p;
    surface(shape, local.ray, hit.t * local.stretch - local.skipped, p);
    complete(scene, shape, id, p, instance, wants_uv, s);
  });
  return s;
}

// --- Textures ----------------------------------------------------------------------------------

PH_INLINE TexturePoint texture_point(const SceneView& scene, const Surface& s, float width) {
  const float unit = static_cast<float>(scene.unit);
  return {s.uv, width * s.uv_rate, s.point * unit, width * unit};
}

// What a surface's mesh has at it by the name of an attribute: black where there is none.
PH_INLINE Texel attribute_at(const Surface& s, u32 name) {
  for (u32 i = 0; i < s.shape->attribute_count; ++i) {
    const MeshAttribute& a = s.shape->attributes[i];
    if (a.name != name) continue;
    const u32* face = face_of(*s.shape, s.id);
    const auto value = [&](u32 component) {
      const u32 c = a.components == 1 ? 0 : component;
      if (c >= a.components) return 0.0f;
      if (a.per_face) {
        return a.values[static_cast<u64>(s.id - s.shape->first_id) * a.components + c];
      }
      const auto at = [&](u32 corner) {
        return a.values[static_cast<u64>(face[corner]) * a.components + c];
      };
      return at(0) * (1.0f - s.parameter.x - s.parameter.y) + at(1) * s.parameter.x +
             at(2) * s.parameter.y;
    };
    return {{value(0), value(1), value(2)}, 1.0f};
  }
  return {{0, 0, 0}, 1.0f};
}

// width: of the footprint that the value is wanted for, in units of length.
PH_INLINE Texel texel(const SceneView& scene, u32 texture, const Surface& s, float width) {
  return evaluate(scene.textures, texture, texture_point(scene, s, width),
                  [&](u32 name) { return attribute_at(s, name); });
}

// How much higher a height field is per unit of uv.
PH_INLINE Vec2 bump_slope(const SceneView& scene, u32 texture, const Surface& s, float width) {
  const float unit = static_cast<float>(scene.unit);
  return slope(
      scene.textures, texture, texture_point(scene, s, width), s.dpdu * unit, s.dpdv * unit,
      [](const Texel& t) { return luminance(t.rgb); },
      [&](u32 name) { return attribute_at(s, name); });
}

// A number, or what a texture has in its place at the surface that `at` returns: that is asked for
// one only then, as it is much to put together.
template <class At>
PH_INLINE float scalar(const SceneView& scene, float value, const TextureBinding& binding, At&& at,
                       float width) {
  if (binding.texture == kNone) return value;
  return channel_of(texel(scene, binding.texture, at(), width), binding.channel);
}

// Share of the light that finds a surface here, not a hole.
PH_INLINE float opacity(const SceneView& scene, const MaterialRecord& m, const Surface& s,
                        float width) {
  return scalar(scene, m.opacity, m.opacity_texture, [&]() -> const Surface& { return s; }, width);
}

// Calls f(texture) for each texture that stands for parameters of a material, in their order, and
// put(binding) for what it stands for: metallic and roughness, say, are often channels of one.
template <class F, class Put>
PH_INLINE void for_each_texture(const SceneView& scene, const MaterialRecord& m, F&& f, Put&& put) {
  u32 last = kNone;
  for (u32 i = 0; i < m.binding_count; ++i) {
    const TextureBinding& b = scene.textures.bindings[m.first_binding + i];
    if (b.texture != last) f(b.texture);
    last = b.texture;
    put(b);
  }
}

// The material's own parameters here, with textures in their place.
PH_INLINE ParamBlock parameters(const SceneView& scene, const MaterialRecord& m, const Surface& s,
                                float width) {
  ParamBlock block = m.block;
  Texel value = {{0, 0, 0}, 0};
  for_each_texture(
      scene, m, [&](u32 texture) { value = texel(scene, texture, s, width); },
      [&](const TextureBinding& b) { put(block, b, value); });
  return block;
}

// The color of a clear material: share of the light that passes.
PH_INLINE Vec3 tint(const SceneView& scene, const MaterialRecord& m, const Surface& s,
                    float width) {
  return has_color(s.color) ? s.color : block_color(parameters(scene, m, s, width));
}

// Radiance that a surface of its own colour, if it has one, gives off on the side it is seen from.
// texel: what the texture of the emission has there.
PH_INLINE Vec3 emission(const MaterialRecord& m, Vec3 color, bool front, Vec3 texel = {1, 1, 1}) {
  Vec3 sum = {0, 0, 0};
  if (front || m.emits_back) sum = m.emission * texel;
  if (static_cast<MaterialKind>(m.block.kind) == MaterialKind::emissive) {
    sum += has_color(color) ? color : block_color(m.block);
  }
  return sum;
}
PH_INLINE bool emits_texture(const MaterialRecord& m, bool front) {
  return m.emission_texture != kNone && (front || m.emits_back);
}
PH_INLINE Vec3 emission(const SceneView& scene, const MaterialRecord& m, const Surface& s,
                        bool front) {
  if (!emits_texture(m, front)) return emission(m, s.color, front);
  return emission(m, s.color, front, max(texel(scene, m.emission_texture, s, 0.0f).rgb, {0, 0, 0}));
}

}  // namespace parhelion::PH_ISA
