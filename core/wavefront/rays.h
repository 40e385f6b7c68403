// Rays: how paths begin, what their rays meet, and what those see that leave the scene.
#pragma once
#include "../packet.h"
#include "wave.h"

namespace parhelion::PH_ISA {

// Adds what rays see of a light from outside that is not asked for.
template <class Light>
PH_APART inline void add_smooth(const Light& __restrict light, const LightRecord& __restrict record,
                                const LightTables& tables, const u32 (&__restrict these)[kBatch],
                                float most_indirect, Paths& __restrict p) {
  for (u32 k = 0; k < kBatch; ++k) {
    const Vec3 sum = p.sum.at(k);
    const Vec3 shine = radiance(light, record, tables, p.direction.at(k));
    const Vec3 seen = bounded(p.throughput.at(k) * shine, p.depth[k] - 1, most_indirect);
    p.sum.set(k, select(these[k] != 0, sum + seen, sum));
  }
}

// Adds what the rays see that meet nothing.
inline void add_backgrounds(const SceneView& scene, const RenderView& view, u32 lanes, Paths& p) {
  if (view.backdrop.x == view.backdrop.x) {
    for_each_bit(lanes, [&](u32 k) {
      if (p.depth[k] > 1) return;
      p.sum.set(k, p.sum.at(k) + p.throughput.at(k) * view.backdrop);
      lanes &= ~(1u << k);
    });
  }
  if (view.integrator == Integrator::ambient_occlusion) {
    for_each_bit(lanes, [&](u32 k) { p.sum.set(k, Vec3{1, 1, 1}); });
    return;
  }
  u32 these[kBatch];
  spread(lanes, these);
  for (u32 i = scene.outside_first; lanes != 0 && i < scene.light_count; ++i) {
    const LightRecord& record = scene.lights[i];
    with_light(record.block, [&]<class Light>(const Light& light) {
      if constexpr (requires { Light::branchless; }) {
        static_assert(Light::smooth);  // so there is no density to weigh it by
        add_smooth(light, record, scene.tables, these, view.clamp_indirect, p);
        return;
      }
      if constexpr (requires(Rows<LightSight, kBatch>& sights) {
                      seen(light, record, scene.tables, lanes, p.direction, sights);
                    }) {
        Rows<LightSight, kBatch> sights;
        if (seen(light, record, scene.tables, lanes, p.direction, sights)) {
          for_each_bit(lanes, [&](u32 k) { add_outside(scene, view, i, sights.at(k), p, k); });
          return;
        }
      }
      for_each_bit(lanes, [&](u32 k) { add_outside(scene, view, i, p, k); });
    });
  }
}

// How the samples of a batch begin, whose pixels in row y and numbers are given.
template <u32 kCount>
PH_INLINE void begin_paths(const SceneView& scene, const RenderView& view, u32 y,
                           CameraBatch<kCount>& b) {
  b.samplers = make_samplers(view.sampler, b.x, y, b.sample, view.seed);
  float place_x[kCount], place_y[kCount], lens_x[kCount] = {}, lens_y[kCount] = {};
  draw2(b.samplers, kDrawPixel, place_x, place_y);
  if (view.camera.lens) draw2(b.samplers, kDrawLens, lens_x, lens_y);
  for (u32 i = 0; i < kCount; ++i) b.offset_x[i] = filter_offset(view.filter, place_x[i]);
  for (u32 i = 0; i < kCount; ++i) b.offset_y[i] = filter_offset(view.filter, place_y[i]);
  for (u32 i = 0; i < kCount; ++i) {
    const Vec3 lens = uniform_disk({lens_x[i], lens_y[i]});
    b.lens_x[i] = lens.x, b.lens_y[i] = lens.y;
  }
  camera_rays(view.camera, scene.bounds, y, b);
}

// Begins the paths of the first n samples of a batch, and adds what those see that pass the scene
// by.
template <u32 kCount>
inline void begin(const SceneView& scene, const RenderView& view, const CameraBatch<kCount>& batch,
                  u32 n, Wave& wave, PathStats& stats) {
  Paths& p = wave.paths;
  p.samplers.kind = batch.samplers.kind;
  for (u32 k = 0; k < kCount; ++k) {
    p.samplers.key[k] = batch.samplers.key[k];
    p.samplers.reversed_index[k] = batch.samplers.reversed_index[k];
    const Vec3 origin = {batch.origin[0][k], batch.origin[1][k], batch.origin[2][k]};
    const Vec3 direction = {batch.direction[0][k], batch.direction[1][k], batch.direction[2][k]};
    p.origin.set(k, origin);
    p.direction.set(k, direction);
    p.sum.set(k, Vec3{0, 0, 0});
    p.throughput.set(k, Vec3{1, 1, 1});
    p.scatter_pdf[k] = 0.0f;
    p.eta_scale[k] = 1.0f;
    p.travelled[k] = batch.sight[k] == Sight::scene ? batch.start[k] : 0.0f;
    p.spread[k] = view.camera.cone.spread;
    p.width[k] = view.camera.cone.width + view.camera.cone.spread * p.travelled[k];
    p.depth[k] = 1;
    p.channel[k] = kNone;
    p.holes[k] = 0;
    p.inward[k] = 0;
  }
  u32 passing = 0;
  wave.alive = 0;
  for (u32 k = 0; k < n; ++k) {
    p.self[k] = kNoSlot;
    p.media[k].count = 0;
    if (view.media.count != 0) p.media[k] = view.media;
    if (wave.features) wave.features[k] = {0, {}, {}, {}, {}, {}, {}, {}, kNone, kNone};
    if (batch.sight[k] == Sight::scene) wave.alive |= 1u << k;
    if (batch.sight[k] != Sight::scene) ++stats.rays;
    if (batch.sight[k] == Sight::background) passing |= 1u << k;
  }
  if (passing != 0) add_backgrounds(scene, view, passing, p);
  for_each_bit(passing, [&](u32 k) { wave.note_direct(k); });
}

// Traces the rays of a wave, and ends the paths that leave the scene. close: rays from the camera,
// which lie close together.
template <class Watch = Unwatched>
inline void trace(const SceneView& scene, const RenderView& view, Wave& wave, bool close,
                  PathStats& stats, const Watch& watch = {}) {
  Paths& p = wave.paths;
  Hit hit[kBatch];
  if (close && view.tree) {
    intersect_close(scene, p.origin, p.direction, wave.alive, hit);
  } else {
    for_each_bit(wave.alive,
                 [&](u32 k) { intersect(scene, p.ray(k), kInfinity, view.tree, hit[k]); });
  }
  u32 left = 0;
  for_each_bit(wave.alive, [&](u32 k) {
    ++stats.rays;
    if (hit[k].slot.leaf == kNone) left |= 1u << k;
    p.slot[k] = hit[k].slot;
    p.t[k] = hit[k].t;
  });
  if (left != 0) add_backgrounds(scene, view, left, p);
  for_each_bit(left, [&](u32 k) {
    watch(Step::leaves, wave, nullptr, k, Fate::ends);
    wave.note_direct(k);
  });
  wave.alive &= ~left;
}

// Takes the path that another wave has at a lane, whose first ray has been traced: there is no
// receiver yet. Features stay behind.
PH_INLINE void take(const Wave& from, u32 lane, Wave& wave, u32 k) {
  const Paths& a = from.paths;
  Paths& p = wave.paths;
  p.origin.set(k, a.origin.at(lane));
  p.direction.set(k, a.direction.at(lane));
  p.self[k] = a.self[lane];
  p.inward[k] = a.inward[lane];
  p.slot[k] = a.slot[lane];
  p.t[k] = a.t[lane];
  p.sum.set(k, a.sum.at(lane));
  p.throughput.set(k, a.throughput.at(lane));
  p.scatter_pdf[k] = a.scatter_pdf[lane];
  p.eta_scale[k] = a.eta_scale[lane];
  p.width[k] = a.width[lane];
  p.spread[k] = a.spread[lane];
  p.travelled[k] = a.travelled[lane];
  p.depth[k] = a.depth[lane];
  p.channel[k] = a.channel[lane];
  p.holes[k] = a.holes[lane];
  p.samplers.kind = a.samplers.kind;
  p.samplers.key[k] = a.samplers.key[lane];
  p.samplers.reversed_index[k] = a.samplers.reversed_index[lane];
  p.media[k].count = 0;
  if (a.media[lane].count != 0) p.media[k] = a.media[lane];
  wave.alive |= 1u << k;
}

}  // namespace parhelion::PH_ISA
