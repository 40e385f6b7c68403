// Paths of pixels close by that use each other's light: P. Bekaert, M. Sbert and J. Halton,
// "Accelerating Path Tracing by Re-Using Paths", EGWR 2002.
//
// A group is one sample of each of a few pixels. What a path has found from its second surface on
// can be seen from the first surfaces of the others, too, where nothing lies in between, or nothing
// but holes. By the balance heuristic each of them gets its share: its own density of going there,
// past these, over the sum of all that could. What is clear lies in nobody's way, as it colours.
// First surfaces are opaque ones in plain forms. Of second ones it is the matte part that is
// shared, which sends the same light towards everywhere, but for what a boundary above lets out
// there (let_out in bsdf.h). What is glossy there or was mirrored by either of the two stays with
// its path, and so does all that other paths have found. Who shares what depends on the two
// surfaces alone, never on which way a path went on from the first or what it found beyond the
// second, or means would differ. (But for the width at which a texture of the second is seen, that
// of the path which was there.)
#pragma once
#include "../ray_batch.h"
#include "kinds.h"

namespace parhelion::PH_ISA {

// Paths of a group, at most.
inline constexpr u32 kReused = kBatch;
// Of the least of red, green and blue that a first surface scatters: less does not tell what came.
inline constexpr float kLeastShare = 1.0f / 256.0f;

template <class Form>
concept HasMatte = requires(const Form& f, Vec3 wo) { let_out(f, wo); };

struct PathGroup {
  u32 x[kReused], y[kReused], sample, count;
  u32 going;  // paths that have not ended
  // First surfaces, bits in `starts` for those that there are: where rays leave them, the normals
  // on the side of these rays, of the surface and of its frame, and their paths' throughput there.
  u32 starts;
  Kinds kinds;
  PlainSurfaces first;
  Rows<Vec3, kReused> start, side, facing, throughput;
  Slot self[kReused];
  bool inward[kReused];
  u32 mirrored;  // paths, as bits, that the first surface has mirrored
  // Second surfaces, bits in `joins`, both of their normals on the side that was met.
  u32 joins;
  Kinds end_kinds;
  Rows<PlainBlock, kReused> end_plain;
  Rows<Vec3, kReused> end, end_side, end_facing;
  Slot end_slot[kReused];
  u32 end_front;  // those of them, as bits, that were met on their front
  // What paths have gathered: what is theirs alone, and what the second surface's matte part has
  // scattered; and what share of the rest it will have.
  Rows<Vec3, kReused> own, shared, onward;

  PH_INLINE void clear() {
    count = going = starts = mirrored = joins = end_front = 0;
    kinds = end_kinds = {};
    own = shared = onward = {};
  }
};

PH_INLINE PathGroup& group_of(const Wave& wave, u32 k) {
  return wave.groups[wave.paths.tag[k] / kReused];
}

// Calls f.operator()<Form>(number, lanes) for each plain form that lets no light through, and those
// at it.
template <class F>
PH_INLINE void for_each_opaque_form(const Kinds& kinds, F&& f) {
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    for_each_plain_form<Material>([&]<class Form>(u32 number) {
      const u32 these = own & kinds.plain[number];
      if constexpr (!kTransmits<Material> || HasMatte<Form>) {
        if (these != 0) f.template operator()<Form>(number, these);
      }
    });
  });
}
// Of those, for each that may share its light.
template <class F>
PH_INLINE void for_each_matte_form(const Kinds& kinds, F&& f) {
  for_each_opaque_form(kinds, [&]<class Form>(u32 number, u32 lanes) {
    if constexpr (HasMatte<Form>) f.template operator()<Form>(number, lanes);
  });
}

// Notes the second surfaces of paths before light is added there; returns those paths.
inline u32 join_groups(Wave& wave, const Kinds& kinds, const Vertices& v) {
  Paths& p = wave.paths;
  u32 joining = 0;
  for_each_matte_form(kinds, [&]<class Form>(u32 number, u32 lanes) {
    for_each_bit(lanes, [&](u32 k) {
      // Shadow rays to a point pass the primitive that it lies on.
      if (p.depth[k] != 2 || may_hide_itself(leaf_kind(p.slot.at(k).leaf))) return;
      PathGroup& g = group_of(wave, k);
      const u32 i = p.tag[k] % kReused, bit = 1u << i;
      if ((g.starts & ~g.mirrored & ~g.joins & bit) == 0) return;
      const float side = v.front[k] != 0 ? 1.0f : -1.0f;
      g.joins |= bit;
      g.end_kinds.lanes[v.block[k]->kind] |= bit;
      g.end_kinds.plain[number] |= bit;
      g.end_plain.set(i, v.plain.at<Form>(k));
      g.end.set(i, v.point.at(k));
      g.end_side.set(i, v.normal.at(k) * side);
      g.end_facing.set(i, v.shading.at(k) * side);
      g.end_slot[i] = p.slot.at(k);
      g.end_front |= v.front[k] != 0 ? bit : 0;
      g.own.set(i, p.sum.at(k));
      p.sum.set(k, Vec3{0, 0, 0});
      joining |= 1u << k;
    });
  });
  return joining;
}

// Notes the first surfaces of paths before they go on from there.
inline void start_groups(const Wave& wave, const Kinds& kinds, const Vertices& v) {
  const Paths& p = wave.paths;
  for_each_opaque_form(kinds, [&]<class Form>(u32 number, u32 lanes) {
    for_each_bit(lanes, [&](u32 k) {
      if (p.depth[k] != 1 || p.media[k].count != 0) return;
      PathGroup& g = group_of(wave, k);
      const u32 i = p.tag[k] % kReused, bit = 1u << i;
      const Vec3 normal = v.normal.at(k);
      const bool behind = v.front[k] == 0;
      g.starts |= bit;
      g.kinds.lanes[v.block[k]->kind] |= bit;
      g.kinds.plain[number] |= bit;
      copy_lane(g.first.plain, i, v.plain, k);
      copy_lane(g.first.from, i, v.from, k);
      copy_lane(g.first.frame, i, v.frame, k);
      copy_lane(g.first.local_wo, i, v.local_wo, k);
      g.start.set(i, ray_origin(v.point.at(k), normal, v.error[k], behind));
      g.side.set(i, normal * (behind ? -1.0f : 1.0f));
      g.facing.set(i, v.frame.at(k).z * copysign(1.0f, v.local_wo.at(k).z));
      g.throughput.set(i, p.throughput.at(k));
      g.self[i] = p.slot.at(k);
      g.inward[i] = behind != (v.inside_out[k] != 0);
    });
  });
}

// What share of the light that a surface scatters from wo towards wi its matte part does.
template <HasMatte Form>
PH_INLINE Vec3 matte_share(const PlainSurfaces& v, u32 k, Vec3 wi) {
  static_assert(NeedsTables<Form> || !HasGloss<Form>, "what is glossy has to be told apart");
  if constexpr (NeedsTables<Form>) {
    const Form form = v.plain.at<Form>(k);
    const auto seen = v.from.at<typename Form::From>(k);
    const auto tables = to(form, wi);
    const Vec3 wo = v.local_wo.at(k), part = matte(form, seen, tables, wo, wi);
    const Vec3 all = evaluate(form, seen, tables, wo, wi).value;
    const auto share = [](float a, float b) { return b > 0.0f ? min(a / b, 1.0f) : 1.0f; };
    return {share(part.x, all.x), share(part.y, all.y), share(part.z, all.z)};
  }
  return {1, 1, 1};
}

// Takes what paths that have just joined gathered at their second surfaces apart, and notes which
// have been mirrored.
inline void divide_light(Wave& wave, const Kinds& kinds, const Vertices& v, u32 joining,
                         u32 mirrored) {
  Paths& p = wave.paths;
  for_each_bit(mirrored, [&](u32 k) {
    if (p.depth[k] == 2) group_of(wave, k).mirrored |= 1u << p.tag[k] % kReused;
  });
  for_each_matte_form(kinds, [&]<class Form>(u32, u32 lanes) {
    for_each_bit(lanes & joining, [&](u32 k) {
      PathGroup& g = group_of(wave, k);
      const u32 i = p.tag[k] % kReused;
      const Vec3 light = p.sum.at(k);
      const Vec3 shared = black(light) ? light : light * matte_share<Form>(v, k, v.local_wi.at(k));
      g.shared.set(i, shared);
      g.own.set(i, g.own.at(i) + (light - shared));
      p.sum.set(k, Vec3{0, 0, 0});
      if ((mirrored >> k & 1u) != 0) return;
      g.onward.set(i, matte_share<Form>(v, k, to_local(v.frame.at(k), p.direction.at(k))));
    });
  });
}

// Notes what a path has gathered that ends; true for the last of its group.
PH_INLINE bool leave_group(PathGroup& g, u32 i, Vec3 light) {
  const Vec3 shared = light * g.onward.at(i);
  g.shared.set(i, g.shared.at(i) + shared);
  g.own.set(i, g.own.at(i) + (light - shared));
  return --g.going == 0;
}

// Ways from all first surfaces of a group to one of the second: the density of going there, per
// area, 0 where that could not be, and what share of the second surface's light goes on.
struct Ways {
  Rows<Vec3, kReused> direction, share;
  float distance[kReused], density[kReused];
  float per_angle[kReused];  // density per area over that per solid angle; 0 as above
  float cosine[kReused];     // at the second surface, in its frame
  float let_out[kReused] = {};
};

PH_APART inline void find_ways(PathGroup& __restrict g, u32 j, Ways& __restrict ways) {
  const Vec3 end = g.end.at(j), end_side = g.end_side.at(j), end_facing = g.end_facing.at(j);
  for (u32 i = 0; i < kReused; ++i) {
    const Vec3 way = end - g.start.at(i);
    const float square = dot(way, way), distance = sqrt(square);
    const Vec3 direction = renormalize(way * (1.0f / distance));
    const float leaves = dot(direction, g.facing.at(i)), arrives = -dot(direction, end_side);
    // Where the second surface's normal would be bent it sends another light.
    const bool same = !is_bent(end_facing, end_side, -direction);
    const bool can =
        same & (leaves > 0.0f) & (arrives > 0.0f) & (dot(direction, g.side.at(i)) > 0.0f);
    g.first.local_wi.set(i, to_local(g.first.frame.at(i), direction));
    ways.direction.set(i, direction);
    ways.distance[i] = distance;
    ways.per_angle[i] = can ? arrives / square : 0.0f;
    ways.cosine[i] = -dot(direction, end_facing);
  }
}

template <HasMatte Form>
PH_APART inline void find_let_out(const Form& form, u32 lanes, Ways& __restrict ways) {
  if constexpr (NeedsTables<Form>) {
    for_each_bit(lanes,
                 [&](u32 i) { ways.let_out[i] = let_out(form, Vec3{0, 0, ways.cosine[i]}); });
  } else {
    for (u32 i = 0; i < kReused; ++i) ways.let_out[i] = let_out(form, Vec3{0, 0, ways.cosine[i]});
  }
}

PH_APART inline void weigh_ways(const PathGroup& __restrict g, Ways& __restrict ways) {
  for (u32 i = 0; i < kReused; ++i) {
    const BsdfValue f = g.first.scattered.at(i);
    const Vec3 share = g.throughput.at(i) * f.value * (1.0f / f.pdf);
    const float density = f.pdf * ways.per_angle[i];
    // The sum is neither where a density is so small that its inverse has no bound.
    const bool can = (min(share.x, min(share.y, share.z)) >= kLeastShare) &
                     (share.x + share.y + share.z < kInfinity) & (density > 0.0f) &
                     (density < kInfinity) & (ways.let_out[i] > 0.0f);
    ways.share.set(i, share * ways.let_out[i]);
    ways.density[i] = can ? density : 0.0f;
  }
}

// Of some ways to second surface j those that can be gone and that nothing is in; their densities
// become those of getting past holes, too. None if its own path's is not among them.
PH_INLINE u32 open_ways(const SceneView& scene, const RenderView& view, const PathGroup& g, u32 j,
                        u32 facing, Ways& ways, PathStats& stats) {
  const u32 own = 1u << j;
  const auto ray_at = [&](u32 i) -> Ray {
    return {g.start.at(i), ways.direction.at(i), g.self[i], g.inward[i]};
  };
  u32 open = 0;
  for_each_bit(facing | own, [&](u32 i) { open |= (ways.density[i] > 0.0f ? 1u : 0u) << i; });
  if ((open & own) == 0) return 0;
  if (!scene.has_holes) {
    const u32 others = open & ~own;
    stats.rays += compiler::ones(others);
    const u32 hidden = timed(stats, [&] {
      return occluded_each(
          scene, ways.direction, others, ray_at, ways.distance, [&](u32) { return g.end_slot[j]; },
          view.tree);
    });
    return open & ~hidden;
  }
  const auto pass = [&](u32 i) {
    ways.density[i] *= openness(scene, ray_at(i), ways.distance[i], g.end_slot[j],
                                (g.end_front & own) != 0, view.tree, stats);
    return ways.density[i] > 0.0f;
  };
  if (!pass(j)) return 0;
  u32 passed = own;
  for_each_bit(open & ~own, [&](u32 i) { passed |= (pass(i) ? 1u : 0u) << i; });
  return passed;
}

// What the samples of a group bring, all of whose paths have ended.
inline void share_out(const SceneView& scene, const RenderView& view, PathGroup& g,
                      Vec3 (&radiance)[kReused], PathStats& stats) {
  for (u32 i = 0; i < g.count; ++i) radiance[i] = g.own.at(i);
  for_each_bit(g.joins, [&](u32 j) {
    const Vec3 shared = g.shared.at(j);
    if (black(shared)) return;
    Ways ways;
    find_ways(g, j, ways);
    u32 facing = 0;
    for_each_bit(g.starts, [&](u32 i) { facing |= (ways.per_angle[i] > 0.0f ? 1u : 0u) << i; });
    for_each_matte_form(g.end_kinds, [&]<class Form>(u32, u32 these) {
      if ((these >> j & 1u) != 0) find_let_out(g.end_plain.at<Form>(j), facing, ways);
    });
    for_each_opaque_form(g.kinds, [&]<class Form>(u32, u32 lanes) {
      Rows<TableBlock, kReused> tables = {};
      if constexpr (NeedsTables<Form>) {
        look_up<Form>(lanes & facing, g.first, g.first.local_wi, tables);
      }
      u32 these[kReused];
      spread(lanes, these);
      value_of_plain<Form>(these, tables, g.first);
    });
    weigh_ways(g, ways);
    const u32 seen = finite(shared) ? open_ways(scene, view, g, j, facing, ways, stats) : 0;
    if ((seen >> j & 1u) == 0) {
      radiance[j] += shared;
      return;
    }
    float sum = ways.density[j];
    for_each_bit(seen & ~(1u << j), [&](u32 i) { sum += ways.density[i]; });
    const Vec3 own = ways.share.at(j);
    const Vec3 light = {shared.x / own.x, shared.y / own.y, shared.z / own.z};
    for_each_bit(seen, [&](u32 i) {
      radiance[i] +=
          bounded(ways.share.at(i) * light * (ways.density[i] / sum), 2, view.clamp_indirect);
    });
  });
}

}  // namespace parhelion::PH_ISA
