// The path tracer: the steps of one sample's path, with direct light sampled at every bounce and
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

// From which bounce on the roulette may end a path, and of which that carry less than this: what
// others would lose is worth more than the time they take (docs/performance.md).
inline constexpr u32 kRouletteStart = 3;
inline constexpr float kRouletteBelow = 0.25f;
// Holes that one ray may pass.
inline constexpr u32 kMaxHoles = 1024;

// The power heuristic with exponent 3/2, written so that a large density does not overflow. Veach
// recommends 2; panoramas, which leave light to scattering, want less (docs/performance.md).
PH_INLINE float power_heuristic(float own, float other) {
  const float ratio = other / own;
  return 1.0f / (1.0f + ratio * sqrt(ratio));
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
  Hit hit;  // of the ray, once it has been traced; its slot's leaf is kNone for none
  Vec3 sum;
  Vec3 throughput;
  Receiver receiver;    // the vertex that the ray leaves
  float scatter_pdf;    // of the ray's direction; 0 if no light sample could have found it
  float eta_scale;      // undoes the squeezing of radiance in glass, for the roulette
  float width, spread;  // of the cone around the ray that stands for its neighbours: at the ray's
                        // origin, and what it grows by per unit of length
  u32 depth;            // rays so far, the camera's own included
  u32 channel;          // of red, green and blue the only one left, 0 to 2; kNone: all are there
  u32 holes;            // passed by all rays so far
  float travelled;      // from the camera
  float brightest;      // that light scattered more than once may be; RenderView::clamp_indirect
  Sampler sampler;
  Media media;
};

// Where a path has met a surface: what one step of a bounce hands on to the next.
struct Vertex {
  u32 place;  // of the path among those that are followed together
  Surface surface;
  const MaterialRecord* record;
  ParamBlock block;  // the material's parameters here
  bool front;        // the surface is seen from its outside
  bool asks;         // light is asked for
  Frame frame;       // in which the surface scatters
  Vec3 local_wo;
  Receiver receiver;
  DirectSample light;
  Vec3 value;    // the light's radiance, scattered towards wo
  float scale;   // its weight over its density
  bool crosses;  // it arrives through the surface
};

// What becomes of a path at a surface: it ends, goes straight on or is scattered.
enum class Fate : u32 { ends, passes, scatters };

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

// Adds light that was scattered so many times on its way to the camera.
PH_INLINE void add_scattered(PathState& path, Vec3 light, u32 times) {
  if (times > 1) {
    const float most = max_component(light);
    if (most > path.brightest) light *= path.brightest / most;
  }
  path.sum += light;
}

// Light that the path's ray met by itself, weighed against the light sample that might have.
PH_INLINE void add_light(PathState& path, Vec3 radiance, float light_density) {
  const float weight =
      path.scatter_pdf > 0.0f ? power_heuristic(path.scatter_pdf, light_density) : 1.0f;
  add_scattered(path, path.throughput * radiance * weight, path.depth - 1);
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

// --- The steps of a bounce --------------------------------------------------------------------

// From which side of the surface, and with which parameters and frame, the path sees the material.
template <class Material>
PH_INLINE Fate approach(const SceneView& scene, Material material, PathState& path, Vertex& v,
                        Features* features) {
  const Surface& s = v.surface;
  const Vec3 wo = -path.ray.direction;
  v.frame = shading_frame(scene, *v.record, s, wo, path.width);
  if (features && path.depth == 1) features->shading_normal = v.frame.z;
  if constexpr (requires { material.dispersion; }) {
    if (material.dispersion > 0.0f && !disperse(path.sampler, path, material)) return Fate::ends;
  }
  if constexpr (kTransmits<Material>) {
    if (!enter_boundary(scene, path.media, *v.record, v.front, material)) {
      // Within a body that takes precedence this surface is not there. It does stop the rays that
      // ask for light, so what lies behind it is found by scattering alone.
      path.scatter_pdf = 0.0f;
      path.ray = ray_from(s, path.ray.direction);
      return Fate::passes;
    }
    to_block(material, v.block);
  } else if (!v.front) {
    v.frame = {v.frame.x, -v.frame.y, -v.frame.z};  // the same surface from its other side
  }
  v.local_wo = to_local(v.frame, wo);
  const Vec3 facing = v.front ? s.normal : -s.normal;
  v.receiver = {s.point, kTransmits<Material> ? Vec3{0, 0, 0} : facing};
  v.asks = asks_for_light(scene) && !is_delta(material);
  return Fate::scatters;
}

// How much of it the surface scatters towards wo; false for nothing.
template <class Material>
PH_INLINE bool weigh(const Material& material, const PathState& path, Vertex& v) {
  const Vec3 wi = to_local(v.frame, v.light.direction);
  const Vec3 wo = -path.ray.direction;
  if (!consistent(v.surface, wo, v.light.direction, v.local_wo, wi)) return false;
  const BsdfValue f = value_of(material, v.local_wo, wi);
  if (black(f.value)) return false;
  const float weight = v.light.delta ? 1.0f : power_heuristic(v.light.pdf, f.pdf);
  v.value = f.value * v.light.radiance;
  v.scale = weight / v.light.pdf;
  v.crosses = kTransmits<Material> && wi.z * v.local_wo.z < 0.0f;
  return true;
}

// Adds the light that arrives, through the body that it reaches the surface in.
PH_INLINE void receive(const SceneView& scene, const RenderView& view, PathState& path,
                       const Vertex& v, PathStats& stats) {
  const DirectSample& light = v.light;
  const Ray ray = ray_from(v.surface, light.direction);
  const Vec3 through = transmittance(scene, ray, light.distance, light.slot, view.tree, stats);
  if (black(through)) return;
  Vec3 sum = v.value * through * v.scale;
  // A body that a ray leaves the scene from has no far side, for this ray as for the path's own.
  if (finite(light.distance)) {
    Media media = path.media;
    if (v.crosses) cross_boundary(scene, media, *v.record, v.local_wo.z > 0.0f);
    absorb(scene, media, light.distance, sum);
  }
  add_scattered(path, path.throughput * sum, path.depth);
}

// Sends the path on; false where it ends.
template <class Material>
PH_INLINE bool scatter(const SceneView& scene, const RenderView& view, const Material& material,
                       const BsdfDraws& draws, float roulette, PathState& path, const Vertex& v) {
  const Surface& s = v.surface;
  BsdfSample next = {{0, 0, 1}, {0, 0, 0}, 0.0f, 1.0f, false};
  if (!sample(material, v.local_wo, draws, next)) return false;
  const Vec3 wi = renormalize(to_world(v.frame, next.wi));
  if (!consistent(s, -path.ray.direction, wi, v.local_wo, next.wi)) return false;
  path.throughput *= next.weight;
  path.eta_scale *= next.eta * next.eta;
  path.scatter_pdf = next.delta || !asks_for_light(scene) ? 0.0f : next.pdf;
  if (!next.delta) {
    // The cone of directions that are as likely as one sample in sixty-four.
    path.spread = max(path.spread, 0.125f / sqrt(max(next.pdf, 1e-6f)));
  }
  if constexpr (kTransmits<Material>) {
    if (next.wi.z * v.local_wo.z < 0.0f) cross_boundary(scene, path.media, *v.record, v.front);
  }

  // Russian roulette
  const float carried = max_component(path.throughput) * path.eta_scale;
  const float survival = min(carried * (1.0f / kRouletteBelow), 0.95f);
  if (!(survival > 0.0f)) return false;
  if (view.roulette && path.depth >= kRouletteStart && survival < 0.95f) {
    if (roulette >= survival) return false;
    path.throughput *= 1.0f / survival;
  }
  path.ray = ray_from(s, wi);
  path.receiver = v.receiver;
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

// What is there where the path's ray has met a surface, and what it gives off.
PH_INLINE Fate meet(const SceneView& scene, const RenderView& view, PathState& path, Vertex& v,
                    Features* features, PathStats& stats) {
  const bool first = path.depth == 1;
  Surface& s = v.surface;
  s = surface_at(scene, path.ray, path.hit, features && first);
  path.width += path.spread * path.hit.t;
  path.travelled += path.hit.t;
  absorb(scene, path.media, path.hit.t, path.throughput);
  if (scene.has_holes) {
    const float solid = opacity(scene, *s.material, s, path.width);
    const u32 draw = bounce_draw(path.depth) + kDrawOpacity + path.holes * 0x10000u;
    const bool hole = solid < 1.0f && !(draw1(path.sampler, draw) < solid);
    if ((hole || s.material->clear) && path.holes < kMaxHoles) {
      if (!hole) {
        add_emission(scene, s, path);
        path.throughput *= tint(scene, *s.material, s, path.width);
      }
      path.ray = ray_from(s, path.ray.direction);
      ++path.holes;
      return Fate::passes;
    }
  }
  if (features && first) {
    features->depth = path.travelled;
    features->position = s.point;
    features->normal = s.normal;
    features->shading_normal = s.shading;
    features->uv = s.uv;
    features->shape = s.slot.instance == kNone ? static_cast<u32>(s.shape - scene.shapes)
                                               : scene.instances[s.slot.instance].shape;
    features->material = static_cast<u32>(s.material - scene.materials);
  }
  if (view.integrator == Integrator::ambient_occlusion) {
    path.sum = ambient_occlusion(scene, view, s, -path.ray.direction, path.sampler, stats);
    return Fate::ends;
  }
  v.front = dot(path.ray.direction, s.normal) < 0.0f;
  const Vec3 shine = add_emission(scene, s, path);
  const MaterialRecord& m =
      chosen_material(scene, s, v.front, path.width, path.sampler, path.depth);
  if (features && first) features->emission = shine;
  if (path.depth >= view.max_depth) return Fate::ends;
  if (!v.front && s.material->back == kNone) return Fate::ends;
  v.record = &m;
  v.block = m.binding_count != 0 ? parameters(scene, m, s, path.width) : m.block;
  if (has_color(s.color)) set_block_color(v.block, s.color);
  return Fate::scatters;
}

// What a path's ray sees that meets nothing.
PH_INLINE void leave_scene(const SceneView& scene, const RenderView& view, PathState& path) {
  if (path.depth == 1 && view.backdrop.x == view.backdrop.x) {
    path.sum += path.throughput * view.backdrop;
  } else if (view.integrator == Integrator::ambient_occlusion) {
    path.sum = {1, 1, 1};
  } else {
    for_each_outside(scene, path.ray.direction, path.scatter_pdf > 0.0f,
                     [&](Vec3 shine, float density) { add_light(path, shine, density); });
  }
}

// The path of the sample at a place in a batch, as it begins.
template <u32 kCount>
PH_INLINE void begin(const RenderView& view, const CameraBatch<kCount>& batch, u32 at,
                     PathState& path) {
  path.sampler = batch.samplers.at(at);
  path.sum = {0, 0, 0};
  path.throughput = {1, 1, 1};
  path.scatter_pdf = 0.0f;
  path.eta_scale = 1.0f;
  path.depth = 1;
  path.channel = kNone;
  path.holes = 0;
  path.media = view.media;
  path.brightest = view.clamp_indirect;
  path.travelled = batch.sight[at] == Sight::scene ? batch.start[at] : 0.0f;
  path.ray.origin = {batch.origin[0][at], batch.origin[1][at], batch.origin[2][at]};
  path.ray.direction = {batch.direction[0][at], batch.direction[1][at], batch.direction[2][at]};
  path.ray.self = kNoSlot;
  path.ray.inward = false;
  path.spread = view.camera.cone.spread;
  path.width = view.camera.cone.width + path.spread * path.travelled;
}

}  // namespace parhelion::PH_ISA
