// Surfaces: where rays have met them, and which material is there with which parameters.
#pragma once
#include "wave.h"

namespace parhelion::PH_ISA {

// Shapes whose surfaces are found for all paths that meet them at once: those that do not say that
// they are found alone.
template <class Shape>
concept FoundTogether = !requires { Shape::found_alone; };

// Where rays meet primitives of one kind. kOthers: there are others, whose points are found
// already.
template <bool kOthers, FoundTogether Shape>
PH_APART inline void find_points(const Rows<PrimitiveBlock, kBatch>& __restrict primitives,
                                 u32 lanes, const Paths& __restrict paths, Vertices& __restrict v) {
  u32 these[kBatch];
  spread(lanes, these);
  for (u32 k = 0; k < kBatch; ++k) {
    const Ray ray = {paths.origin.at(k), paths.direction.at(k), kNoSlot, false};
    SurfacePoint s;
    surface(primitives.at<Shape>(k), ray, paths.t[k], s);
    const bool own = (these[k] != 0) | !kOthers;
    v.point.set(k, select(own, s.point, v.point.at(k)));
    v.normal.set(k, select(own, s.normal, v.normal.at(k)));
    v.parameter.row[0][k] = own ? s.parameter.x : v.parameter.row[0][k];
    v.parameter.row[1][k] = own ? s.parameter.y : v.parameter.row[1][k];
    v.error[k] = own ? s.error : v.error[k];
  }
}

// Turns normals to the outside of shapes that have no normals of their own.
PH_APART inline void face_outside(u32 lanes, Vertices& __restrict v) {
  u32 these[kBatch];
  spread(lanes, these);
  for (u32 k = 0; k < kBatch; ++k) {
    const float side = (these[k] & v.inside_out[k]) != 0 ? -1.0f : 1.0f;
    const Vec3 n = v.normal.at(k) * side;
    v.normal.set(k, n);
    v.shading.set(k, select(these[k] != 0, n, v.shading.at(k)));
  }
}

// Of the rarer shapes and of instances, one by one.
PH_APART inline void find_others(const SceneView& scene, const Paths& paths, u32 lanes,
                                 u32 wants_uv, Vertices& v) {
  for_each_bit(lanes, [&](u32 k) {
    const Hit hit = {paths.t[k], paths.slot.at(k)};
    v.set_surface(k, surface_at(scene, paths.ray(k), hit, (wants_uv >> k & 1u) != 0));
  });
}

// The surfaces that paths have met. wants_uv: lanes that want them even if the material does not.
inline void find_surfaces(const SceneView& scene, const Paths& paths, u32 lanes, u32 wants_uv,
                          Vertices& v) {
  u32 kinds[static_cast<u32>(ShapeKind::instance)] = {}, others = 0, bare = 0, smooth = 0,
      parametrised = 0;
  for_each_bit(lanes, [&](u32 k) {
    const Slot slot = paths.slot.at(k);
    const u32 bit = 1u << k, index = slot.leaf & kLeafIndexMask;
    const ShapeKind kind = leaf_kind(slot.leaf);
    u32 id = kNone;
    const auto take = [&](const auto& block) {
      if constexpr (FoundTogether<decltype(primitive(block, slot.lane))>) {
        v.primitive.set(k, primitive(block, slot.lane));
        id = block.id[slot.lane];
      }
    };
    if (slot.instance == kNone) {
#define SHAPE(name, Type) \
  if (kind == ShapeKind::name) take(scene.name##s[index]);
#include "../shapes.def"
#undef SHAPE
    }
    if (id == kNone) {
      others |= bit;
      return;
    }
    kinds[static_cast<u32>(kind)] |= bit;
    const ShapeRecord& shape = shape_of(scene, id);
    const MaterialRecord& m = material_of(scene, shape, id);
    (shape.normals ? smooth : bare) |= bit;
    if ((m.traits & kUsesUv) != 0) parametrised |= bit;
    v.id[k] = id;
    v.shape[k] = &shape;
    v.material[k] = &m;
    v.traits[k] = m.traits;
    v.color.set(k, own_color(scene, id, nullptr));
    v.inside_out[k] = shape.inside_out;
  });
  const u32 together = bare | smooth;
  parametrised |= wants_uv & together;
  if (others != 0) find_others(scene, paths, others, wants_uv, v);
  u32 found = others;
  const auto find = [&]<class Shape>(ShapeKind kind) {
    if constexpr (FoundTogether<Shape>) {
      const u32 own = kinds[static_cast<u32>(kind)];
      if (own == 0) return;
      with_flag(found != 0,
                [&]<bool kOthers>() { find_points<kOthers, Shape>(v.primitive, own, paths, v); });
      found |= own;
    }
  };
#define SHAPE(name, Type) find.template operator()<Type>(ShapeKind::name);
#include "../shapes.def"
#undef SHAPE
  face_outside(bare, v);
  for_each_bit(smooth, [&](u32 k) {  // by vertices' normals
    Vec3 normal = v.normal.at(k), shading;
    orient(*v.shape[k], v.id[k], v.parameter.at(k), normal, shading);
    v.normal.set(k, normal);
    v.shading.set(k, shading);
  });
  for_each_bit(together & v.parametrised & ~parametrised, [&](u32 k) {
    v.uv.set(k, Vec2{0, 0});
    v.dpdu.set(k, Vec3{0, 0, 0});
    v.dpdv.set(k, Vec3{0, 0, 0});
    v.uv_rate[k] = 0.0f;
  });
  v.parametrised = (v.parametrised & ~lanes) | parametrised | others;
  for_each_bit(parametrised, [&](u32 k) {
    Surface s;
    // The normal as it was found
    const Vec3 normal = v.inside_out[k] != 0 ? -v.normal.at(k) : v.normal.at(k);
    const SurfacePoint p = {v.point.at(k), normal, v.parameter.at(k), v.error[k]};
    with_primitive(scene, paths.slot.at(k),
                   [&](const auto& shape, u32 id) { parametrise(*v.shape[k], shape, id, p, s); });
    v.uv.set(k, s.uv);
    v.dpdu.set(k, s.dpdu);
    v.dpdv.set(k, s.dpdv);
    v.uv_rate[k] = uv_rate(s.dpdu, s.dpdv);
  });
}

// Along the rays, to the sides of surfaces that they arrive at.
PH_APART inline void travel(Paths& __restrict p, Vertices& __restrict v) {
  for (u32 k = 0; k < kBatch; ++k) {
    p.width[k] += p.spread[k] * p.t[k];
    p.travelled[k] += p.t[k];
    v.front[k] = dot(p.direction.at(k), v.normal.at(k)) < 0.0f ? 1 : 0;
  }
}

// The lanes that end where nothing is but a surface; the others scatter by its material.
PH_APART inline u32 meet_plainly(u32 max_depth, const Paths& __restrict p, Vertices& __restrict v) {
  u32 ends[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    v.record[k] = v.material[k];
    ends[k] = p.depth[k] >= max_depth ? 1 : 0;
  }
  return any_of(1, ends);
}

// Whether anything may be where paths meet surfaces that no trait tells.
PH_INLINE bool meets_more(const SceneView& scene, const RenderView& view, const Wave& wave) {
  return scene.has_holes || scene.has_bodies || wave.features != nullptr ||
         view.integrator == Integrator::ambient_occlusion;
}

// What there is where a path has met a surface, of blends as such, and what it gives off.
PH_APART inline Fate meet(const SceneView& scene, const RenderView& view, Wave& wave, Vertices& v,
                          u32 k, PathStats& stats) {
  Paths& p = wave.paths;
  const MaterialRecord& own = *v.material[k];
  const bool first = p.depth[k] == 1;
  if (p.media[k].count != 0) {
    Vec3 throughput = p.throughput.at(k);
    absorb(scene, p.media[k], p.t[k], throughput);
    p.throughput.set(k, throughput);
  }
  if (scene.has_holes) {
    const Surface s = v.surface(k, p.slot.at(k));
    // Rays to lights see holes as sharp (transmittance() in path.h), so what is weighed against
    // them and what other paths share has to, too; blurred by the width of a scattered ray half of
    // a cut-out would be open everywhere.
    const float width = first ? p.width[k] : 0.0f;
    const float solid = opacity(scene, own, s, width);
    const u32 draw = bounce_draw(p.depth[k]) + kDrawOpacity + p.holes[k] * 0x10000u;
    const bool hole = solid < 1.0f && !(draw1(p.samplers.at(k), draw) < solid);
    if ((hole || own.clear) && p.holes[k] < kMaxHoles) {
      if (!hole) {
        add_emission(scene, view, s, v.emission[k], p, k);
        p.throughput.set(k, p.throughput.at(k) * tint(scene, own, s, p.width[k]));
      }
      p.set_ray(k, ray_from(s, p.direction.at(k)));
      ++p.holes[k];
      return Fate::passes;
    }
  }
  if (wave.features && first) {
    const Slot slot = p.slot.at(k);
    Features& f = wave.features[k];
    f.depth = p.travelled[k];
    f.position = v.point.at(k);
    f.normal = v.normal.at(k);
    f.shading_normal = v.shading.at(k);
    f.uv = v.uv.at(k);
    f.shape = slot.instance == kNone ? static_cast<u32>(v.shape[k] - scene.shapes)
                                     : scene.instances[slot.instance].shape;
    f.material = static_cast<u32>(&own - scene.materials);
  }
  if (view.integrator == Integrator::ambient_occlusion) {
    p.sum.set(k, ambient_occlusion(scene, view, v.surface(k, p.slot.at(k)), -p.direction.at(k),
                                   p.samplers.at(k), stats));
    return Fate::ends;
  }
  const bool front = v.front[k] != 0;
  Vec3 shine = {0, 0, 0};
  if ((own.traits & kShines) != 0)
    shine = add_emission(scene, view, v.surface(k, p.slot.at(k)), v.emission[k], p, k);
  const MaterialRecord* m = !front && own.back != kNone ? &scene.materials[own.back] : &own;
  if (wave.features && first) wave.features[k].emission = shine;
  if (p.depth[k] >= view.max_depth) return Fate::ends;
  if (!front && own.back == kNone) return Fate::ends;
  v.record[k] = m;
  v.traits[k] = m->traits;
  return Fate::scatters;
}

}  // namespace parhelion::PH_ISA
