// The kernels of one instruction set, as a table of functions. No standard header here: kernels.cpp
// includes it.
#pragma once
#include "../core/film.h"
#include "../core/user_rays.h"
#include "../core/wavefront.h"

namespace parhelion {

struct BsdfProbe {
  Vec3 wi, weight;
  float pdf;
  u32 delta;
};

struct LightProbe {
  Vec3 direction;
  float distance, pdf;
  Vec3 radiance;
  u32 delta;
};

// A square of the picture whose pixels share paths (core/wavefront/reuse.h), and which samples of
// each of them are wanted, row by row: none outside of the film.
inline constexpr u32 kRegion = 16, kRegionPixels = kRegion * kRegion;
// Samples of a pixel that begin together, from a multiple of it on: groups of the same pixels.
inline constexpr u32 kRegionSamples = 16;
struct Region {
  u32 x, y;  // of its top left pixel
  u32 from[kRegionPixels], to[kRegionPixels];
  // The film: its top left pixel in the picture, and its width.
  FilmPixel* pixels;
  FeaturePixel* features;  // null: not wanted
  u32 x0, y0, stride;
};

// Everything that is compiled once per instruction set.
struct Kernels {
  const char* name;

  // Adds samples [first, last) of pixels [x0, x1) of row y to `row`, which begins at x0, and,
  // unless it is null, to `features`.
  void (*render_row)(const SceneView&, const RenderView&, u32 y, u32 x0, u32 x1, u32 first,
                     u32 last, FilmPixel* row, FeaturePixel* features, PathStats&);
  // Adds the samples that a region wants to its film.
  void (*render_region)(const SceneView&, const RenderView&, const Region&, PathStats&);
  // The radiance of one sample.
  Vec3 (*radiance)(const SceneView&, const RenderView&, u32 x, u32 y, u32 sample, PathStats&);
  // Users' rays made ready for the next two (core/user_rays.h); false if some may be none.
  bool (*begin_rays)(const Box& bounds, double scale, bool enters, UserBatch&, RayBatch&,
                     double (&skipped)[kBatch]);
  // The nearest hits of n batches of rays, or the lanes of each that meet anything.
  void (*intersect)(const SceneView&, const RayBatch*, u64 n, bool tree, HitBatch*);
  void (*occluded)(const SceneView&, const RayBatch*, u64 n, bool tree, u32* lanes);
  // The points that n rays have met.
  void (*points_met)(const SceneView&, const HitRay*, u64 n, Met*);
  // The bodies that a point lies in, seen along a direction.
  Media (*media_around)(const SceneView&, Vec3 point, Vec3 direction, bool tree);

  // The sampling routines by themselves, for the statistical tests.
  void (*warp)(WarpKind, float parameter, const Vec2*, u64 n, Vec3*);
  void (*warp_pdf)(WarpKind, float parameter, const Vec3*, u64 n, float*);
  void (*bsdf_sample)(const ParamBlock&, Vec3 wo, SamplerKind, u64 seed, u64 n, BsdfProbe*);
  void (*bsdf_eval)(const ParamBlock&, Vec3 wo, const Vec3* wi, u64 n, Vec3* value, float* pdf);
  void (*light_sample)(const SceneView&, Vec3 from, u64 seed, u64 n, LightProbe*);
  void (*draws)(SamplerKind, u32 x, u32 y, u32 first, u64 n, u32 dimension, u64 seed, Vec2*);
  void (*filter_offsets)(const FilterTable&, const float*, u64 n, float*);
};

}  // namespace parhelion
