// The path tracer: radiance along one sample's path, with direct light sampled at every bounce and
// weighed against scattering by multiple importance sampling (Veach 1997, chapter 9).
#pragma once
#include "emitter.h"
#include "light.h"

namespace parhelion {

struct PathStats {
  u64 rays;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// Bounces before the roulette may end a path.
inline constexpr u32 kRouletteStart = 4;

// The power heuristic with exponent 2, written so that a large density does not overflow.
PH_INLINE float power_heuristic(float own, float other) {
  const float ratio = other / own;
  return 1.0f / (1.0f + ratio * ratio);
}

PH_INLINE Ray ray_from(const Surface& s, Vec3 direction) {
  return {s.point, direction, s.slot, dot(direction, s.normal) < 0.0f};
}

// Where a path stands: the light gathered so far, and the ray that goes on.
struct PathState {
  Ray ray;
  Vec3 sum;
  Vec3 throughput;
  float scatter_pdf;  // of the ray's direction; 0 if no light sample could have found it
  float eta_scale;    // undoes the squeezing of radiance in glass, for the roulette
  u32 depth;          // rays so far, the camera's own included
};

// Light that arrives straight from an emissive primitive and is scattered towards wo.
template <class Material>
PH_INLINE Vec3 direct_light(const SceneView& scene, const RenderView& view, const Surface& s,
                            const Material& material, const Frame& frame, Vec3 wo,
                            const Sampler& sampler, u32 draw, PathStats& stats) {
  const float u = draw1(sampler, draw + kDrawLight);
  const Vec2 v = draw2(sampler, draw + kDrawLightPoint);
  const LightSample light = sample_light(scene, s.point, u, v);
  if (!(light.pdf > 0.0f)) return {0, 0, 0};
  const Vec3 wi = to_local(frame, light.direction);
  const Vec3 value = eval(material, wo, wi);
  if (black(value)) return {0, 0, 0};
  ++stats.rays;
  if (occluded(scene, ray_from(s, light.direction), light.distance, light.slot, view.tree)) {
    return {0, 0, 0};
  }
  const float weight = power_heuristic(light.pdf, pdf(material, wo, wi));
  return value * light.radiance * (weight / light.pdf);
}

// All that happens where a path meets a surface; false where the path ends.
template <class Material>
PH_INLINE bool bounce(const SceneView& scene, const RenderView& view, const Surface& s,
                      const Material& material, const Sampler& sampler, PathState& path,
                      PathStats& stats) {
  // Emission
  const Vec3 shine = emitted(material);
  if (!black(shine)) {
    float weight = 1.0f;
    if (path.scatter_pdf > 0.0f) {
      weight = power_heuristic(path.scatter_pdf, light_pdf(scene, s.slot, shine, path.ray.origin));
    }
    path.sum += path.throughput * shine * weight;
  }
  if (path.depth >= view.max_depth) return false;

  // Direct light
  const u32 draw = kDrawFirstBounce + (path.depth - 1) * kDrawsPerBounce;
  const Frame frame = frame_around(s.normal);
  const Vec3 wo = to_local(frame, -path.ray.direction);
  if (scene.emitter_count != 0 && !is_delta(material)) {
    path.sum +=
        path.throughput * direct_light(scene, view, s, material, frame, wo, sampler, draw, stats);
  }

  // Scattering
  BsdfSample next = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
  if (!sample(material, wo, sampler, draw, next)) return false;
  path.throughput *= next.weight;
  path.eta_scale *= next.eta * next.eta;
  path.scatter_pdf = next.delta || scene.emitter_count == 0 ? 0.0f : next.pdf;

  // Russian roulette
  const float survival = min(max_component(path.throughput) * path.eta_scale, 0.95f);
  if (!(survival > 0.0f)) return false;
  if (view.roulette && path.depth >= kRouletteStart && survival < 0.95f) {
    if (draw1(sampler, draw + kDrawRoulette) >= survival) return false;
    path.throughput *= 1.0f / survival;
  }
  path.ray = ray_from(s, renormalize(to_world(frame, next.wi)));
  ++path.depth;
  ++stats.rays;
  return true;
}

// Radiance that one sample of one pixel sees: a pure function of its arguments.
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                     PathStats& stats) {
  const Sampler sampler = make_sampler(view.sampler, x, y, sample, view.seed);
  const Vec2 place = draw2(sampler, kDrawPixel);
  const Vec2 offset = {filter_offset(view.filter, place.x), filter_offset(view.filter, place.y)};
  const Vec3 lens = uniform_disk(draw2(sampler, kDrawLens));
  PathState path = {{}, {0, 0, 0}, {1, 1, 1}, 0.0f, 1.0f, 1};
  ++stats.rays;
  if (!camera_ray(view.camera, scene.bounds, x, y, offset, lens, path.ray)) {
    return light_radiance(scene.background, path.ray.direction);
  }
  for (;;) {
    Hit hit;
    if (!intersect(scene, path.ray, kInfinity, view.tree, hit)) {
      return path.sum + path.throughput * light_radiance(scene.background, path.ray.direction);
    }
    const Surface s = surface_at(scene, path.ray, hit);
    const bool goes_on = with_material(*s.material, s.color, [&](const auto& material) {
      return bounce(scene, view, s, material, sampler, path, stats);
    });
    if (!goes_on) return path.sum;
  }
}

}  // namespace parhelion::PH_ISA
