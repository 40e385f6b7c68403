// Compiled once per instruction set, with PH_ISA naming its namespace. No standard header may be
// included here: an inline function of the standard library, compiled for AVX-512, could be the
// copy that the linker keeps for everybody.
#include "kernel_table.h"

#define PH_TEXT_(x) #x
#define PH_TEXT(x) PH_TEXT_(x)

namespace parhelion::PH_ISA {
namespace {

void record(FeaturePixel& pixel, const Features& f, u32 sample) {
  if (sample == 0) {
    pixel.shape = f.shape;
    pixel.material = f.material;
  }
  ++pixel.count;
  const float light[kLightFloats] = {f.albedo.x,   f.albedo.y,   f.albedo.z,
                                     f.emission.x, f.emission.y, f.emission.z,
                                     f.direct.x,   f.direct.y,   f.direct.z};
  for (u32 i = 0; i < kLightFloats; ++i) {
    if (finite(light[i])) add(pixel.light[i], light[i]);
  }
  if (f.shape == kNone) return;
  ++pixel.hits;
  add(pixel.shapes, f.shape);
  add(pixel.materials, f.material);
  const Vec3 n = f.normal, m = f.shading_normal, p = f.position;
  const float place[kPlaceFloats] = {f.depth, p.x, p.y, p.z, n.x,    n.y,
                                     n.z,     m.x, m.y, m.z, f.uv.x, f.uv.y};
  for (u32 i = 0; i < kPlaceFloats; ++i) {
    if (finite(place[i])) add(pixel.place[i], place[i]);
  }
}

// Samples that have ended, on their way into the film.
struct Finished {
  u32 at[kBatch], count = 0;
  float rgb[3][kBatch] = {};

  // Those of a wave that have ended, each with its pixel's place in the row.
  void take(const Wave& wave, u32 ended, const u32 (&place)[kBatch], FilmPixel* row) {
    for_each_bit(ended, [&](u32 k) {
      const Vec3 light = wave.paths.sum.at(k);
      at[count] = place[k];
      rgb[0][count] = light.x, rgb[1][count] = light.y, rgb[2][count] = light.z;
      if (++count == kBatch) add_to(row);
    });
  }
  void add_to(FilmPixel* row) {
    add(row, at, rgb, count);
    count = 0;
  }
};

void render_row(const SceneView& scene, const RenderView& view, u32 y, u32 x0, u32 x1, u32 first,
                u32 last, FilmPixel* row, FeaturePixel* features, PathStats& stats) {
  // New camera rays are traced by themselves, since those of one pixel lie close together, before
  // their paths take the places of those that have ended.
  Wave wave, fresh;
  Vertices vertices = {};
  u32 at[kBatch], fresh_at[kBatch] = {}, number[kBatch], n = 0;
  Features seen[kBatch];  // of both: with features the one is empty when it takes all of the other
  if (features) wave.features = fresh.features = seen;
  Finished finished;
  u32 x = first < last ? x0 : x1, sample = first;
  const auto begin_batch = [&] {
    CameraBatch<kBatch> batch;
    for (n = 0; n < kBatch && x < x1; ++n) {  // samples go pixel after pixel
      batch.x[n] = x, batch.sample[n] = sample;
      fresh_at[n] = x - x0, number[n] = sample;
      if (++sample == last) ++x, sample = first;
    }
    for (u32 i = n; i < kBatch; ++i) {  // the rest of the last batch repeats its last sample
      batch.x[i] = batch.x[n - 1], batch.sample[i] = batch.sample[n - 1];
    }
    begin_paths(scene, view, y, batch);
    begin(scene, view, batch, n, fresh, stats);
    trace(scene, view, fresh, true, stats);
    finished.take(fresh, ((1u << n) - 1) & ~fresh.alive, fresh_at, row);
  };
  // Features are counted in the order of their samples: a batch of them ends before the next.
  const auto end_batch = [&] {
    for (u32 i = 0; features && i < n; ++i) record(features[fresh_at[i]], seen[i], number[i]);
    n = 0;
  };
  for (;;) {
    u32 before = wave.alive;
    trace(scene, view, wave, false, stats);
    finished.take(wave, before & ~wave.alive, at, row);
    while (wave.alive != kAllLanes) {
      if (fresh.alive == 0) {
        if (features && wave.alive != 0) break;
        end_batch();
        if (x == x1) break;
        begin_batch();
      } else if (wave.alive == 0) {
        wave.paths = fresh.paths;
        wave.alive = fresh.alive;
        for (u32 k = 0; k < kBatch; ++k) at[k] = fresh_at[k];
        fresh.alive = 0;
      } else {
        const u32 k = lowest_bit(~wave.alive), lane = lowest_bit(fresh.alive);
        take(fresh, lane, wave, k);
        at[k] = fresh_at[lane];
        fresh.alive &= fresh.alive - 1;
      }
    }
    if (wave.alive == 0) break;
    before = wave.alive;
    shade(scene, view, wave, vertices, stats);
    finished.take(wave, before & ~wave.alive, at, row);
  }
  finished.add_to(row);
  for (u32 i = 0; i < x1 - x0; ++i) {
    carry(row[i]);
    if (features) carry(features[i]);
  }
}

Vec3 one_radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample) {
  PathStats stats = {0};
  return radiance(scene, view, x, y, sample, stats);
}

void intersect_all(const SceneView& scene, const Ray* rays, const float* limit, u64 n, bool tree,
                   Hit* hits) {
  for (u64 i = 0; i < n; ++i) intersect(scene, rays[i], limit[i], tree, hits[i]);
}

void occluded_all(const SceneView& scene, const Ray* rays, const float* limit, u64 n, bool tree,
                  u8* result) {
  for (u64 i = 0; i < n; ++i) result[i] = occluded(scene, rays[i], limit[i], kNoSlot, tree);
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

void bsdf_sample(const ParamBlock& block, Vec3 wo, SamplerKind kind, u64 seed, u64 n,
                 BsdfProbe* out) {
  with_material(block, [&](const auto& m) {
    for (u64 i = 0; i < n; ++i) {
      const u32 index = static_cast<u32>(i);
      const Sampler sampler = make_sampler(kind, 0, 0, index, seed);
      BsdfSample s = {{0, 0, 0}, {0, 0, 0}, 0.0f, 1.0f, false};
      const BsdfDraws u = {draw2(sampler, bounce_draw(1) + kDrawDirection),
                           draw1(sampler, bounce_draw(1) + kDrawLobe)};
      const bool scattered = sample(m, wo, u, s);
      if (!scattered) s.weight = {0, 0, 0};
      // As the path tracer sees it, without the change of radiance in glass.
      out[i] = {s.wi, s.weight * (s.eta * s.eta), s.pdf, s.delta};
    }
  });
}

void bsdf_eval(const ParamBlock& block, Vec3 wo, const Vec3* wi, u64 n, Vec3* value,
               float* density) {
  with_material(block, [&](const auto& m) {
    for (u64 i = 0; i < n; ++i) {
      value[i] = eval(m, wo, wi[i]);
      density[i] = pdf(m, wo, wi[i]);
    }
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
  for (u64 i = 0; i < n; ++i) out[i] = filter_offset(table, u[i]);
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels = {PH_TEXT(PH_ISA), render_row, one_radiance,  intersect_all, occluded_all,
                          bodies,          warp,       warp_pdf,      bsdf_sample,   bsdf_eval,
                          light_sample,    draws,      filter_offsets};

}  // namespace parhelion::PH_ISA
