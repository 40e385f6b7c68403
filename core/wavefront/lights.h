// Light: which of them surfaces ask, how much of it they scatter, and whether it arrives.
#pragma once
#include "../ray_batch.h"
#include "draws.h"

namespace parhelion::PH_ISA {

// Up to so many lights are weighed for sixteen points at once, one after the other; of more,
// sixteen at once for each point.
inline constexpr u32 kFewLights = 8;

// Primitives of one kind, of the scene itself, that are asked for light.
template <class Shape>
struct PickedLights {
  Rows<Shape, kBatch>& shape;
  u32 id[kBatch] = {};
  u32 lanes = 0;

  // Takes the light that lane k has picked, if it is one of these, and says so.
  template <class Block>
  PH_INLINE bool take(const Block* blocks, ShapeKind kind, const LightPick& p, u32 k) {
    const Slot slot = p.slot;
    if (p.record != kNone || slot.leaf == kNone || slot.instance != kNone) return false;
    if (leaf_kind(slot.leaf) != kind) return false;
    const Block& block = blocks[slot.leaf & kLeafIndexMask];
    shape.set(k, primitive(block, slot.lane));
    id[k] = block.id[slot.lane];
    lanes |= 1u << k;
    return true;
  }
  PH_INLINE void sample(const SceneView& scene, const LightPick (&pick)[kBatch],
                        const float (&place)[2][kBatch], Vertices& v) {
    if (lanes == 0) return;
    Rows<TowardsSample, kBatch> towards;
    sample_towards(shape, v.receiver, place, towards);
    for_each_bit(lanes, [&](u32 k) {
      DirectSample light = emitter_sample(scene, pick[k].slot, nullptr, shape.at(k), id[k],
                                          v.receiver.at(k).point, towards.at(k));
      light.pdf *= pick[k].probability;
      v.set_light(k, light);
    });
  }
};

// The lanes that light is sent to, of those that asked for some.
PH_APART inline u32 find_lit(const Vertices& __restrict v, u32 asked) {
  u32 lit[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const bool shines = !black(v.radiance.at(k));
    lit[k] = (shines & (v.light_pdf[k] > 0.0f)) ? 1 : 0;
  }
  return having(1, lit, asked);
}

// Light samples for those that ask for one; returns the lanes of those that get any.
inline u32 ask(const SceneView& scene, u32 lanes, const BounceDraws& draws, Vertices& v) {
  const LightTreeView& tree = scene.light_tree;
  const bool few = tree.light_count != 0 && tree.light_count <= kFewLights;
  const double outside = static_cast<double>(scene.outside_share);
  double number[kBatch];
  for (u32 k = 0; k < kBatch; ++k) number[k] = light_number(draws.point[0][k], draws.light[k]);
  OutsideChoice<kBatch> outsiders;
  if (outside > 0.0) choose_outside(scene, number, outsiders);
  u32 chosen[kBatch];
  float probability[kBatch], left[kBatch];
  if (few) {
    double inside[kBatch];
    for (u32 k = 0; k < kBatch; ++k) inside[k] = number_inside(scene, number[k]);
    choose_lights(tree, v.receiver, v.highlight, v.glossy != 0, inside, chosen, probability, left);
  }
  // Those to which directions are found for all at once.
  LightPick picks[kBatch];
  float place[2][kBatch] = {};  // of the point on the light
  PickedLights<Triangle> triangles = {v.light_triangle};
  PickedLights<Sphere> spheres = {v.light_sphere};
  PanoramaBatch<kBatch> panoramas;
  u32 around[kBatch], around_count = 0;
  for_each_bit(lanes, [&](u32 k) {
    LightPick& pick = picks[k];
    if (number[k] < outside) {
      pick = outsiders.pick(scene, k);
    } else if (few) {
      pick = pick_inside(scene, {chosen[k], probability[k], left[k]});
    } else {
      pick = pick_inside(scene, choose_light(tree, v.receiver.at(k), v.highlight.at(k),
                                             number_inside(scene, number[k])));
    }
    place[0][k] = pick.u, place[1][k] = draws.point[1][k];
    if (triangles.take(scene.triangles, ShapeKind::triangle, pick, k)) return;
    if (spheres.take(scene.spheres, ShapeKind::sphere, pick, k)) return;
    if (pick.record != kNone && is_panorama(scene.lights[pick.record])) {
      const LightRecord& record = scene.lights[pick.record];
      panoramas.set(around_count, scene.tables.images[record.image],
                    scene.tables.distributions[record.distribution],
                    is_latlong(from_block<Envmap>(record.block)), {place[0][k], place[1][k]});
      around[around_count++] = k;
    } else {
      v.set_light(k, sample_pick(scene, pick, v.receiver.at(k).point, place[1][k]));
    }
  });
  if (around_count != 0) panoramas.sample(around_count);
  for (u32 i = 0; i < around_count; ++i) {
    const LightPick& pick = picks[around[i]];
    const LightRecord& record = scene.lights[pick.record];
    DirectSample light = record_sample(
        from_panorama(from_block<Envmap>(record.block), record, panoramas.sampled(i)));
    light.pdf *= pick.probability;
    v.set_light(around[i], light);
  }
  triangles.sample(scene, picks, place, v);
  spheres.sample(scene, picks, place, v);
  return find_lit(v, lanes);
}

// Before materials say how much of the light they scatter, the lanes where it may be scattered so,
// and after it those that scatter any.
PH_APART inline u32 look_towards_lights(const Paths& __restrict paths, u32 lanes,
                                        Vertices& __restrict v) {
  u32 fits[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 wo = -paths.direction.at(k), light = v.to_light.at(k), local_wo = v.local_wo.at(k);
    const Vec3 wi = to_local(v.frame.at(k), light);
    v.local_wi.set(k, wi);
    fits[k] = consistent(v.normal.at(k), wo, light, local_wo, wi) ? 1 : 0;
  }
  return having(1, fits, lanes);
}
PH_APART inline u32 weigh_lights(u32 lanes, Vertices& v) {
  u32 bright[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const BsdfValue f = v.scattered.at(k);
    const float weight = v.light_delta[k] != 0 ? 1.0f : power_heuristic(v.light_pdf[k], f.pdf);
    v.value.set(k, f.value * v.radiance.at(k));
    v.scale[k] = weight / v.light_pdf[k];
    bright[k] = black(f.value) ? 0 : 1;
  }
  return having(1, bright, lanes);
}

// Of some lanes those whose light comes from the side that is seen.
PH_APART inline u32 lit_in_front(const Paths& __restrict paths, u32 lanes,
                                 const Vertices& __restrict v) {
  u32 front[kBatch];
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 normal = v.normal.at(k);
    front[k] = dot(paths.direction.at(k), normal) * dot(v.to_light.at(k), normal) < 0.0f ? 1 : 0;
  }
  return having(1, front, lanes);
}

// How much of the light surfaces scatter towards wo; returns the lanes of those that do any, and of
// those of `shared` that may do so towards elsewhere.
inline u32 weigh(const Paths& paths, const Kinds& kinds, u32 lanes, u32 shared, Vertices& v) {
  const u32 lit = look_towards_lights(paths, lanes, v);
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    plain_and_others<Material>(
        kinds, own & lit,
        [&]<class Form>(u32 plain, const auto& these) {
          Rows<TableBlock, kBatch> tables = {};
          if constexpr (NeedsTables<Form>) look_up<Form>(plain, v, v.local_wi, tables);
          value_of_plain<Form>(these, tables, v);
        },
        [&](u32 k) {
          const Material material = v.parameters<Material>(k);
          const Vec3 wo = v.local_wo.at(k), wi = v.local_wi.at(k);
          if constexpr (Prepares<Material>) {
            const auto& seen = v.prepared[k].template as<decltype(prepare(material, wo))>();
            v.scattered.set(k, value_of(material, seen, wo, wi));
          } else {
            v.scattered.set(k, value_of(material, wo, wi));
          }
        });
  });
  const u32 bright = weigh_lights(lit, v);
  if ((shared & lanes) == 0) return bright;
  const u32 front = lit_in_front(paths, shared & lanes, v);
  for_each_bit(front & ~bright, [&](u32 k) {
    v.value.set(k, Vec3{0, 0, 0});
    v.scale[k] = 0.0f;
  });
  return bright | front;
}

// Rays from surfaces towards their lights.
struct ShadowRays {
  Rows<Vec3, kBatch> origin;
  u32 inward[kBatch];

  PH_INLINE Ray at(u32 k, const Paths& p, const Vertices& v) const {
    return {origin.at(k), v.to_light.at(k), p.slot.at(k), inward[k] != 0};
  }
};

PH_APART inline void find_shadow_rays(const Vertices& __restrict v, ShadowRays& __restrict rays) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 normal = v.normal.at(k);
    const bool behind = dot(v.to_light.at(k), normal) < 0.0f;
    rays.origin.set(k, ray_origin(v.point.at(k), normal, v.error[k], behind));
    rays.inward[k] = (behind ? 1u : 0u) ^ v.inside_out[k];
  }
}

// What arrives, before and after bodies take their part.
PH_APART inline void find_received(const Vertices& __restrict v,
                                   Rows<Vec3, kBatch>& __restrict received) {
  for (u32 k = 0; k < kBatch; ++k) received.set(k, v.value.at(k) * v.through.at(k) * v.scale[k]);
}
PH_APART inline void add_received(const u32 (&__restrict these)[kBatch], float most_indirect,
                                  const Rows<Vec3, kBatch>& __restrict received,
                                  Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 before = p.sum.at(k), light = p.throughput.at(k) * received.at(k);
    const Vec3 after = before + bounded(light, p.depth[k], most_indirect);
    p.sum.set(k, select(these[k] != 0, after, before));
  }
}

// Adds the light that arrives at some surfaces, through the bodies that it reaches them in; returns
// the lanes of those where it does.
inline u32 receive(const SceneView& scene, const RenderView& view, u32 transmitting, u32 lanes,
                   Paths& p, Vertices& v, PathStats& stats) {
  ShadowRays rays;
  find_shadow_rays(v, rays);
  for (u32 k = 0; k < kBatch; ++k) v.through.set(k, Vec3{1, 1, 1});
  u32 arriving = 0;
  const auto ray_at = [&](u32 k) { return rays.at(k, p, v); };
  if (scene.has_holes) {
    for_each_bit(lanes, [&](u32 k) {
      v.through.set(k, transmittance(scene, ray_at(k), v.light_distance[k], v.light_slot[k],
                                     view.tree, stats));
      if (!black(v.through.at(k))) arriving |= 1u << k;
    });
  } else {
    stats.rays += compiler::ones(lanes);
    const u32 hidden = timed(stats, [&] {
      return occluded_each(
          scene, v.to_light, lanes, ray_at, v.light_distance,
          [&](u32 k) { return v.light_slot[k]; }, view.tree);
    });
    arriving = lanes & ~hidden;
  }
  if (arriving == 0) return 0;
  Rows<Vec3, kBatch> received;
  find_received(v, received);
  for_each_bit(arriving, [&](u32 k) {
    const float wo_z = v.local_wo.at(k).z, distance = v.light_distance[k];
    const bool crosses = (transmitting >> k & 1u) != 0 && v.local_wi.at(k).z * wo_z < 0.0f;
    // A body that a ray leaves the scene from has no far side, for this ray as for the path's own.
    if (!finite(distance) || (p.media[k].count == 0 && !crosses)) return;
    Media media = p.media[k];
    if (crosses) cross_boundary(scene, media, *v.record[k], wo_z > 0.0f);
    Vec3 left = received.at(k);
    absorb(scene, media, distance, left);
    received.set(k, left);
  });
  u32 these[kBatch];
  spread(arriving, these);
  add_received(these, view.clamp_indirect, received, p);
  return arriving;
}

}  // namespace parhelion::PH_ISA
