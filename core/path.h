// The path tracer: radiance along one sample's path, with direct light sampled at every bounce and
// weighed against scattering by multiple importance sampling (Veach 1997, chapter 9).
#pragma once
#include "emitter.h"
#include "media.h"

namespace parhelion {

struct PathStats {
  u64 rays;
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

// Bounces before the roulette may end a path.
inline constexpr u32 kRouletteStart = 4;
// Holes that one ray may pass.
inline constexpr u32 kMaxHoles = 1024;

// The power heuristic with exponent 2, written so that a large density does not overflow.
PH_INLINE float power_heuristic(float own, float other) {
  const float ratio = other / own;
  return 1.0f / (1.0f + ratio * ratio);
}

// A ray from a surface, its origin beyond the reach of the point's rounding on the side it leaves.
PH_INLINE Ray ray_from(const Surface& s, Vec3 direction) {
  const bool behind = dot(direction, s.normal) < 0.0f;
  Vec3 origin = s.point;
  if (s.error > 0.0f) {
    // And beyond that of the sum.
    const Vec3 n = s.normal, p = s.point;
    const float rounded = abs(n.x * p.x) + abs(n.y * p.y) + abs(n.z * p.z);
    const float reach = s.error + rounded * (1.0625f * kRounding);
    origin += n * (behind ? -reach : reach);
  }
  return {origin, direction, s.slot, behind != s.shape->inside_out};
}

// Where a path stands: the light gathered so far, and the ray that goes on.
struct PathState {
  Ray ray;
  Vec3 sum;
  Vec3 throughput;
  Receiver receiver;    // the vertex that the ray leaves
  float scatter_pdf;    // of the ray's direction; 0 if no light sample could have found it
  float eta_scale;      // undoes the squeezing of radiance in glass, for the roulette
  float width, spread;  // of the cone around the ray that stands for its neighbours: at the ray's
                        // origin, and what it grows by per unit of length
  u32 depth;            // rays so far, the camera's own included
  u32 channel;          // of red, green and blue the only one left, 0 to 2; kNone: all are there
  Media media;
};

PH_INLINE u32 bounce_draw(u32 depth) { return kDrawFirstBounce + (depth - 1) * kDrawsPerBounce; }

// --- Shading ----------------------------------------------------------------------------------

// The frame in which a surface scatters. Its normal is bent towards wo where interpolation or a
// normal map has turned it away: the surface is seen, so it may not be black.
PH_INLINE Frame shading_frame(const SceneView& scene, const MaterialRecord& m, const Surface& s,
                              Vec3 wo, float width) {
  Vec3 n = s.shading;
  Vec3 dpdu = s.dpdu, dpdv = s.dpdv;
  if (m.uses_uv) {
    if (m.bump_map != kNone) {
      const Vec2 slope = bump_slope(scene, m.bump_map, s, width) * m.bump_scale;
      const Vec3 u = s.dpdu + n * slope.x, v = s.dpdv + n * slope.y;
      const Vec3 bumped = cross(u, v);
      const float size = length(bumped);
      if (size > 0.0f && finite(size)) {
        n = bumped * (copysign(1.0f, dot(bumped, n)) / size);
        dpdu = u;
      }
    }
    own_axes(scene, s, n, dpdu, dpdv);
    if (m.normal_map != kNone) {
      const Vec3 c = texel(scene, m.normal_map, s, width).rgb;
      const Vec3 local = {2.0f * c.x - 1.0f, 2.0f * c.y - 1.0f, 2.0f * c.z - 1.0f};
      const Frame f = frame_along(n, dpdu);
      // y along v, unless told otherwise: the frame is right-handed, uv need not be.
      const float side = m.normal_right_handed ? 1.0f : copysign(1.0f, dot(f.y, dpdv));
      const Vec3 mapped = f.x * local.x + f.y * (side * local.y) + n * local.z;
      const float size = length(mapped);
      if (size > 1e-6f) n = mapped * (1.0f / size);
    }
  }
  // And towards the mirrored ray, until that leaves the surface, as in A. Keller et al., "The Iray
  // Light Transport Simulation and Rendering System", 2017, section on shading normals.
  const float side = copysign(1.0f, dot(wo, s.normal));
  const Vec3 outside = s.normal * side;
  constexpr float kLeast = 1e-3f;
  const float cosine = side * dot(wo, n);
  if (cosine < kLeast) n = normalize(n + wo * (side * (kLeast - cosine)));
  const Vec3 mirrored = n * (2.0f * dot(wo, n)) - wo;
  const float least = min(kLeast, 0.9f * dot(wo, outside));
  const float height = dot(mirrored, outside);
  if (height < least) {
    n = normalize(wo + normalize(mirrored + outside * (least - height))) * side;
  }
  return m.uses_uv ? frame_along(n, dpdu) : frame_around(n);
}

// Where light asked for by an opaque surface comes from: the side that it is seen from.
template <class Material>
inline constexpr bool kTransmits = requires { Material::transmits; };

// Whether scattering from wo to wi, in the world, goes through the surface, as its material says by
// their cosines in the shading frame, and so does the geometry. Where they differ light would leak.
PH_INLINE bool consistent(const Surface& s, Vec3 wo, Vec3 wi, Vec3 local_wo, Vec3 local_wi) {
  return (local_wo.z * local_wi.z > 0.0f) == (dot(wo, s.normal) * dot(wi, s.normal) > 0.0f);
}

// --- Light ------------------------------------------------------------------------------------

// Share of the light that gets through to `distance`, past holes and clear surfaces; 0 or 1 where
// there are none.
PH_INLINE Vec3 transmittance(const SceneView& scene, Ray ray, float distance, Slot light, bool tree,
                             PathStats& stats) {
  ++stats.rays;
  Vec3 through = {1, 1, 1};
  if (!scene.has_holes) {
    return occluded(scene, ray, distance, light, tree) ? Vec3{0, 0, 0} : through;
  }
  float left = distance;
  for (u32 i = 0; i < kMaxHoles; ++i) {
    Hit hit;
    if (!intersect(scene, ray, left, tree, hit)) return through;
    if (hit.slot.leaf == light.leaf && hit.slot.lane == light.lane &&
        hit.slot.instance == light.instance) {
      return through;
    }
    const Surface s = surface_at(scene, ray, hit);
    const float solid = clamp(opacity(scene, *s.material, s, 0.0f), 0.0f, 1.0f);
    const Vec3 color = s.material->clear ? tint(scene, *s.material, s, 0.0f) : Vec3{0, 0, 0};
    through *= Vec3{1, 1, 1} * (1.0f - solid) + color * solid;
    if (black(through)) return through;
    left -= hit.t;
    ray = ray_from(s, ray.direction);
    ++stats.rays;
  }
  return {0, 0, 0};
}

// Light that arrives straight from a light, through the body that it reaches the surface in, and is
// scattered towards wo.
template <class Material>
PH_INLINE Vec3 direct_light(const SceneView& scene, const RenderView& view, const Surface& s,
                            const MaterialRecord& record, const Material& material,
                            const Frame& frame, Vec3 wo, Vec3 local_wo, const Receiver& receiver,
                            Media media, const Sampler& sampler, u32 draw, PathStats& stats) {
  const Vec2 u = draw2(sampler, draw + kDrawLight);
  const Vec2 v = draw2(sampler, draw + kDrawLightPoint);
  const DirectSample light = sample_lights(scene, receiver, u, v);
  if (!(light.pdf > 0.0f) || black(light.radiance)) return {0, 0, 0};
  const Vec3 wi = to_local(frame, light.direction);
  if (!consistent(s, wo, light.direction, local_wo, wi)) return {0, 0, 0};
  const Vec3 value = eval(material, local_wo, wi);
  if (black(value)) return {0, 0, 0};
  const Ray ray = ray_from(s, light.direction);
  const Vec3 through = transmittance(scene, ray, light.distance, light.slot, view.tree, stats);
  if (black(through)) return {0, 0, 0};
  const float weight = light.delta ? 1.0f : power_heuristic(light.pdf, pdf(material, local_wo, wi));
  Vec3 sum = value * light.radiance * through * (weight / light.pdf);
  if constexpr (kTransmits<Material>) {
    if (wi.z * local_wo.z < 0.0f) cross_boundary(scene, media, record, local_wo.z > 0.0f);
  }
  // A body that a ray leaves the scene from has no far side, for this ray as for the path's own.
  if (finite(light.distance)) absorb(scene, media, light.distance, sum);
  return sum;
}

// Light that the path's ray met by itself, weighed against the light sample that might have.
PH_INLINE void add_light(PathState& path, Vec3 radiance, float light_density) {
  const float weight =
      path.scatter_pdf > 0.0f ? power_heuristic(path.scatter_pdf, light_density) : 1.0f;
  path.sum += path.throughput * radiance * weight;
}

// --- Bodies around a point ---------------------------------------------------------------------

// The bodies that a point lies in: those that a ray from there leaves without having entered them.
// The last that it leaves was entered first.
inline Media media_around(const SceneView& scene, Vec3 point, Vec3 direction, bool tree) {
  Media around, entered;
  around.count = entered.count = 0;
  Ray ray = {point, direction, kNoSlot, false};
  Hit hit;
  for (u32 i = 0; i < kMaxHoles && intersect(scene, ray, kInfinity, tree, hit); ++i) {
    const Surface s = surface_at(scene, ray, hit);
    const MaterialRecord& m = *s.material;
    ray = ray_from(s, direction);
    const u32 before = entered.count;
    const bool front = dot(direction, s.normal) < 0.0f;
    cross_boundary(scene, entered, m, front);
    if (!front && entered.count == before) cross_boundary(scene, around, m, true);
  }
  for (u32 i = 0, k = around.count; i + 1 < k--; ++i) {
    const u32 swapped = around.record[i];
    around.record[i] = around.record[k];
    around.record[k] = swapped;
  }
  return around;
}

// --- Dispersion -------------------------------------------------------------------------------

// Glass whose index differs with the wavelength: red, green and blue go different ways, so the path
// goes on with one of them, chosen by how much of each it carries. False if it carries nothing.
// The index of green is `ior`; red and blue are taken at the lines C and F, between which Abbe's
// number measures (glTF's KHR_materials_dispersion, which splits the difference evenly).
template <class Material>
PH_INLINE bool disperse(const Sampler& sampler, PathState& path, Material& material) {
  if (path.channel == kNone) {
    const Vec3 t = path.throughput;
    const float sum = t.x + t.y + t.z;
    if (!(sum > 0.0f)) return false;
    const float u = draw1(sampler, kDrawChannel) * sum;
    path.channel = u < t.x ? 0 : u < t.x + t.y || !(t.z > 0.0f) ? 1 : 2;
    path.throughput = {path.channel == 0 ? sum : 0.0f, path.channel == 1 ? sum : 0.0f,
                       path.channel == 2 ? sum : 0.0f};
  }
  const float from_green = static_cast<float>(path.channel) - 1.0f;
  material.ior *= 1.0f + from_green * 0.025f * material.dispersion * (1.0f - 1.0f / material.ior);
  return true;
}

// --- Bounces ----------------------------------------------------------------------------------

// Scattering where a path meets a surface; false where the path ends.
template <class Material>
PH_INLINE bool scatter(const SceneView& scene, const RenderView& view, const Surface& s,
                       const MaterialRecord& record, Material material, const Sampler& sampler,
                       PathState& path, PathStats& stats, Features* features) {
  const u32 draw = bounce_draw(path.depth);
  const Vec3 wo = -path.ray.direction;
  const bool front = dot(wo, s.normal) > 0.0f;
  Frame frame = shading_frame(scene, record, s, wo, path.width);
  if (features && path.depth == 1) features->shading_normal = frame.z;
  if constexpr (requires { material.dispersion; }) {
    if (material.dispersion > 0.0f && !disperse(sampler, path, material)) return false;
  }
  if constexpr (kTransmits<Material>) {
    if (!enter_boundary(scene, path.media, record, front, material)) {
      // Within a body that takes precedence this surface is not there. It does stop the rays that
      // ask for light, so what lies behind it is found by scattering alone.
      path.scatter_pdf = 0.0f;
      path.ray = ray_from(s, path.ray.direction);
      return true;
    }
  } else if (!front) {
    frame = {frame.x, -frame.y, -frame.z};  // the same surface from its other side
  }
  const Vec3 local_wo = to_local(frame, wo);

  // Direct light
  const Vec3 facing = front ? s.normal : -s.normal;
  const Receiver receiver = {s.point, kTransmits<Material> ? Vec3{0, 0, 0} : facing};
  const bool lit = asks_for_light(scene);
  if (lit && !is_delta(material)) {
    path.sum +=
        path.throughput * direct_light(scene, view, s, record, material, frame, wo, local_wo,
                                       receiver, path.media, sampler, draw, stats);
  }

  // Scattering
  BsdfSample next = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
  if (!sample(material, local_wo, sampler, draw, next)) return false;
  const Vec3 wi = renormalize(to_world(frame, next.wi));
  if (!consistent(s, wo, wi, local_wo, next.wi)) return false;
  path.throughput *= next.weight;
  path.eta_scale *= next.eta * next.eta;
  path.scatter_pdf = next.delta || !lit ? 0.0f : next.pdf;
  if (!next.delta) {
    // The cone of directions that are as likely as one sample in sixty-four.
    path.spread = max(path.spread, 0.125f / sqrt(max(next.pdf, 1e-6f)));
  }
  if constexpr (kTransmits<Material>) {
    if (next.wi.z * local_wo.z < 0.0f) cross_boundary(scene, path.media, record, front);
  }

  // Russian roulette
  const float survival = min(max_component(path.throughput) * path.eta_scale, 0.95f);
  if (!(survival > 0.0f)) return false;
  if (view.roulette && path.depth >= kRouletteStart && survival < 0.95f) {
    if (draw1(sampler, draw + kDrawRoulette) >= survival) return false;
    path.throughput *= 1.0f / survival;
  }
  path.ray = ray_from(s, wi);
  path.receiver = receiver;
  ++path.depth;
  return true;
}

// Share of the light that a material gives back, for features: its colour, where it says no better.
template <class Material>
PH_INLINE Vec3 albedo_of(const Material& m) {
  if constexpr (requires { albedo(m); }) {
    return albedo(m);
  } else if constexpr (requires { m.color; }) {
    return m.color;
  } else {
    return {0, 0, 0};
  }
}

// The material at a surface, of those that a blend leaves to chance.
PH_INLINE const MaterialRecord& chosen_material(const SceneView& scene, const Surface& s,
                                                bool front, float width, const Sampler& sampler,
                                                u32 depth) {
  const MaterialRecord* m = s.material;
  if (!front && m->back != kNone) m = &scene.materials[m->back];
  if (m->blend_first == kNone) return *m;
  float u = draw1(sampler, bounce_draw(depth) + kDrawBlend);
  while (m->blend_first != kNone) {
    const float weight =
        clamp(scalar(scene, m->blend_weight, m->blend_texture, s, width), 0.0f, 1.0f);
    const bool second = u < weight;
    u = second ? u / weight : (u - weight) / (1.0f - weight);
    m = &scene.materials[second ? m->blend_second : m->blend_first];
  }
  return *m;
}

// Adds what the surface that the path has met gives off, and returns it.
PH_INLINE Vec3 add_emission(const SceneView& scene, const Surface& s, PathState& path) {
  const Vec3 shine = emission(scene, *s.material, s, dot(path.ray.direction, s.normal) < 0.0f);
  if (!black(shine)) {
    const float density =
        path.scatter_pdf > 0.0f ? emitter_pdf(scene, s, path.receiver, path.ray.direction) : 0.0f;
    add_light(path, shine, density);
  }
  return shine;
}

// All that happens where a path meets a surface; false where the path ends.
PH_INLINE bool bounce(const SceneView& scene, const RenderView& view, const Surface& s,
                      const Sampler& sampler, PathState& path, PathStats& stats,
                      Features* features) {
  const bool front = dot(path.ray.direction, s.normal) < 0.0f;
  const Vec3 shine = add_emission(scene, s, path);
  const MaterialRecord& m = chosen_material(scene, s, front, path.width, sampler, path.depth);
  if (features && path.depth == 1) features->emission = shine;
  if (path.depth >= view.max_depth) return false;
  if (!front && s.material->back == kNone) return false;
  ParamBlock textured;
  const ParamBlock* block = &m.block;
  if (m.binding_count != 0) {
    textured = parameters(scene, m, s, path.width);
    block = &textured;
  }
  const Vec3 color = has_color(s.color) ? s.color : block_color(*block);
  return with_material(*block, color, [&](const auto& material) {
    if (features && path.depth == 1) features->albedo = albedo_of(material);
    return scatter(scene, view, s, m, material, sampler, path, stats, features);
  });
}

// How open the surroundings of the first surface are.
inline Vec3 ambient_occlusion(const SceneView& scene, const RenderView& view, const Surface& s,
                              Vec3 wo, const Sampler& sampler, PathStats& stats) {
  Vec3 n = s.shading;
  if (dot(wo, s.normal) < 0.0f) n = -n;
  const Vec3 wi =
      to_world(frame_around(n), cosine_hemisphere(draw2(sampler, bounce_draw(1) + kDrawDirection)));
  if (dot(wi, s.normal) * dot(wo, s.normal) <= 0.0f) return {0, 0, 0};
  return transmittance(scene, ray_from(s, renormalize(wi)), view.ao_distance, kNoSlot, view.tree,
                       stats);
}

// How the samples of a batch begin, whose pixels in row y and numbers are given.
template <u32 kCount>
PH_INLINE void begin_paths(const SceneView& scene, const RenderView& view, u32 y,
                           CameraBatch<kCount>& b) {
  float place_x[kCount], place_y[kCount], lens_x[kCount], lens_y[kCount];
  for (u32 i = 0; i < kCount; ++i) {
    const Sampler sampler = make_sampler(view.sampler, b.x[i], y, b.sample[i], view.seed);
    const Vec2 place = draw2(sampler, kDrawPixel), lens = draw2(sampler, kDrawLens);
    place_x[i] = place.x, place_y[i] = place.y;
    lens_x[i] = lens.x, lens_y[i] = lens.y;
  }
  for (u32 i = 0; i < kCount; ++i) b.offset_x[i] = filter_offset(view.filter, place_x[i]);
  for (u32 i = 0; i < kCount; ++i) b.offset_y[i] = filter_offset(view.filter, place_y[i]);
  for (u32 i = 0; i < kCount; ++i) {
    const Vec3 lens = uniform_disk({lens_x[i], lens_y[i]});
    b.lens_x[i] = lens.x, b.lens_y[i] = lens.y;
  }
  camera_rays(view.camera, scene.bounds, y, b);
}

// Radiance that one sample of one pixel sees: a pure function of pixel and sample, which begins as
// the batch has it at place `at`.
template <u32 kCount>
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 y,
                     const CameraBatch<kCount>& batch, u32 at, PathStats& stats,
                     Features* features) {
  const Sampler sampler = make_sampler(view.sampler, batch.x[at], y, batch.sample[at], view.seed);
  PathState path;
  path.sum = {0, 0, 0};
  path.throughput = {1, 1, 1};
  path.scatter_pdf = 0.0f;
  path.eta_scale = 1.0f;
  path.depth = 1;
  path.channel = kNone;
  path.media = view.media;
  if (features) *features = {0, {}, {}, {}, {}, {}, {}, {}, kNone, kNone};
  ++stats.rays;
  const Sight sight = batch.sight[at];
  if (sight == Sight::nothing) return {0, 0, 0};
  const float start = sight == Sight::scene ? batch.start[at] : 0.0f;
  path.ray.origin = {batch.origin[0][at], batch.origin[1][at], batch.origin[2][at]};
  path.ray.direction = {batch.direction[0][at], batch.direction[1][at], batch.direction[2][at]};
  path.ray.self = kNoSlot;
  path.ray.inward = false;
  path.spread = view.camera.cone.spread;
  path.width = view.camera.cone.width + path.spread * start;
  u32 holes = 0;
  float travelled = 0.0f;  // by all rays so far
  for (;;) {
    Hit hit;
    if (sight == Sight::background || !intersect(scene, path.ray, kInfinity, view.tree, hit)) {
      if (path.depth == 1 && view.backdrop.x == view.backdrop.x) {
        path.sum += path.throughput * view.backdrop;
        break;
      }
      if (view.integrator == Integrator::ambient_occlusion) return {1, 1, 1};
      for_each_outside(scene, path.ray.direction, path.scatter_pdf > 0.0f,
                       [&](Vec3 shine, float density) { add_light(path, shine, density); });
      break;
    }
    const Surface s = surface_at(scene, path.ray, hit, features && path.depth == 1);
    path.width += path.spread * hit.t;
    travelled += hit.t;
    absorb(scene, path.media, hit.t, path.throughput);
    if (scene.has_holes) {
      const float solid = opacity(scene, *s.material, s, path.width);
      const bool hole =
          solid < 1.0f &&
          !(draw1(sampler, bounce_draw(path.depth) + kDrawOpacity + holes * 0x10000u) < solid);
      if ((hole || s.material->clear) && holes < kMaxHoles) {
        if (!hole) {
          add_emission(scene, s, path);
          path.throughput *= tint(scene, *s.material, s, path.width);
        }
        path.ray = ray_from(s, path.ray.direction);
        ++holes;
        ++stats.rays;
        continue;
      }
    }
    if (features && path.depth == 1) {
      features->depth = start + travelled;
      features->position = s.point;
      features->normal = s.normal;
      features->shading_normal = s.shading;
      features->uv = s.uv;
      features->shape = s.slot.instance == kNone ? static_cast<u32>(s.shape - scene.shapes)
                                                 : scene.instances[s.slot.instance].shape;
      features->material = static_cast<u32>(s.material - scene.materials);
    }
    if (view.integrator == Integrator::ambient_occlusion) {
      return ambient_occlusion(scene, view, s, -path.ray.direction, sampler, stats);
    }
    const bool goes_on = bounce(scene, view, s, sampler, path, stats, features);
    if (features && path.depth <= 2) features->direct = path.sum - features->emission;
    if (!goes_on) break;
    ++stats.rays;
  }
  if (features && path.depth <= 2) features->direct = path.sum - features->emission;
  return path.sum;
}

// The same of a sample by itself.
inline Vec3 radiance(const SceneView& scene, const RenderView& view, u32 x, u32 y, u32 sample,
                     PathStats& stats, Features* features) {
  CameraBatch<1> batch = {};
  batch.x[0] = x;
  batch.sample[0] = sample;
  begin_paths(scene, view, y, batch);
  return radiance(scene, view, y, batch, 0, stats, features);
}

}  // namespace parhelion::PH_ISA
