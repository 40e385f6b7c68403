// Sixteen paths in step: each step of a bounce for all of them before the next. What is arithmetic
// alone are loops over all lanes, which compilers turn into vectors; the rest is path.h's, one path
// after the other. After: S. Laine, T. Karras and T. Aila, "Megakernels Considered Harmful:
// Wavefront Path Tracing on GPUs", HPG 2013.
//
// Such a loop is a function of its own and has no branches: what a lane may not get is computed and
// not selected.
#pragma once
#include "wavefront/blends.h"
#include "wavefront/lights.h"
#include "wavefront/materials.h"
#include "wavefront/rays.h"
#include "wavefront/reuse.h"
#include "wavefront/scattering.h"
#include "wavefront/surfaces.h"
#include "wavefront/textures.h"

namespace parhelion::PH_ISA {

// Takes paths that have met a surface each through it, or ends them.
template <class Watch = Unwatched>
inline void shade(const SceneView& scene, const RenderView& view, Wave& wave, Vertices& v,
                  Partners& others, PathStats& stats, const Watch& watch = {}) {
  Paths& p = wave.paths;
  const u32 first = wave.features ? equal(1, p.depth) & wave.alive : 0;
  find_surfaces(scene, p, wave.alive, first, v);
  travel(p, v);
  find_emission(scene, p, wave.alive, v);
  v.blended = v.second = 0;
  const u32 met = wave.alive;
  const u32 alone =
      meets_more(scene, view, wave) ? met : having(kShines | kTwoSided, v.traits, met);
  const u32 ending = meet_plainly(view.max_depth, p, v) & ~alone;
  u32 meeting = met & ~alone & ~ending;
  wave.alive &= ~ending;
  for_each_bit(alone, [&](u32 k) {
    const Fate fate = meet(scene, view, wave, v, k, stats);
    if (fate == Fate::scatters) meeting |= 1u << k;
    if (fate == Fate::ends) wave.alive &= ~(1u << k);
  });
  const u32 blends = having(kBlends, v.traits, meeting);
  if (blends != 0) choose_materials(scene, blends, p, v);
  for_each_bit(met, [&](u32 k) {
    const bool scatters = (meeting >> k & 1u) != 0, passes = (wave.alive >> k & 1u) != 0;
    watch(Step::meets, wave, &v, k,
          scatters ? Fate::scatters : (passes ? Fate::passes : Fate::ends));
  });
  if (wave.groups) keep_emission(scene, wave, v, meeting);
  wave.note_direct(alone);
  find_parameters(scene, p, meeting, v);
  Kinds kinds;
  u32 rough = 0;
  const u32 seconds = wave.groups ? at_second(wave, meeting) : 0;
  others.lanes = 0;
  if (const u32 blended = v.blended & meeting & ~seconds; blended != 0 && asks_for_light(scene)) {
    approach_partners(scene, wave, blended, v, others);
  }
  const u32 scattering = approach(scene, wave, v, meeting, seconds, kinds, rough, watch);
  if (others.lanes != 0) see_alike(others, kinds, v);
  Joining joining;
  if (wave.groups) {
    joining = join_groups(wave, kinds, seconds, v);
    start_groups(wave, kinds, rough, v);
  }
  if (scattering == 0) return;
  BounceDraws draws = {};
  draw_bounces(p, kinds, asks_for_light(scene), draws);
  if (asks_for_light(scene)) {
    u32 lit = ask(scene, rough, draws, v);
    const u32 asked = lit;
    if (lit != 0) lit = weigh_both(p, kinds, lit, joining.glossy, others, v);
    for_each_bit(asked, [&](u32 k) {
      watch(Step::asks, wave, &v, k, Fate::scatters, (lit >> k & 1u) != 0);
    });
    const u32 crossing = kinds.transmitting & ~others.lanes;  // no bodies among these
    if (lit != 0) lit = receive(scene, view, crossing, lit, p, v, stats);
    if ((lit & joining.glossy) != 0) note_lights(wave, v, lit & joining.glossy);
    for_each_bit(scattering, [&](u32 k) { watch(Step::receives, wave, &v, k, Fate::scatters); });
    wave.note_direct(equal(1, p.depth) & scattering);
  }
  u32 mirrored = 0;
  const u32 on =
      scatter(scene, view, kinds, scattering, wave.alive & ~scattering, draws, v, p, mirrored);
  leave_blends(others, v, on, p);
  if (wave.groups) divide_light(wave, joining, mirrored);
  for_each_bit(scattering, [&](u32 k) {
    watch(Step::scatters, wave, &v, k, (on >> k & 1u) != 0 ? Fate::passes : Fate::ends);
  });
  wave.alive &= ~(scattering & ~on);
}

// Radiance that one sample of one pixel sees: a pure function of pixel and sample.
template <class Watch = Unwatched>
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                     PathStats& stats, const Watch& watch = {}) {
  CameraBatch<1> batch = {};
  batch.x[0] = x, batch.y[0] = y;
  batch.sample[0] = sample;
  begin_paths(scene, view, batch);
  Wave wave;
  Vertices vertices = {};
  Partners partners;
  begin(scene, view, batch, 1, wave, stats);
  watch(Step::begins, wave, nullptr, 0, wave.alive != 0 ? Fate::passes : Fate::ends);
  while (wave.alive != 0) {
    trace(scene, view, wave, false, stats, watch);
    if (wave.alive != 0) shade(scene, view, wave, vertices, partners, stats, watch);
  }
  return wave.paths.sum.at(0);
}

}  // namespace parhelion::PH_ISA
