// Direct light: which light to ask, and a direction towards it. Lights are emissive primitives and
// the entries of `lights`; those that lie in the scene are chosen by the light tree, those that
// shine from outside it by how much light they give.
#pragma once
#include "rows.h"
#include "surface.h"

namespace parhelion::PH_ISA {

// A light sample, and what the shadow ray must not count as an obstacle.
struct DirectSample {
  Vec3 direction;
  float distance;
  float pdf;  // per steradian, the choice of the light included; 0 if there is none. Of a light
              // without extent, the probability of its choice
  Vec3 radiance;
  bool delta;
  Slot slot;
};

// Whether there is a light to ask for.
PH_INLINE bool asks_for_light(const SceneView& scene) {
  return scene.light_tree.light_count != 0 || scene.outside_first != scene.smooth_first;
}

// Whether most light samples choose among several lights that lie in the scene.
PH_INLINE bool chooses_lights(const SceneView& scene) {
  return scene.light_tree.light_count > 1 && scene.outside_share < 0.5f;
}

// From an instance's frame: how many steradians there a steradian of the scene becomes.
PH_INLINE float solid_angle_ratio(const Instance& instance, float stretch) {
  return instance.determinant / (stretch * stretch * stretch);
}

PH_INLINE u32 emitter_index(const SceneView& scene, const Surface& s) {
  if (s.shape->first_emitter == kNone) return kNone;
  const u32 local = s.shape->first_emitter + (s.id - s.shape->first_id);
  return s.slot.instance == kNone ? local : scene.instances[s.slot.instance].first_emitter + local;
}

// Density with which a light sample that is asked for at a point, with a highlight or none, picks
// the direction to the surface s, which shines.
PH_INLINE float emitter_pdf(const SceneView& scene, const Surface& s, const Receiver& from,
                            const Highlight& highlight, Vec3 direction) {
  const u32 index = emitter_index(scene, s);
  if (index == kNone) return 0.0f;
  const float choice =
      (1.0f - scene.outside_share) * light_probability(scene.light_tree, index, from, highlight);
  if (!(choice > 0.0f)) return 0.0f;
  return choice * with_primitive(scene, s.slot, [&](const auto& shape, u32) {
           const float distance = length(s.point - from.point);
           const Instance* instance = instance_of(scene, s.slot);
           if (!instance) return pdf_towards(shape, from.point, direction, distance, s.normal);
           const Vec3 d = transform_vector(instance->to_group, direction);
           const float stretch = length(d);
           return solid_angle_ratio(*instance, stretch) *
                  pdf_towards(shape, transform_point(instance->to_group, from.point),
                              d * (1.0f / stretch), distance * stretch,
                              normalize(transform_normal(instance->to_scene, s.normal)));
         });
}

// A direction towards one emissive primitive, of which `t` is the sample in its group's frame and
// `origin` the point there; its pdf without the choice of that primitive.
template <class Shape>
PH_INLINE DirectSample emitter_sample(const SceneView& scene, Slot slot, const Instance* instance,
                                      const Shape& shape, u32 id, Vec3 origin,
                                      const TowardsSample& t) {
  DirectSample out = {t.direction, t.distance, t.pdf, {0, 0, 0}, false, slot};
  if (!(t.pdf > 0.0f)) return out;
  const ShapeRecord& record = shape_of(scene, id);
  const MaterialRecord& material = material_of(scene, record, id);
  if (!instance && material.emission_texture == kNone && !scene.has_holes) {
    // As of most: nothing matters but the side that is seen.
    bool front = (dot(t.direction, t.normal) < 0.0f) != record.inside_out;
    if (record.normals) {
      Vec3 normal = t.normal, shading;
      orient(record, id, t.parameter, normal, shading);
      front = dot(t.direction, normal) < 0.0f;
    }
    out.radiance = emission(material, own_color(scene, id, nullptr), front);
    return out;
  }
  Surface s;
  s.slot = slot;
  const SurfacePoint p = {origin + t.direction * t.distance, t.normal, t.parameter, 0.0f};
  complete(scene, shape, id, p, instance, false, s);
  if (instance) {
    const Vec3 d = transform_vector(instance->to_scene, t.direction);
    const float stretch = 1.0f / length(d);
    out.direction = d * stretch;
    out.distance = t.distance / stretch;
    out.pdf = t.pdf * solid_angle_ratio(*instance, stretch);
  }
  out.radiance = emission(scene, *s.material, s, dot(out.direction, s.normal) < 0.0f);
  if (scene.has_holes) {
    out.radiance = out.radiance * clamp(opacity(scene, *s.material, s, 0.0f), 0.0f, 1.0f);
  }
  return out;
}

// A light that is asked: an entry of `lights`, an emissive primitive, or none.
struct LightPick {
  u32 record;  // kNone: the primitive in `slot`, if there is one
  Slot slot;
  float probability;
  float u;  // what is left of the number that chose it
};

// Of the lights in the tree, as its choice is.
PH_INLINE LightPick pick_inside(const SceneView& scene, const LightChoice& c) {
  if (c.light == kNone) return {kNone, kNoSlot, 0.0f, 0.0f};
  const float p = c.probability * (1.0f - scene.outside_share);
  if (c.light < scene.emitter_count) return {kNone, scene.emitters[c.light], p, c.u};
  return {c.light - scene.emitter_count, kNoSlot, p, c.u};
}

// Of a number that has not chosen a light from outside, a new one.
PH_INLINE double number_inside(const SceneView& scene, double number) {
  const double share = static_cast<double>(scene.outside_share);
  return (number - share) / (1.0 - share);
}

// The lights from outside that some numbers choose: those that lie below outside_share, and what is
// found of others means nothing. Without a branch, so that of sixteen it is vectors.
template <u32 kCount>
struct OutsideChoice {
  u32 light[kCount];
  float share[kCount], u[kCount];  // of what comes from outside; what is left of the number

  PH_INLINE LightPick pick(const SceneView& scene, u32 i) const {
    return {light[i], kNoSlot, scene.outside_share * share[i], u[i]};
  }
};
template <u32 kCount>
PH_INLINE void choose_outside(const SceneView& scene, const double (&number)[kCount],
                              OutsideChoice<kCount>& chosen) {
  const u32 first = scene.outside_first;
  const double outside = static_cast<double>(scene.outside_share);
  double place[kCount];
  for (u32 i = 0; i < kCount; ++i) {
    place[i] = number[i] / outside;
    chosen.light[i] = first;
    chosen.share[i] = scene.lights[first].share;
  }
  for (u32 l = first; l + 1 < scene.smooth_first; ++l) {  // they are few
    const float share = scene.lights[l].share, next = scene.lights[l + 1].share;
    for (u32 i = 0; i < kCount; ++i) {
      const double left = place[i] - static_cast<double>(share);
      const bool passes = (chosen.light[i] == l) & !(place[i] < static_cast<double>(share));
      chosen.light[i] = passes ? l + 1 : chosen.light[i];
      chosen.share[i] = passes ? next : chosen.share[i];
      place[i] = passes ? left : place[i];
    }
  }
  for (u32 i = 0; i < kCount; ++i) {
    chosen.u[i] = unused(place[i] / static_cast<double>(chosen.share[i]));
  }
}

PH_INLINE LightPick pick_light(const SceneView& scene, const Receiver& from,
                               const Highlight& highlight, double number) {
  if (number >= static_cast<double>(scene.outside_share)) {
    return pick_inside(
        scene, choose_light(scene.light_tree, from, highlight, number_inside(scene, number)));
  }
  OutsideChoice<1> chosen;
  choose_outside(scene, {number}, chosen);
  return chosen.pick(scene, 0);
}

PH_INLINE DirectSample record_sample(const LightSample& s) {
  return {s.direction, s.distance, s.pdf, s.radiance, s.delta, kNoSlot};
}

// A direction towards the light that was picked; v: the second number that places the point.
PH_INLINE DirectSample sample_pick(const SceneView& scene, const LightPick& pick, Vec3 from,
                                   float v) {
  const Vec2 u = {pick.u, v};
  DirectSample out = {{0, 0, 1}, 0.0f, 0.0f, {0, 0, 0}, false, kNoSlot};
  if (pick.record != kNone) {
    out = record_sample(sample_light(scene.lights[pick.record], scene.tables, from, u));
  } else if (pick.slot.leaf != kNone) {
    const Instance* instance = instance_of(scene, pick.slot);
    const Vec3 origin = instance ? transform_point(instance->to_group, from) : from;
    out = with_primitive(scene, pick.slot, [&](const auto& shape, u32 id) {
      const TowardsSample t = sample_towards(shape, origin, u);
      return emitter_sample(scene, pick.slot, instance, shape, id, origin, t);
    });
  }
  out.pdf *= pick.probability;
  return out;
}

PH_INLINE DirectSample sample_lights(const SceneView& scene, const Receiver& from, Vec2 point,
                                     float lower) {
  const LightPick pick = pick_light(scene, from, kNoHighlight, light_number(point.x, lower));
  return sample_pick(scene, pick, from.point, point.y);
}

// Directions towards primitives of one kind from sixteen points, as sample_towards finds them.
template <class Shape>
PH_APART inline void sample_towards(const Rows<Shape, kBatch>& __restrict shape,
                                    const Rows<Receiver, kBatch>& __restrict from,
                                    const float (&__restrict draws)[2][kBatch],
                                    Rows<TowardsSample, kBatch>& __restrict towards) {
  for (u32 i = 0; i < kBatch; ++i) {
    towards.set(i, sample_towards(shape.at(i), from.at(i).point, {draws[0][i], draws[1][i]}));
  }
}

}  // namespace parhelion::PH_ISA
