// Paths followed together: each step of a bounce for sixteen of them before the next. Steps that
// are arithmetic alone, random numbers and directions towards lights, are loops that compilers turn
// into vectors; the others are those of path.h, one path after the other. After: S. Laine, T.
// Karras and T. Aila, "Megakernels Considered Harmful: Wavefront Path Tracing on GPUs", HPG 2013.
#pragma once
#include "path.h"

namespace parhelion::PH_ISA {

// Up to so many lights are weighed for sixteen points at once, one after the other; of more,
// sixteen at once for each point.
inline constexpr u32 kFewLights = 8;

// The numbers that a bounce of sixteen paths takes, by draw and path.
struct BounceDraws {
  float choice[2][kBatch], point[2][kBatch], direction[2][kBatch];
  float hemisphere[3][kBatch], lobe[kBatch], lobe2[kBatch], roulette[kBatch];

  PH_INLINE BsdfDraws bsdf(u32 i) const {
    return {{direction[0][i], direction[1][i]},
            {hemisphere[0][i], hemisphere[1][i], hemisphere[2][i]},
            lobe[i],
            lobe2[i]};
  }
};

// All that scattering at n vertices may need.
inline void draw_bounces(const PathState* paths, const Vertex* const* here, u32 n, bool lit,
                         BounceDraws& draws) {
  SamplerBatch<kBatch> s = {};
  s.kind = paths[here[0]->place].sampler.kind;
  u32 lobes = 0;
  bool roulette = false;
  for (u32 k = 0; k < n; ++k) {
    const PathState& path = paths[here[k]->place];
    s.key[k] = path.sampler.key;
    s.reversed_index[k] = path.sampler.reversed_index;
    s.dimension[k] = bounce_draw(path.depth);
    const u32 own = lobe_draws(here[k]->block);
    lobes = own > lobes ? own : lobes;
    roulette = roulette || path.depth >= kRouletteStart;
  }
  draw2(s, kDrawDirection, draws.direction[0], draws.direction[1]);
  if (lobes > 0) draw1(s, kDrawLobe, draws.lobe);
  if (lobes > 1) draw1(s, kDrawLobe2, draws.lobe2);
  if (roulette) draw1(s, kDrawRoulette, draws.roulette);
  if (lit) {
    draw2(s, kDrawLight, draws.choice[0], draws.choice[1]);
    draw2(s, kDrawLightPoint, draws.point[0], draws.point[1]);
  }
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 w = cosine_hemisphere({draws.direction[0][k], draws.direction[1][k]});
    draws.hemisphere[0][k] = w.x, draws.hemisphere[1][k] = w.y, draws.hemisphere[2][k] = w.z;
  }
}

// Vertices that ask lights of one kind.
struct Picks {
  LightPick pick[kBatch];
  Vertex* of[kBatch];
  u32 count = 0;

  PH_INLINE void add(const LightPick& p, Vertex& v) {
    pick[count] = p;
    of[count++] = &v;
  }
};

// Those that ask primitives of one kind, of the scene itself.
template <class Shape>
struct PickedLights : Picks {
  TowardsBatch<Shape, kBatch> batch;
  u32 id[kBatch];

  // Takes the vertex, if it asks one of these, and says so.
  template <class Block>
  PH_INLINE bool take(const Block* blocks, ShapeKind kind, const LightPick& p, Vertex& v,
                      Vec2 draws) {
    const Slot slot = p.slot;
    if (p.record != kNone || slot.leaf == kNone || slot.instance != kNone) return false;
    if (leaf_kind(slot.leaf) != kind) return false;
    const Block& block = blocks[slot.leaf & kLeafIndexMask];
    batch.shape.set(count, primitive(block, slot.lane));
    batch.from.set(count, v.receiver.point);
    batch.draws[0][count] = draws.x, batch.draws[1][count] = draws.y;
    id[count] = block.id[slot.lane];
    add(p, v);
    return true;
  }
  PH_INLINE void sample(const SceneView& scene) {
    if (count == 0) return;
    batch.sample();
    for (u32 i = 0; i < count; ++i) {
      Vertex& v = *of[i];
      v.light = emitter_sample(scene, pick[i].slot, nullptr, batch.shape.at(i), id[i],
                               v.receiver.point, batch.towards.at(i));
      v.light.pdf *= pick[i].probability;
    }
  }
};

// Light samples for those of n vertices that ask for light.
inline void ask(const SceneView& scene, Vertex* const* here, u32 n, const BounceDraws& draws) {
  const LightTreeView& tree = scene.light_tree;
  const bool few = tree.light_count != 0 && tree.light_count <= kFewLights;
  u32 chosen[kBatch];
  float probability[kBatch];
  if (few) {
    LitPoints at = {};
    for (u32 k = 0; k < n; ++k) {
      const Receiver& r = here[k]->receiver;
      at.x[k] = r.point.x, at.y[k] = r.point.y, at.z[k] = r.point.z;
      at.normal_x[k] = r.normal.x, at.normal_y[k] = r.normal.y, at.normal_z[k] = r.normal.z;
      at.u[0][k] = draws.choice[0][k], at.u[1][k] = choice_inside(scene, draws.choice[1][k]);
    }
    choose_lights(tree, at, chosen, probability);
  }
  // Those to which directions are found for all at once.
  PickedLights<Triangle> triangles;
  PickedLights<Sphere> spheres;
  PanoramaBatch<kBatch> panoramas;
  Picks around;
  for (u32 k = 0; k < n; ++k) {
    Vertex& v = *here[k];
    if (!v.asks) continue;
    const Vec2 choice = {draws.choice[0][k], draws.choice[1][k]};
    const Vec2 point = {draws.point[0][k], draws.point[1][k]};
    const LightPick pick = few && !(choice.y < scene.outside_share)
                               ? pick_inside(scene, chosen[k], probability[k])
                               : pick_light(scene, v.receiver, choice);
    if (triangles.take(scene.triangles, ShapeKind::triangle, pick, v, point)) continue;
    if (spheres.take(scene.spheres, ShapeKind::sphere, pick, v, point)) continue;
    if (pick.record != kNone && is_panorama(scene.lights[pick.record])) {
      const LightRecord& record = scene.lights[pick.record];
      panoramas.set(around.count, scene.tables.images[record.image],
                    scene.tables.distributions[record.distribution],
                    is_latlong(from_block<Envmap>(record.block)), point);
      around.add(pick, v);
    } else {
      v.light = sample_pick(scene, pick, v.receiver.point, point);
    }
  }
  if (around.count != 0) panoramas.sample(around.count);
  for (u32 i = 0; i < around.count; ++i) {
    const LightRecord& record = scene.lights[around.pick[i].record];
    DirectSample& light = around.of[i]->light;
    light = record_sample(
        from_panorama(from_block<Envmap>(record.block), record, panoramas.sampled(i)));
    light.pdf *= around.pick[i].probability;
  }
  triangles.sample(scene);
  spheres.sample(scene);
  for (u32 k = 0; k < n; ++k) {
    Vertex& v = *here[k];
    v.asks = v.asks && v.light.pdf > 0.0f && !black(v.light.radiance);
  }
}

// When a path may be looked at: after each of these.
enum class Step : u32 { begins, leaves, meets, approaches, asks, receives, scatters };

// Looks at nothing, and is nothing once it is compiled. vertex: null where there is none.
struct Unwatched {
  PH_INLINE void operator()(Step, const PathState&, const Vertex* /*vertex*/, Fate) const {}
};

// Paths that are followed together. One that has ended leaves its place to another.
inline constexpr u32 kPaths = 2 * kBatch;
struct PathPool {
  PathState path[kPaths];
  Features features[kPaths];  // if they are asked for
  bool featured = false;
  u32 on[kPaths], on_count = 0;        // places of the paths that go on
  u32 ended[kPaths], ended_count = 0;  // of those that have ended, for the caller to take out

  PH_INLINE Features* features_of(u32 i) { return featured ? &features[i] : nullptr; }
  // Light that is direct has been found when the second ray ends.
  PH_INLINE void note_direct(u32 i) {
    if (featured && path[i].depth <= 2) features[i].direct = path[i].sum - features[i].emission;
  }
  PH_INLINE void settle(u32 i, Fate fate) {
    if (fate == Fate::ends) {
      ended[ended_count++] = i;
    } else {
      on[on_count++] = i;
    }
  }
};

// Begins the path of a batch's sample at a place of the pool.
template <u32 kCount>
PH_INLINE void begin(const SceneView& scene, const RenderView& view,
                     const CameraBatch<kCount>& batch, u32 at, PathPool& pool, u32 place,
                     PathStats& stats) {
  ++stats.rays;
  begin(view, batch, at, pool.path[place]);
  if (pool.featured) pool.features[place] = {0, {}, {}, {}, {}, {}, {}, {}, kNone, kNone};
  if (batch.sight[at] == Sight::background) {
    leave_scene(scene, view, pool.path[place]);
    pool.note_direct(place);
  }
  pool.settle(place, batch.sight[at] == Sight::scene ? Fate::passes : Fate::ends);
}

// Scatters paths at n vertices, up to kBatch.
template <class Watch>
inline void bounce(const SceneView& scene, const RenderView& view, PathPool& pool,
                   Vertex* const* here, u32 n, PathStats& stats, const Watch& watch) {
  BounceDraws draws = {};
  draw_bounces(pool.path, here, n, asks_for_light(scene), draws);
  if (asks_for_light(scene)) {
    ask(scene, here, n, draws);
    for (u32 k = 0; k < n; ++k) {
      Vertex& v = *here[k];
      if (!v.asks) continue;
      v.asks = with_material(
          v.block, [&](const auto& material) { return weigh(material, pool.path[v.place], v); });
      watch(Step::asks, pool.path[v.place], &v, Fate::scatters);
    }
    for (u32 k = 0; k < n; ++k) {
      const Vertex& v = *here[k];
      if (v.asks) receive(scene, view, pool.path[v.place], v, stats);
      watch(Step::receives, pool.path[v.place], &v, Fate::scatters);
      if (pool.path[v.place].depth == 1) pool.note_direct(v.place);
    }
  }
  for (u32 k = 0; k < n; ++k) {
    const Vertex& v = *here[k];
    const bool goes_on = with_material(v.block, [&](const auto& material) {
      return scatter(scene, view, material, draws.bsdf(k), draws.roulette[k], pool.path[v.place],
                     v);
    });
    const Fate fate = goes_on ? Fate::passes : Fate::ends;
    watch(Step::scatters, pool.path[v.place], &v, fate);
    pool.settle(v.place, fate);
  }
}

// Takes n paths, up to kBatch, along one ray each and through what that meets.
template <class Watch>
inline void advance(const SceneView& scene, const RenderView& view, PathPool& pool,
                    const u32 (&places)[kBatch], u32 n, PathStats& stats, const Watch& watch) {
  for (u32 k = 0; k < n; ++k) {
    PathState& path = pool.path[places[k]];
    intersect(scene, path.ray, kInfinity, view.tree, path.hit);
  }
  Vertex vertices[kBatch];
  Vertex* here[kBatch];
  u32 met = 0, scattering = 0;
  for (u32 k = 0; k < n; ++k) {
    const u32 i = places[k];
    Vertex& v = vertices[k];
    v.place = i;
    Fate fate = Fate::ends;
    if (pool.path[i].hit.slot.leaf == kNone) {
      leave_scene(scene, view, pool.path[i]);
      watch(Step::leaves, pool.path[i], nullptr, fate);
    } else {
      fate = meet(scene, view, pool.path[i], v, pool.features_of(i), stats);
      watch(Step::meets, pool.path[i], &v, fate);
    }
    pool.note_direct(i);
    if (fate == Fate::scatters) {
      here[met++] = &v;
    } else {
      pool.settle(i, fate);
    }
  }
  for (u32 k = 0; k < met; ++k) {
    Vertex& v = *here[k];
    const u32 i = v.place;
    Features* const own = pool.features_of(i);
    const Fate fate = with_material(v.block, [&](const auto& material) {
      if (own && pool.path[i].depth == 1) own->albedo = albedo_of(material);
      return approach(scene, material, pool.path[i], v, own);
    });
    watch(Step::approaches, pool.path[i], &v, fate);
    if (fate == Fate::scatters) {
      here[scattering++] = &v;
    } else {
      pool.settle(i, fate);
    }
  }
  if (scattering != 0) bounce(scene, view, pool, here, scattering, stats, watch);
}

// The same for the paths of the pool that go on, from the one at `first` in their list.
template <class Watch = Unwatched>
inline void advance(const SceneView& scene, const RenderView& view, PathPool& pool, u32 first,
                    PathStats& stats, const Watch& watch = {}) {
  const u32 count = pool.on_count;
  pool.on_count = first;
  for (u32 begin = first; begin < count; begin += kBatch) {
    const u32 n = count - begin < kBatch ? count - begin : kBatch;
    u32 places[kBatch];  // taken out before others are put there
    for (u32 k = 0; k < n; ++k) places[k] = pool.on[begin + k];
    advance(scene, view, pool, places, n, stats, watch);
  }
  stats.rays += pool.on_count - first;
}

// Radiance that one sample of one pixel sees: a pure function of pixel and sample.
template <class Watch = Unwatched>
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                     PathStats& stats, const Watch& watch = {}) {
  CameraBatch<1> batch = {};
  batch.x[0] = x;
  batch.sample[0] = sample;
  begin_paths(scene, view, y, batch);
  PathPool pool;
  begin(scene, view, batch, 0, pool, 0, stats);
  watch(Step::begins, pool.path[0], nullptr, pool.on_count != 0 ? Fate::passes : Fate::ends);
  while (pool.on_count != 0) advance(scene, view, pool, 0, stats, watch);
  return pool.path[0].sum;
}

}  // namespace parhelion::PH_ISA
