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

// Light that arrives straight from an emissive primitive and is scattered towards wo.
PH_INLINE Vec3 direct_light(const SceneView& scene, const RenderView& view, const Surface& s,
                            const Frame& frame, Vec3 wo, const Sampler& sampler, u32 draw,
                            PathStats& stats) {
  const float u = draw1(sampler, draw + kDrawLight);
  const Vec2 v = draw2(sampler, draw + kDrawLightPoint);
  const LightSample light = sample_light(scene, s.point, u, v);
  if (!(light.pdf > 0.0f)) return {0, 0, 0};
  const Vec3 wi = to_local(frame, light.direction);
  struct Scattered {
    Vec3 value;
    float pdf;
  };
  const Scattered f = with_material(*s.material, s.color, [&](const auto& m) {
    return Scattered{eval(m, wo, wi), pdf(m, wo, wi)};
  });
  if (black(f.value)) return {0, 0, 0};
  ++stats.rays;
  if (occluded(scene, ray_from(s, light.direction), light.distance, light.slot, view.tree)) {
    return {0, 0, 0};
  }
  return f.value * light.radiance * (power_heuristic(light.pdf, f.pdf) / light.pdf);
}

// Radiance that one sample of one pixel sees: a pure function of its arguments.
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                     PathStats& stats) {
  const Sampler sampler = make_sampler(view.sampler, x, y, sample, view.seed);
  const Vec2 place = draw2(sampler, kDrawPixel);
  const Vec2 offset = {filter_offset(view.filter, place.x), filter_offset(view.filter, place.y)};
  const Vec3 lens = uniform_disk(draw2(sampler, kDrawLens));
  Ray ray;
  ++stats.rays;
  if (!camera_ray(view.camera, scene.bounds, x, y, offset, lens, ray)) {
    return light_radiance(scene.background, ray.direction);
  }

  Vec3 sum = {0, 0, 0};
  Vec3 throughput = {1, 1, 1};
  float scatter_pdf =
      0.0f;                // of the direction we came by; 0 if no light sample could have found it
  float eta_scale = 1.0f;  // undoes the squeezing of radiance in glass for the roulette
  for (u32 depth = 1;; ++depth) {
    Hit hit;
    if (!intersect(scene, ray, kInfinity, view.tree, hit)) {
      return sum + throughput * light_radiance(scene.background, ray.direction);
    }
    const Surface s = surface_at(scene, ray, hit);

    // Emission
    const Vec3 shine =
        with_material(*s.material, s.color, [](const auto& m) { return emitted(m); });
    if (!black(shine)) {
      float weight = 1.0f;
      if (scatter_pdf > 0.0f) {
        weight = power_heuristic(scatter_pdf, light_pdf(scene, s.slot, shine, ray.origin));
      }
      sum += throughput * shine * weight;
    }
    if (depth >= view.max_depth) return sum;

    // Direct light
    const u32 draw = kDrawFirstBounce + (depth - 1) * kDrawsPerBounce;
    const Frame frame = frame_around(s.normal);
    const Vec3 wo = to_local(frame, -ray.direction);
    const bool delta =
        with_material(*s.material, s.color, [](const auto& m) { return is_delta(m); });
    if (!delta && scene.emitter_count != 0) {
      sum += throughput * direct_light(scene, view, s, frame, wo, sampler, draw, stats);
    }

    // Scattering
    BsdfSample next = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
    const bool scattered = with_material(*s.material, s.color, [&](const auto& m) {
      return parhelion::PH_ISA::sample(m, wo, sampler, draw, next);
    });
    if (!scattered) return sum;
    throughput *= next.weight;
    eta_scale *= next.eta * next.eta;
    scatter_pdf = next.delta || scene.emitter_count == 0 ? 0.0f : next.pdf;

    // Russian roulette
    const float survival = min(max_component(throughput) * eta_scale, 0.95f);
    if (!(survival > 0.0f)) return sum;
    if (view.roulette && depth >= kRouletteStart && survival < 0.95f) {
      if (draw1(sampler, draw + kDrawRoulette) >= survival) return sum;
      throughput *= 1.0f / survival;
    }
    ray = ray_from(s, normalize(to_world(frame, next.wi)));
    ++stats.rays;
  }
}

}  // namespace parhelion::PH_ISA
