// Sixteen paths side by side: by component, so that loops over all of them become vectors. What a
// lane holds whose path has ended means nothing, but loops go on computing with it: it is set from
// the start, and nothing is looked up by it.
#pragma once
#include "emitter.h"

namespace parhelion {

// Of calls that walk a tree one in so many is timed; a prime, as they come in turns.
inline constexpr u64 kTimedWalks = 61;

struct PathStats {
  u64 rays = 0;
  u64 walks = 0, timed_ticks = 0;  // such calls, and what those that are timed take together
};

// What the first surface of a path looks like, and the parts of its radiance. Normalised units.
struct Features {
  float depth;  // distance from the camera
  Vec3 position, normal, shading_normal;
  Vec2 uv;
  Vec3 albedo, emission, direct;
  u32 shape, material;  // kNone: nothing was hit
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Calls `walk`, which walks a tree.
template <class F>
PH_INLINE auto timed(PathStats& stats, F&& walk) {
  struct Timer {
    PathStats& stats;
    const bool on;
    const u64 start;
    PH_INLINE ~Timer() {
      if (on) stats.timed_ticks += compiler::ticks() - start;
    }
  };
  const bool on = ++stats.walks % kTimedWalks == 0;
  const Timer timer = {stats, on, on ? compiler::ticks() : 0};
  return walk();
}

// Where paths stand: the light gathered so far, and the ray that goes on.
struct Paths {
  Rows<Vec3, kBatch> origin, direction;  // of the ray; as in Ray, which the next two are, too
  SlotRows<kBatch> self;
  u32 inward[kBatch];
  // What the ray hits, once it has been traced, and how far away; the leaf is kNone for nothing.
  SlotRows<kBatch> slot;
  float t[kBatch];
  Rows<Vec3, kBatch> sum, throughput;
  Rows<Receiver, kBatch> receiver;    // the vertex that the ray leaves
  u32 glossy;                         // bits for those whose vertices have highlights
  Rows<Highlight, kBatch> highlight;  // of others unset
  float scatter_pdf[kBatch];          // of its direction; 0 if no light sample could have found it
  float eta_scale[kBatch];            // undoes the squeezing of radiance in glass, for the roulette
  float width[kBatch];      // of the cone around the ray that stands for its neighbours: at the
  float spread[kBatch];     // ray's origin, and what it grows by per unit of length
  float travelled[kBatch];  // from the camera
  u32 depth[kBatch];        // rays so far, the camera's own included
  u32 channel[kBatch];      // of red, green and blue the only one left, 0 to 2; kNone: any
  u32 holes[kBatch];        // passed by all rays so far
  u32 tag[kBatch];          // which sample, to those who asked for it
  SamplerBatch<kBatch> samplers;
  Media media[kBatch];

  PH_INLINE Ray ray(u32 k) const {
    return {origin.at(k), direction.at(k), self.at(k), inward[k] != 0};
  }
  PH_INLINE void set_ray(u32 k, const Ray& ray) {
    origin.set(k, ray.origin);
    direction.set(k, ray.direction);
    self.set(k, ray.self);
    inward[k] = ray.inward;
  }

  PH_INLINE Highlight highlight_of(u32 k) const {
    return (glossy >> k & 1u) != 0 ? highlight.at(k) : kNoHighlight;
  }
  PH_INLINE void set_highlight(u32 k, u32 has, const Rows<Highlight, kBatch>& from, u32 lane) {
    glossy = (glossy & ~(1u << k)) | has << k;
    if (has != 0) copy_lane(highlight, k, from, lane);
  }

  // Calls f(member, value) for what all paths begin with, whatever their camera.
  template <class F>
  PH_INLINE static void for_each_beginning(F&& f) {
    f(&Paths::self, kNoSlot), f(&Paths::inward, 0u);
    f(&Paths::sum, Vec3{0, 0, 0}), f(&Paths::throughput, Vec3{1, 1, 1});
    f(&Paths::scatter_pdf, 0.0f), f(&Paths::eta_scale, 1.0f);
    f(&Paths::depth, 1u), f(&Paths::channel, kNone), f(&Paths::holes, 0u);
  }

  // Takes paths that others have at some lanes and that have just begun and met something. Without
  // bodies no account of media ever holds anything.
  PH_APART void take(const LaneMoves& moves, const Paths& from, bool bodies) {
    samplers.kind = from.samplers.kind;
    for_each_move(moves, [&](const LaneMove& m) {
      for_each_beginning([&](auto row, auto value) { fill_lanes(this->*row, value, m); });
      const auto take_rows = [&](auto... row) { (move_lanes(this->*row, from.*row, m), ...); };
      take_rows(&Paths::origin, &Paths::direction, &Paths::slot, &Paths::t, &Paths::width,
                &Paths::spread, &Paths::travelled, &Paths::tag);
      move_lanes(samplers.reversed_index, from.samplers.reversed_index, m);
      move_lanes(samplers.key, from.samplers.key, m);
    });
    glossy &= ~moves.to;  // none has begun on a surface
    if (!bodies) return;
    for (u32 to = moves.to, others = moves.from; to != 0; to &= to - 1, others &= others - 1) {
      const u32 k = lowest_bit(to), lane = lowest_bit(others);
      media[k].count = 0;
      if (from.media[lane].count != 0) media[k] = from.media[lane];
    }
  }
};

}  // namespace parhelion::PH_ISA
