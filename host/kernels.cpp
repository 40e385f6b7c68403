// Compiled once per instruction set, with PH_ISA naming its namespace. No standard header may be
// included here: an inline function of the standard library, compiled for AVX-512, could be the
// copy that the linker keeps for everybody.
#include "samples.h"

#define PH_TEXT_(x) #x
#define PH_TEXT(x) PH_TEXT_(x)
#ifndef PH_NAME
#define PH_NAME PH_ISA  // as users know the instruction set
#endif

namespace parhelion::PH_ISA {
namespace {

// Renders samples: `Samples` says which, and takes what they have seen.
template <class Samples>
void render(const SceneView& scene, const RenderView& view, Samples& samples, PathStats& stats) {
  // New camera rays are traced by themselves, since those of one pixel lie close together, before
  // their paths take the places of those that have ended.
  Wave wave, fresh;
  wave.groups = fresh.groups = samples.groups();
  Vertices vertices = {};
  Partners partners;
  CameraBatch<kBatch> batch;
  u32 n = 0;              // samples in the batch that began last
  Features seen[kBatch];  // of both: with features the one is empty when it takes all of the other
  if (samples.sees()) wave.features = fresh.features = seen;
  const auto end = [&](const Wave& in, u32 ended) {
    for_each_bit(ended, [&](u32 k) { samples.end(in.paths.tag[k], in.paths.sum.at(k)); });
  };
  const auto begin_batch = [&] {
    n = samples.next(batch, fresh.paths.tag);
    if (n == 0) return false;
    for (u32 i = n; i < kBatch; ++i) {  // the rest of the last batch repeats its last sample
      batch.x[i] = batch.x[n - 1], batch.y[i] = batch.y[n - 1];
      batch.sample[i] = batch.sample[n - 1];
    }
    begin_paths(scene, view, batch);
    begin(scene, view, batch, n, fresh, stats);
    trace(scene, view, fresh, true, stats);
    end(fresh, ((1u << n) - 1) & ~fresh.alive);
    return true;
  };
  // Features are counted in the order of their samples: a batch of them ends before the next.
  const auto end_batch = [&] {
    for (u32 i = 0; samples.sees() && i < n; ++i) samples.see(batch, i, seen[i]);
    n = 0;
  };
  for (;;) {
    u32 before = wave.alive;
    trace(scene, view, wave, false, stats);
    end(wave, before & ~wave.alive);
    while (wave.alive != kAllLanes) {
      if (fresh.alive == 0) {
        if (samples.sees() && wave.alive != 0) break;
        end_batch();
        if (!begin_batch()) break;
      } else if (wave.alive == 0) {
        wave.paths = fresh.paths;
        wave.alive = fresh.alive;
        fresh.alive = 0;
      } else {
        take(scene, fresh, wave);
      }
    }
    if (wave.alive == 0) break;
    before = wave.alive;
    shade(scene, view, wave, vertices, partners, stats);
    end(wave, before & ~wave.alive);
  }
  samples.finish();
}

void render_row(const SceneView& scene, const RenderView& view, u32 y, u32 x0, u32 x1, u32 first,
                u32 last, FilmPixel* row, FeaturePixel* features, PathStats& stats) {
  RowSamples samples(y, x0, x1, first, last, row, features);
  render(scene, view, samples, stats);
}

void render_region(const SceneView& scene, const RenderView& view, const Region& region,
                   PathStats& stats) {
  RegionSamples samples(scene, view, region, stats);
  render(scene, view, samples, stats);
}

Vec3 one_radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                  PathStats& stats) {
  return radiance(scene, view, x, y, sample, stats);
}

// Of rays that begin farther than this from the first, along any axis, few boxes are met by all;
// a scene is as wide as 2.
constexpr float kFar = 0.125f;

// Sixteen of many rays, which may be those of a picture: then they lie close together, and what
// they meet is found for all at once. False where it is not.
template <bool kAny>
bool asked_together(const SceneView& scene, const RayBatch& rays, Packet& packet) {
  // Those that look nowhere, as they pass the scene by, may go anywhere.
  const u32 lanes = rays.lanes & bits(all(0.0f) < load(rays.limit));
  if (lanes == 0 || !same_signs(packet.direction, lanes)) return false;
  const u32 first = lowest_bit(lanes);
  for (const float (&row)[kBatch] : rays.origin) {
    const Lanes from = all(row[first]), own = load(row);
    const u32 close = bits(max(own - from, from - own) <= all(kFar));
    if ((lanes & ~close) != 0) return false;
  }
  return walk_close<kAny>(scene, lanes, rays.limit, packet);
}

// Calls f(rays, packet, result) for each of n batches.
template <class Result, class F>
void for_each_batch(const RayBatch* rays, u64 n, Result* result, F&& f) {
  for (u64 i = 0; i < n; ++i) {
    Packet packet;
    static_assert(sizeof(rays->origin) == sizeof(packet.origin.row));
    static_assert(sizeof(rays->self) == sizeof(packet.self));
    compiler::copy(packet.origin.row, rays[i].origin, sizeof(rays[i].origin));
    compiler::copy(packet.direction.row, rays[i].direction, sizeof(rays[i].direction));
    compiler::copy(&packet.self, &rays[i].self, sizeof(packet.self));
    packet.inward = rays[i].inward;
    f(rays[i], packet, result[i]);
  }
}

void intersect_all(const SceneView& scene, const RayBatch* rays, u64 n, bool tree, HitBatch* hits) {
  for_each_batch(rays, n, hits, [&](const RayBatch& own, Packet& packet, HitBatch& hit) {
    NearestHits& best = packet.best;
    if (!tree || !asked_together<false>(scene, own, packet)) {
      const auto ray_at = [&](u32 k) { return packet.ray(k); };
      intersect_each(scene, packet.direction, own.lanes, ray_at, own.limit, tree, best.t,
                     best.slot);
    }
    compiler::copy(hit.t, best.t, sizeof(hit.t));
    compiler::copy(&hit.slot, &best.slot, sizeof(hit.slot));
  });
}

void occluded_all(const SceneView& scene, const RayBatch* rays, u64 n, bool tree, u32* met) {
  for_each_batch(rays, n, met, [&](const RayBatch& own, Packet& packet, u32& lanes) {
    if (tree && asked_together<true>(scene, own, packet)) {
      lanes = packet.met;
    } else {
      const auto ray_at = [&](u32 k) { return packet.ray(k); };
      const auto ignored = [](u32) { return kNoSlot; };
      lanes = occluded_each(scene, packet.direction, own.lanes, ray_at, own.limit, ignored, tree);
    }
  });
}

void points_met(const SceneView& scene, const HitRay* rays, u64 n, Met* met) {
  const float nan = __builtin_nanf("");
  const Met nothing = {kNoSlot, {nan, nan, nan}, {nan, nan, nan}, 0.0f, 0u};
  Paths paths = {};
  Vertices found = {};
  u64 ray[kBatch];
  u32 count = 0;
  const auto find = [&] {
    find_surfaces(scene, paths, (1u << count) - 1, 0, found);
    for (u32 k = 0; k < count; ++k) {
      met[ray[k]] = {paths.slot.at(k), found.point.at(k), found.normal.at(k), found.error[k],
                     found.inside_out[k]};
    }
    count = 0;
  };
  fill_lanes(paths.self, kNoSlot);
  for (u64 i = 0; i < n; ++i) {
    const HitRay& own = rays[i];
    if (own.hit.slot.leaf == kNone) {
      met[i] = nothing;
      continue;
    }
    paths.origin.set(count, own.origin);
    paths.direction.set(count, own.direction);
    paths.t[count] = own.hit.t;
    paths.slot.set(count, own.hit.slot);
    ray[count] = i;
    if (++count == kBatch) find();
  }
  if (count > 0) find();
}

Media bodies(const SceneView& scene, Vec3 point, Vec3 direction, bool tree) {
  return media_around(scene, point, direction, tree);
}

// A mapping takes a parameter or not.
template <class F, class X>
auto call(F f, X x, float parameter) {
  if constexpr (requires { f(x); }) {
    return f(x);
  } else {
    return f(x, parameter);
  }
}
#define PH_CALL(name, x, parameter) \
  call([](auto... a) -> decltype(name(a...)) { return name(a...); }, x, parameter)

void warp(WarpKind kind, float parameter, const Vec2* u, u64 n, Vec3* out) {
  for (u64 i = 0; i < n; ++i) {
    switch (kind) {
#define WARP(name, parameter_, doc) \
  case WarpKind::name: out[i] = PH_CALL(name, u[i], parameter); break;
#include "../core/warps.def"
#undef WARP
    }
  }
}

void warp_pdf(WarpKind kind, float parameter, const Vec3* w, u64 n, float* out) {
  for (u64 i = 0; i < n; ++i) {
    switch (kind) {
#define WARP(name, parameter_, doc) \
  case WarpKind::name: out[i] = PH_CALL(name##_pdf, w[i], parameter); break;
#include "../core/warps.def"
#undef WARP
    }
  }
}

// Calls f(sampled, value_towards): what `sample` and `value_of` do for m and wo. What depends on
// these alone is worked out once, which may be a quadrature.
template <class Material, class F>
void with_seen(const Material& m, Vec3 wo, F&& f) {
  if constexpr (Prepares<Material>) {
    const auto seen = prepare(m, wo);
    f([&](const BsdfDraws& u, BsdfSample& out) { return sample(m, seen, wo, u, out); },
      [&](Vec3 wi) { return value_of(m, seen, wo, wi); });
  } else {
    f([&](const BsdfDraws& u, BsdfSample& out) { return sample(m, wo, u, out); },
      [&](Vec3 wi) { return value_of(m, wo, wi); });
  }
}

void bsdf_sample(const ParamBlock& block, Vec3 wo, SamplerKind kind, u64 seed, u64 n,
                 BsdfProbe* out) {
  with_material(block, [&](const auto& m) {
    with_seen(m, wo, [&](auto&& sampled, auto&&) {
      for (u64 i = 0; i < n; ++i) {
        const u32 index = static_cast<u32>(i);
        const Sampler sampler = make_sampler(kind, 0, 0, index, seed);
        BsdfSample s = {{0, 0, 0}, {0, 0, 0}, 0.0f, 1.0f, false};
        const BsdfDraws u = {draw2(sampler, bounce_draw(1) + kDrawDirection),
                             draw1(sampler, bounce_draw(1) + kDrawLobe)};
        if (!sampled(u, s)) s.weight = {0, 0, 0};
        // As the path tracer sees it, without the change of radiance in glass.
        out[i] = {s.wi, s.weight * (s.eta * s.eta), s.pdf, s.delta};
      }
    });
  });
}

void bsdf_eval(const ParamBlock& block, Vec3 wo, const Vec3* wi, u64 n, Vec3* value,
               float* density) {
  with_material(block, [&](const auto& m) {
    with_seen(m, wo, [&](auto&&, auto&& value_towards) {
      for (u64 i = 0; i < n; ++i) {
        const BsdfValue v = value_towards(wi[i]);
        value[i] = v.value, density[i] = v.pdf;
      }
    });
  });
}

void light_sample(const SceneView& scene, Vec3 from, u64 seed, u64 n, LightProbe* out) {
  for (u64 i = 0; i < n; ++i) {
    const Sampler s = make_sampler(SamplerKind::independent, 0, 0, static_cast<u32>(i), seed);
    const DirectSample light =
        sample_lights(scene, {from, {0, 0, 0}}, draw2(s, kDrawLightPoint), draw1(s, kDrawLight));
    out[i] = {light.direction, light.distance, light.pdf, light.radiance, light.delta};
  }
}

void draws(SamplerKind kind, u32 x, u32 y, u32 first, u64 n, u32 dimension, u64 seed, Vec2* out) {
  for (u64 i = 0; i < n; ++i) {
    out[i] = draw2(make_sampler(kind, x, y, first + static_cast<u32>(i), seed), dimension);
  }
}

void filter_offsets(const FilterTable& table, const float* u, u64 n, float* out) {
  for (u64 first = 0; first < n; first += kBatch) {
    const u64 count = n - first < kBatch ? n - first : kBatch;
    float number[kBatch] = {}, offset[kBatch];
    for (u64 k = 0; k < count; ++k) number[k] = u[first + k];
    PH_ISA::filter_offsets(table, number, offset);
    for (u64 k = 0; k < count; ++k) out[first + k] = offset[k];
  }
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels = {PH_TEXT(PH_NAME), render_row,    render_region, one_radiance,
                          begin_rays,       intersect_all, occluded_all,  points_met,
                          bodies,           warp,          warp_pdf,      bsdf_sample,
                          bsdf_eval,        light_sample,  draws,         filter_offsets};

}  // namespace parhelion::PH_ISA
