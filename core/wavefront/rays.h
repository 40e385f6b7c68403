// Rays, from the camera on to what they meet.
#pragma once
#include "../packet.h"
#include "../ray_batch.h"
#include "backgrounds.h"
#include "reuse.h"
#include "watch.h"

namespace parhelion::PH_ISA {

// Points of a lens, of radius 1
template <u32 kCount>
PH_APART inline void find_lens(const float (&__restrict u)[2][kCount],
                               float (&__restrict x)[kCount], float (&__restrict y)[kCount]) {
  for (u32 i = 0; i < kCount; ++i) {
    const Vec3 on_lens = uniform_disk({u[0][i], u[1][i]});
    x[i] = on_lens.x, y[i] = on_lens.y;
  }
}

// How the samples of a batch begin, whose pixels and numbers are given.
template <u32 kCount>
PH_INLINE void begin_paths(const SceneView& scene, const RenderView& view, CameraBatch<kCount>& b) {
  b.samplers = make_samplers(view.sampler, b.x, b.y, b.sample, view.seed);
  float place[2][kCount], lens[2][kCount] = {};
  draw2(b.samplers, kDrawPixel, place[0], place[1]);
  filter_offsets(view.filter, place[0], b.offset_x);
  filter_offsets(view.filter, place[1], b.offset_y);
  if (view.camera.lens) draw2(b.samplers, kDrawLens, lens[0], lens[1]);
  find_lens(lens, b.lens_x, b.lens_y);
  camera_rays(view.camera, scene.bounds, b);
}

// Begins the paths of the first n samples of a batch, and adds what those see that pass the scene
// by.
template <u32 kCount>
inline void begin(const SceneView& scene, const RenderView& view, const CameraBatch<kCount>& batch,
                  u32 n, Wave& wave, PathStats& stats) {
  Paths& p = wave.paths;
  p.samplers.kind = batch.samplers.kind;
  Paths::for_each_beginning([&](auto row, auto value) { fill_lanes(p.*row, value); });
  for (u32 k = 0; k < kCount; ++k) {
    p.samplers.key[k] = batch.samplers.key[k];
    p.samplers.reversed_index[k] = batch.samplers.reversed_index[k];
    const Vec3 origin = {batch.origin[0][k], batch.origin[1][k], batch.origin[2][k]};
    const Vec3 direction = {batch.direction[0][k], batch.direction[1][k], batch.direction[2][k]};
    p.origin.set(k, origin);
    p.direction.set(k, direction);
    p.travelled[k] = batch.sight[k] == Sight::scene ? batch.start[k] : 0.0f;
    p.spread[k] = view.camera.cone.spread;
    p.width[k] = view.camera.cone.width + view.camera.cone.spread * p.travelled[k];
  }
  u32 passing = 0;
  wave.alive = 0;
  for (u32 k = 0; k < n; ++k) {
    p.media[k].count = 0;
    if (view.media.count != 0) p.media[k] = view.media;
    if (wave.features) wave.features[k] = {0, {}, {}, {}, {}, {}, {}, {}, kNone, kNone};
    if (batch.sight[k] == Sight::scene) wave.alive |= 1u << k;
    if (batch.sight[k] != Sight::scene) ++stats.rays;
    if (batch.sight[k] == Sight::background) passing |= 1u << k;
  }
  if (passing != 0) add_backgrounds(scene, view, passing, p);
  wave.note_direct(passing);
}

// Traces the rays of a wave, and ends the paths that leave the scene. close: rays from the camera,
// which lie close together.
template <class Watch = Unwatched>
inline void trace(const SceneView& scene, const RenderView& view, Wave& wave, bool close,
                  PathStats& stats, const Watch& watch = {}) {
  Paths& p = wave.paths;
  timed(stats, [&] {
    if (close && view.tree) {
      intersect_close(scene, p.origin, p.direction, wave.alive, p.t, p.slot);
    } else {
      const auto ray_at = [&](u32 k) { return p.ray(k); };
      intersect_each(scene, p.direction, wave.alive, ray_at, view.tree, p.t, p.slot);
    }
  });
  stats.rays += compiler::ones(wave.alive);
  const u32 left = equal(kNone, p.slot.leaf) & wave.alive;
  if (left != 0) add_backgrounds(scene, view, left, p);
  if (wave.groups) keep_sights(scene, wave, left);
  for_each_bit(left, [&](u32 k) { watch(Step::leaves, wave, nullptr, k, Fate::ends); });
  wave.note_direct(left);
  wave.alive &= ~left;
}

// Takes as many paths as there is room for of those that have begun. Features stay behind.
PH_INLINE void take(const SceneView& scene, Wave& from, Wave& wave) {
  const u32 room = kAllLanes & ~wave.alive;
  const u32 free = compiler::ones(room), there = compiler::ones(from.alive);
  const u32 n = free < there ? free : there;
  const u32 to = lowest_bits(room, n), others = lowest_bits(from.alive, n);
  wave.paths.take({to, others}, from.paths, scene.has_bodies);
  wave.alive |= to;
  from.alive &= ~others;
}

}  // namespace parhelion::PH_ISA
