// Paths of pixels close by that use each other's light: P. Bekaert, M. Sbert and J. Halton,
// "Accelerating Path Tracing by Re-Using Paths", EGWR 2002.
//
// A group is one sample of each of a few pixels. What a path has found from its second surface on
// can be seen from the first surfaces of the others, too, where nothing lies in between. By the
// balance heuristic each of them gets its share: its own density of going there over the sum of all
// that could. Both surfaces have to follow Lambert's law, whose light is the same towards
// everywhere; other paths keep what they have found. Who shares what depends on the two surfaces
// alone, never on which way a path went on from the first or what it found beyond the second, or
// means would differ. (But for the width at which a texture of the second is seen, that of the path
// which was there.)
#pragma once
#include "../ray_batch.h"
#include "kinds.h"

namespace parhelion::PH_ISA {

// Paths of a group, at most.
inline constexpr u32 kReused = kBatch;
// Of the least of red, green and blue that a first surface scatters: less does not tell what came.
inline constexpr float kLeastShare = 1.0f / 256.0f;

struct PathGroup {
  u32 x[kReused], y[kReused], sample, count;
  u32 going;  // paths that have not ended
  // First surfaces, bits in `starts` for those that there are: where rays leave them, the normals
  // that face these rays, of the surface and of its frame, and what share of light goes on.
  u32 starts;
  Rows<Vec3, kReused> start, side, facing, share;
  Slot self[kReused];
  bool inward[kReused];
  // Second surfaces, bits in `joins`, both of their normals on the side that was met, and what
  // their paths had gathered before.
  u32 joins;
  Rows<Vec3, kReused> end, end_side, end_facing, before;
  Slot end_slot[kReused];
  // What paths have gathered since their second surface, or altogether where it is not shared.
  Rows<Vec3, kReused> gathered;
};

PH_INLINE PathGroup& group_of(const Wave& wave, u32 k) {
  return wave.groups[wave.paths.tag[k] / kReused];
}

// Which of the paths meet surfaces that follow Lambert's law: PlainDiffuse, the one plain form.
PH_INLINE u32 lambertian(const Kinds& kinds) {
  return kinds.lanes[static_cast<u32>(MaterialKind::diffuse)] & kinds.plain[0];
}

// Notes the second surfaces of paths, `matte` of them Lambert's, before light is added there.
inline void join_groups(Wave& wave, const Vertices& v, u32 matte) {
  Paths& p = wave.paths;
  for_each_bit(wave.alive, [&](u32 k) {
    // Shadow rays to a point pass the primitive that it lies on.
    if (p.depth[k] != 2 || may_hide_itself(leaf_kind(p.slot[k].leaf))) return;
    PathGroup& g = group_of(wave, k);
    const u32 i = p.tag[k] % kReused;
    if ((matte & 1u << k) == 0 || (g.starts & 1u << i) == 0 || (g.joins & 1u << i) != 0) return;
    const float side = v.front[k] != 0 ? 1.0f : -1.0f;
    g.joins |= 1u << i;
    g.end.set(i, v.point.at(k));
    g.end_side.set(i, v.normal.at(k) * side);
    g.end_facing.set(i, v.shading.at(k) * side);
    g.end_slot[i] = p.slot[k];
    g.before.set(i, p.sum.at(k));
    p.sum.set(k, Vec3{0, 0, 0});
  });
}

// Notes the first surfaces of paths, `matte` of them Lambert's, before paths go on from there.
inline void start_groups(const Wave& wave, const Vertices& v, u32 matte) {
  const Paths& p = wave.paths;
  for_each_bit(matte, [&](u32 k) {
    if (p.depth[k] != 1 || p.media[k].count != 0) return;
    const Vec3 share = p.throughput.at(k) * v.plain.at<PlainDiffuse>(k).color;
    if (!(min(share.x, min(share.y, share.z)) >= kLeastShare)) return;
    PathGroup& g = group_of(wave, k);
    const u32 i = p.tag[k] % kReused;
    const Vec3 normal = v.normal.at(k);
    const bool behind = v.front[k] == 0;
    g.starts |= 1u << i;
    g.start.set(i, ray_origin(v.point.at(k), normal, v.error[k], behind));
    g.side.set(i, normal * (behind ? -1.0f : 1.0f));
    g.facing.set(i, v.frame.at(k).z * copysign(1.0f, v.local_wo.at(k).z));
    g.share.set(i, share);
    g.self[i] = p.slot[k];
    g.inward[i] = behind != (v.inside_out[k] != 0);
  });
}

// Ways from all first surfaces of a group to one of the second: the density of going there, up to a
// factor, 0 where that could not be.
struct Ways {
  Rows<Vec3, kReused> direction;
  float distance[kReused], density[kReused];
};

PH_APART inline void find_ways(const PathGroup& __restrict g, u32 j, Ways& __restrict ways) {
  const Vec3 end = g.end.at(j), end_side = g.end_side.at(j), end_facing = g.end_facing.at(j);
  for (u32 i = 0; i < kReused; ++i) {
    const Vec3 way = end - g.start.at(i);
    const float square = dot(way, way), distance = sqrt(square);
    const Vec3 direction = renormalize(way * (1.0f / distance));
    const float leaves = dot(direction, g.facing.at(i)), arrives = -dot(direction, end_side);
    const float density = leaves * arrives / square;
    // Where the second surface's normal would be bent it sends another light.
    const bool same = stays_unbent(end_facing, end_side, -direction);
    const bool can = same & (leaves > 0.0f) & (arrives > 0.0f) &
                     (dot(direction, g.side.at(i)) > 0.0f) & (density < kInfinity);
    ways.direction.set(i, direction);
    ways.distance[i] = distance;
    ways.density[i] = can ? density : 0.0f;
  }
}

// What the samples of a group bring, all of whose paths have ended.
inline void share_out(const SceneView& scene, const RenderView& view, const PathGroup& g,
                      Vec3 (&radiance)[kReused], PathStats& stats) {
  for (u32 i = 0; i < g.count; ++i) {
    radiance[i] = (g.joins >> i & 1u) != 0 ? g.before.at(i) : g.gathered.at(i);
  }
  for_each_bit(g.joins, [&](u32 j) {
    const Vec3 gathered = g.gathered.at(j), own = g.share.at(j);
    if (black(gathered)) return;
    Ways ways;
    find_ways(g, j, ways);
    if (!(ways.density[j] > 0.0f) || !finite(gathered)) {
      radiance[j] += gathered;
      return;
    }
    u32 others = 0;
    for_each_bit(g.starts & ~(1u << j), [&](u32 i) {
      if (!(ways.density[i] > 0.0f)) return;
      others |= 1u << i;
      ++stats.rays;
    });
    const auto ray_at = [&](u32 i) -> Ray {
      return {g.start.at(i), ways.direction.at(i), g.self[i], g.inward[i]};
    };
    const u32 hidden = occluded_each(
        scene, ways.direction, others, ray_at, ways.distance, [&](u32) { return g.end_slot[j]; },
        view.tree);
    const u32 seen = (others & ~hidden) | 1u << j;
    float sum = ways.density[j];
    for_each_bit(seen & ~(1u << j), [&](u32 i) { sum += ways.density[i]; });
    const Vec3 light = {gathered.x / own.x, gathered.y / own.y, gathered.z / own.z};
    for_each_bit(seen, [&](u32 i) {
      radiance[i] +=
          bounded(g.share.at(i) * light * (ways.density[i] / sum), 2, view.clamp_indirect);
    });
  });
}

}  // namespace parhelion::PH_ISA
