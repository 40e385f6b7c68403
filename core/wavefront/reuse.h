// Paths of pixels close by that use each other's light: P. Bekaert, M. Sbert and J. Halton,
// "Accelerating Path Tracing by Re-Using Paths", EGWR 2002.
//
// A group is one sample of each of a few pixels. What a path has found from its second surface on
// can be seen from the first surfaces of the others, too, where nothing lies in between, or nothing
// but holes. By the balance heuristic each of them gets its share: its own density of going there,
// past these, over the sum of all that could. What is clear lies in nobody's way, as it colours.
// Both surfaces are opaque ones in plain forms. A matte second surface sends the same light towards
// everywhere, but for what a boundary above lets out there (let_out in bsdf.h). Of any other it is
// worked out what it scatters towards each of the first ones, of a light sample and of what came
// from where its path went on; the latter by the joint density of going to the second surface and
// on from there. Light samples and lights that were met are weighed against each other as if each
// path had been there. What was mirrored by either of the two surfaces stays with its path, and so
// does all that other paths have found. Who shares what depends on the surfaces and the way between
// them alone, and which light the second asks not even on where it is seen from, or weights would
// not add up to one and means would differ. (But for the width at which a texture of the second is
// seen, that of the path which was there.)
#pragma once
#include "../ray_batch.h"
#include "kinds.h"

namespace parhelion::PH_ISA {

// Paths of a group, at most.
inline constexpr u32 kReused = kBatch;
// Of the least of red, green and blue that a first surface scatters: less does not tell what came.
inline constexpr float kLeastShare = 1.0f / 256.0f;
// And of a glossy second one, over the density of being sampled; and of the latter, by itself and
// times that of going there, as the inverse of less has no bound.
inline constexpr float kLeastSent = 1e-12f, kLeastSentDensity = 1e-30f;

// Forms that scatter alike towards everywhere, but for a mirror image and what they let out there.
template <class Form>
concept IsMatte = requires(const Form& f, Vec3 wo) { let_out(f, wo); };

struct PathGroup {
  u32 x[kReused], y[kReused], sample, count;
  u32 going;  // paths that have not ended
  // First surfaces, bits in `starts` for those that there are: where rays leave them, the normals
  // on the side of these rays, of the surface and of its frame, and their paths' throughput there.
  // A path's first surface is the first that is no mere mirror or clear glass, its second the next.
  u32 fresh;  // paths that have not come to one
  u32 starts, depth[kReused];
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
  u32 bends;      // and those whose normals may be bent otherwise towards each that sees them
  u32 matte;      // those that scatter alike towards all, and from which a path has gone on
  // Of the others, which scatter otherwise towards each, the frames; bits in `lit` for those that a
  // light sample has reached: the way to the light, its density, which does not count for `delta`
  // ones, and what has reached them over that, as much as their paths bring of it; in `sends` for
  // those from which a path has gone on: where to; in `deep` if it has met a surface there; in
  // `meets` if that or the surroundings shine: as much as the path brings of it, and the density of
  // light samples there, or 0.
  u32 lit, delta, sends, deep, meets;
  Rows<Frame, kReused> end_frame;
  Rows<Vec3, kReused> to_light, light, beyond, met;
  float light_pdf[kReused], met_pdf[kReused];
  // What paths have gathered: what is theirs alone, what is shared of the second surface, and what
  // of it light samples there have brought, and lights that have been met after it.
  Rows<Vec3, kReused> own, shared, sampled, weighed;

  PH_INLINE void clear() {
    count = going = starts = mirrored = joins = end_front = bends = matte = 0;
    lit = delta = sends = deep = meets = 0;
    kinds = end_kinds = {};
    own = shared = sampled = weighed = {};
    fresh = ~0u;
  }
};

PH_INLINE PathGroup& group_of(const Wave& wave, u32 k) {
  return wave.groups[wave.paths.tag[k] / kReused];
}

// Component by component; 0 where there is nothing.
PH_INLINE Vec3 ratio(Vec3 a, Vec3 b) {
  const auto over = [](float x, float y) { return y > 0.0f ? x / y : 0.0f; };
  return {over(a.x, b.x), over(a.y, b.y), over(a.z, b.z)};
}

// Calls f.operator()<Form>(number, lanes) for each plain form that lets no light through, and those
// at it.
template <class F>
PH_INLINE void for_each_opaque_form(const Kinds& kinds, F&& f) {
  for_each_kind(kinds, [&]<class Material>(u32 own) {
    for_each_plain_form<Material>([&]<class Form>(u32 number) {
      const u32 these = own & kinds.plain[number];
      if constexpr (!kTransmits<Material> || requires { Form::opaque; }) {
        if (these != 0) f.template operator()<Form>(number, these);
      }
    });
  });
}

// Paths that are at their second surfaces and share these, as bits; and those of them where that is
// not matte.
struct Joining {
  u32 all = 0, glossy = 0;
};

// Those of some paths that their first surface has not mirrored, but sent to another one.
PH_INLINE u32 at_second(const Wave& wave, u32 lanes) {
  const Paths& p = wave.paths;
  u32 found = 0;
  for_each_bit(lanes, [&](u32 k) {
    const PathGroup& g = group_of(wave, k);
    const u32 i = p.tag[k] % kReused;
    const bool sent = ((g.starts & ~g.mirrored) >> i & 1u) != 0;
    found |= (sent && p.depth[k] == g.depth[i] + 1 ? 1u : 0u) << k;
  });
  return found;
}

// Notes the second surfaces of paths that are there before light is added.
inline Joining join_groups(Wave& wave, const Kinds& kinds, u32 seconds, const Vertices& v) {
  Paths& p = wave.paths;
  Joining joining;
  for_each_opaque_form(kinds, [&]<class Form>(u32 number, u32 lanes) {
    for_each_bit(lanes & seconds, [&](u32 k) {
      // Shadow rays to a point pass the primitive that it lies on.
      if (may_hide_itself(leaf_kind(p.slot.at(k).leaf))) return;
      PathGroup& g = group_of(wave, k);
      const u32 i = p.tag[k] % kReused, bit = 1u << i;
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
      // What is matte sends the same light towards all that see it with the same normal.
      g.bends |= !IsMatte<Form> && (v.traits[k] & kUsesUv) == 0 ? bit : 0;
      g.end_frame.set(i, v.frame.at(k));
      g.own.set(i, p.sum.at(k));
      p.sum.set(k, Vec3{0, 0, 0});
      joining.all |= 1u << k;
      if (!IsMatte<Form>) joining.glossy |= 1u << k;
    });
  });
  return joining;
}

// Notes what light samples have brought to some of these, before their paths go on.
inline void note_lights(Wave& wave, const Vertices& v, u32 lanes) {
  Paths& p = wave.paths;
  for_each_bit(lanes, [&](u32 k) {
    PathGroup& g = group_of(wave, k);
    const u32 i = p.tag[k] % kReused, bit = 1u << i;
    g.lit |= bit;
    g.delta |= v.light_delta[k] != 0 ? bit : 0;
    g.to_light.set(i, v.to_light.at(k));
    const Vec3 arrived = v.radiance.at(k) * v.through.at(k) * (1.0f / v.light_pdf[k]);
    g.light.set(i, p.throughput.at(k) * arrived);
    g.light_pdf[i] = v.light_pdf[k];
    g.sampled.set(i, p.sum.at(k));
    p.sum.set(k, Vec3{0, 0, 0});
  });
}

// Notes the first surfaces of paths before they go on from there.
inline void start_groups(const Wave& wave, const Kinds& kinds, u32 rough, const Vertices& v) {
  const Paths& p = wave.paths;
  for_each_opaque_form(kinds, [&]<class Form>(u32 number, u32 lanes) {
    for_each_bit(lanes & rough, [&](u32 k) {
      PathGroup& g = group_of(wave, k);
      const u32 i = p.tag[k] % kReused, bit = 1u << i;
      if ((g.fresh & bit) == 0 || p.media[k].count != 0) return;
      const Vec3 normal = v.normal.at(k);
      const bool behind = v.front[k] == 0;
      g.starts |= bit;
      g.depth[i] = p.depth[k];
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
  for_each_bit(rough, [&](u32 k) { group_of(wave, k).fresh &= ~(1u << p.tag[k] % kReused); });
}

// Takes what paths that have just joined gathered at matte second surfaces, and notes which way
// others go on from theirs; and which paths the first surfaces have mirrored.
inline void divide_light(Wave& wave, const Joining& joining, u32 mirrored) {
  Paths& p = wave.paths;
  for_each_bit(at_second(wave, mirrored),
               [&](u32 k) { group_of(wave, k).mirrored |= 1u << p.tag[k] % kReused; });
  for_each_bit(joining.all, [&](u32 k) {
    PathGroup& g = group_of(wave, k);
    const u32 i = p.tag[k] % kReused, scattered = (~mirrored >> k & 1u) << i;
    if ((joining.glossy >> k & 1u) != 0) {
      g.sends |= scattered;
      g.beyond.set(i, p.direction.at(k));
    } else {
      g.matte |= scattered;
      g.shared.set(i, p.sum.at(k));
      p.sum.set(k, Vec3{0, 0, 0});
    }
  });
}

// Notes a light that a path has met after its glossy second surface.
PH_INLINE void note_met(PathGroup& g, u32 i, Paths& p, u32 k, const LightSight& sight) {
  g.meets |= 1u << i;
  g.met.set(i, p.throughput.at(k) * sight.radiance);
  g.met_pdf[i] = sight.pdf;
  g.weighed.set(i, p.sum.at(k));
  p.sum.set(k, Vec3{0, 0, 0});
}
// Calls f(group, i, k) for those of some paths that have just come from such a surface.
template <class F>
PH_INLINE void for_each_sent(Wave& wave, u32 lanes, F&& f) {
  for_each_bit(lanes, [&](u32 k) {
    PathGroup& g = group_of(wave, k);
    const u32 i = wave.paths.tag[k] % kReused;
    if ((g.sends >> i & 1u) != 0 && wave.paths.depth[k] == g.depth[i] + 2) f(g, i, k);
  });
}
// At the surfaces that they meet. What shines past holes on the way there is weighed by densities
// of its own, and stays with the path; so is what they see of several lights where they leave.
inline void keep_emission(const SceneView& scene, Wave& wave, const Vertices& v, u32 lanes) {
  Paths& p = wave.paths;
  for_each_sent(wave, lanes, [&](PathGroup& g, u32 i, u32 k) {
    g.deep |= 1u << i;
    if (black(p.sum.at(k))) return;
    if (scene.has_holes) {
      g.own.set(i, g.own.at(i) + p.sum.at(k));
      p.sum.set(k, Vec3{0, 0, 0});
    } else {
      note_met(g, i, p, k, emission_seen(scene, v.surface(k, p.slot.at(k)), v.emission[k], p, k));
    }
  });
}
inline void keep_sights(const SceneView& scene, Wave& wave, u32 lanes) {
  if (scene.has_holes || scene.light_count != scene.outside_first + 1) return;
  Paths& p = wave.paths;
  for_each_sent(wave, lanes, [&](PathGroup& g, u32 i, u32 k) {
    if (!black(p.sum.at(k))) note_met(g, i, p, k, outside_seen(scene, scene.outside_first, p, k));
  });
}

// Notes what a path has gathered that ends; true for the last of its group.
PH_INLINE bool leave_group(PathGroup& g, u32 i, Vec3 light) {
  Rows<Vec3, kReused>& to = ((g.matte | g.deep) >> i & 1u) != 0 ? g.shared : g.own;
  to.set(i, to.at(i) + light);
  return --g.going == 0;
}

// Ways from all first surfaces of a group to one of the second: the density of going there, per
// area, 0 where that could not be, and what share of the light that comes from there goes on.
struct Ways {
  Rows<Vec3, kReused> direction, share;
  float distance[kReused], density[kReused];
  float per_angle[kReused];  // density per area over that per solid angle; 0 as above
  float cosine[kReused];     // at the second surface, in its frame
  float let_out[kReused];    // of its light, if it is matte
};

PH_APART inline void find_ways(PathGroup& __restrict g, u32 j, Ways& __restrict ways) {
  const Vec3 end = g.end.at(j), end_side = g.end_side.at(j), end_facing = g.end_facing.at(j);
  const bool bends = (g.bends >> j & 1u) != 0;
  for (u32 i = 0; i < kReused; ++i) {
    const Vec3 way = end - g.start.at(i);
    const float square = dot(way, way), distance = sqrt(square);
    const Vec3 direction = renormalize(way * (1.0f / distance));
    const float leaves = dot(direction, g.facing.at(i)), arrives = -dot(direction, end_side);
    // Where the second surface's normal would be bent it sends another light.
    const bool same = bends | !is_bent(end_facing, end_side, -direction);
    const bool can =
        same & (leaves > 0.0f) & (arrives > 0.0f) & (dot(direction, g.side.at(i)) > 0.0f);
    g.first.local_wi.set(i, to_local(g.first.frame.at(i), direction));
    ways.direction.set(i, direction);
    ways.distance[i] = distance;
    ways.per_angle[i] = can ? arrives / square : 0.0f;
    ways.cosine[i] = -dot(direction, end_facing);
    ways.let_out[i] = 1.0f;
  }
}

template <IsMatte Form>
PH_APART inline void find_let_out(const Form& form, Ways& __restrict ways) {
  for (u32 i = 0; i < kReused; ++i) ways.let_out[i] = let_out(form, Vec3{0, 0, ways.cosine[i]});
}

// As find_frames() does (materials.h) with opaque ones; plain principled materials, whose type lets
// light pass, are the same from both sides.
PH_APART inline void bend_along(const PathGroup& __restrict g, u32 j, const Ways& __restrict ways,
                                PlainSurfaces& __restrict seen) {
  const float side = (g.end_front >> j & 1u) != 0 ? 1.0f : -1.0f;
  const Vec3 n = g.end_facing.at(j) * side, normal = g.end_side.at(j) * side;
  for (u32 i = 0; i < kReused; ++i) {
    Frame f = frame_around(bent_normal(n, normal, -ways.direction.at(i)));
    f.y *= side;
    f.z *= side;
    seen.frame.set(i, f);
  }
}
PH_APART inline void see_along(const Ways& __restrict ways, Vec3 wi,
                               PlainSurfaces& __restrict seen) {
  for (u32 i = 0; i < kReused; ++i) {
    const Frame frame = seen.frame.at(i);
    seen.local_wo.set(i, to_local(frame, -ways.direction.at(i)));
    seen.local_wi.set(i, to_local(frame, wi));
  }
}
// What a second surface scatters along all ways of the light that comes from wi, and how likely a
// path that comes along each is to go on there.
template <class Form>
inline void find_sent(const PathGroup& g, u32 j, Vec3 wi, const Ways& ways, u32 lanes,
                      Rows<BsdfValue, kReused>& sent) {
  PlainSurfaces seen = {};
  const Form form = g.end_plain.at<Form>(j);
  for (u32 i = 0; i < kReused; ++i) {
    seen.plain.set(i, form);
    seen.frame.set(i, g.end_frame.at(j));
  }
  if ((g.bends >> j & 1u) != 0) bend_along(g, j, ways, seen);
  see_along(ways, wi, seen);
  Rows<TableBlock, kReused> tables = {};
  if constexpr (NeedsTables<Form>) {
    look_up_from<Form>(lanes, seen);
    look_up<Form>(lanes, seen, seen.local_wi, tables);
  }
  u32 these[kReused];
  spread(lanes, these);
  value_of_plain<Form>(these, tables, seen);
  sent = seen.scattered;
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
    ways.share.set(i, share);
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

// Adds what a second surface sends along some ways: each gets light(i), as much as its own path
// would have, by its share of the densities.
template <class Density, class Light>
PH_INLINE void share(u32 ways, Density&& density, Light&& light, float most_indirect,
                     Vec3 (&radiance)[kReused]) {
  float sum = 0.0f;
  for_each_bit(ways, [&](u32 i) { sum += density(i); });
  for_each_bit(ways, [&](u32 i) {
    radiance[i] += bounded(light(i) * (density(i) / sum), 2, most_indirect);
  });
}

// Of what a glossy second surface sends along some ways, those that tell each other's light: what
// is next to nothing in a colour, or as a density, as Beckmann's slopes are far from a mirror
// image, does not.
PH_INLINE u32 telling(u32 seen, const Ways& ways, const Rows<BsdfValue, kReused>& sent) {
  Vec3 most = {0, 0, 0};
  for_each_bit(seen, [&](u32 i) { most = max(most, sent.at(i).value); });
  u32 found = 0;
  for_each_bit(seen, [&](u32 i) {
    const BsdfValue f = sent.at(i);
    const auto tells = [&](float value, float any) {
      return any == 0.0f || value > kLeastSent * f.pdf;
    };
    const float joint = ways.density[i] * f.pdf;
    const bool all = tells(f.value.x, most.x) && tells(f.value.y, most.y) &&
                     tells(f.value.z, most.z) && min(f.pdf, joint) > kLeastSentDensity &&
                     max(f.pdf, joint) < kInfinity;
    found |= (all ? 1u : 0u) << i;
  });
  return found;
}

// What a path found where it went on from a glossy second surface j.
PH_INLINE void share_sent(const PathGroup& g, u32 j, u32 seen, const Ways& ways,
                          const Rows<BsdfValue, kReused>& sent, float most_indirect,
                          Vec3 (&radiance)[kReused]) {
  const u32 telling_ways = telling(seen, ways, sent);
  if ((telling_ways >> j & 1u) == 0) {
    radiance[j] += g.shared.at(j) + g.weighed.at(j);
    return;
  }
  const bool meets = (g.meets >> j & 1u) != 0;
  const float asked = g.met_pdf[j];
  const Vec3 own = ways.share.at(j) * sent.at(j).value;
  share(
      telling_ways, [&](u32 i) { return ways.density[i] * sent.at(i).pdf; },
      [&](u32 i) {
        const BsdfValue f = sent.at(i);
        const float weight = asked > 0.0f ? power_heuristic(f.pdf, asked) : 1.0f;
        const Vec3 all = meets ? g.shared.at(j) + g.met.at(j) * weight : g.shared.at(j);
        return all * ratio(ways.share.at(i) * f.value, own) * (sent.at(j).pdf / f.pdf);
      },
      most_indirect, radiance);
}

// What the samples of a group bring, all of whose paths have ended.
inline void share_out(const SceneView& scene, const RenderView& view, PathGroup& g,
                      Vec3 (&radiance)[kReused], PathStats& stats) {
  for (u32 i = 0; i < g.count; ++i) radiance[i] = g.own.at(i);
  for_each_bit(g.joins, [&](u32 j) {
    const Vec3 shared = g.shared.at(j);
    const bool lit = (g.lit >> j & 1u) != 0, meets = (g.meets >> j & 1u) != 0;
    const bool found = meets || !black(shared);
    if (!found && !lit) return;
    Ways ways;
    find_ways(g, j, ways);
    u32 facing = 0;
    for_each_bit(g.starts, [&](u32 i) {
      // Else one of them would have to do with fewer surfaces further on than the other.
      const bool may = g.depth[i] == g.depth[j] && ways.per_angle[i] > 0.0f;
      facing |= (may ? 1u : 0u) << i;
    });
    bool matte = false;
    Rows<BsdfValue, kReused> of_sample, of_found;
    for_each_opaque_form(g.end_kinds, [&]<class Form>(u32, u32 these) {
      if ((these >> j & 1u) == 0) return;
      if constexpr (IsMatte<Form>) {
        matte = true;
        find_let_out(g.end_plain.at<Form>(j), ways);
      } else {
        if (lit) find_sent<Form>(g, j, g.to_light.at(j), ways, facing, of_sample);
        if (found) find_sent<Form>(g, j, g.beyond.at(j), ways, facing, of_found);
      }
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
    const bool known =
        finite(shared) && (!lit || finite(g.light.at(j))) && (!meets || finite(g.met.at(j)));
    const u32 seen = known ? open_ways(scene, view, g, j, facing, ways, stats) : 0;
    if ((seen >> j & 1u) == 0) {
      radiance[j] += shared + g.sampled.at(j) + g.weighed.at(j);
      return;
    }
    const auto density = [&](u32 i) { return ways.density[i]; };
    const float most = view.clamp_indirect;
    const Vec3 own = ways.share.at(j);
    if (matte) {
      const auto light = [&](u32 i) {
        return shared * ratio(ways.share.at(i) * ways.let_out[i], own * ways.let_out[j]);
      };
      return share(seen, density, light, most, radiance);
    }
    if (lit) {
      const bool delta = (g.delta >> j & 1u) != 0;
      const auto light = [&](u32 i) {
        const BsdfValue f = of_sample.at(i);
        const float weight = delta ? 1.0f : power_heuristic(g.light_pdf[j], f.pdf);
        return g.light.at(j) * weight * f.value * ratio(ways.share.at(i), own);
      };
      share(seen, density, light, most, radiance);
    }
    if (found) share_sent(g, j, seen, ways, of_found, most, radiance);
  });
}

}  // namespace parhelion::PH_ISA
