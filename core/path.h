// The path tracer: what the steps of a bounce are made of, for one path at a time. Direct light is
// sampled at every bounce and weighed against scattering by multiple importance sampling (Veach
// 1997, chapter 9).
#pragma once
#include "media.h"
#include "paths.h"

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

// Where a ray sets off: beyond the reach of the point's rounding, on the side that it leaves.
PH_INLINE Vec3 ray_origin(Vec3 point, Vec3 normal, float error, bool behind) {
  // And beyond that of the sum.
  const float rounded = abs(normal.x * point.x) + abs(normal.y * point.y) + abs(normal.z * point.z);
  const float reach = error + rounded * (1.0625f * kRounding);
  const Vec3 moved = point + normal * (behind ? -reach : reach);
  return select(error > 0.0f, moved, point);
}

PH_INLINE Ray ray_from(const Surface& s, Vec3 direction) {
  const bool behind = dot(direction, s.normal) < 0.0f;
  return {ray_origin(s.point, s.normal, s.error, behind), direction, s.slot,
          behind != s.shape->inside_out};
}

// What becomes of a path at a surface: it ends, goes straight on or is scattered.
enum class Fate : u32 { ends, passes, scatters };

PH_INLINE u32 bounce_draw(u32 depth) { return kDrawFirstBounce + (depth - 1) * kDrawsPerBounce; }

// --- Shading ----------------------------------------------------------------------------------

// The normal that maps make of the interpolated one, and a direction that the frame's x axis is to
// lie near to, of surfaces whose material uses their parametrisation.
struct MappedNormal {
  Vec3 normal, along;
};

// map: what the map of normals has there, if there is one.
PH_INLINE MappedNormal mapped_normal(const SceneView& scene, const MaterialRecord& m,
                                     const Surface& s, float width, const Texel& map) {
  Vec3 n = s.shading;
  Vec3 dpdu = s.dpdu, dpdv = s.dpdv;
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
    const Vec3 c = map.rgb;
    const Vec3 local = {2.0f * c.x - 1.0f, 2.0f * c.y - 1.0f, 2.0f * c.z - 1.0f};
    const Frame f = frame_along(n, dpdu);
    // y along v, unless told otherwise: the frame is right-handed, uv need not be.
    const float side = m.normal_right_handed ? 1.0f : copysign(1.0f, dot(f.y, dpdv));
    const Vec3 mapped = f.x * local.x + f.y * (side * local.y) + n * local.z;
    const float size = length(mapped);
    if (size > 1e-6f) n = mapped * (1.0f / size);
  }
  return {n, dpdu};
}

// The least cosine of a normal that is not bent
inline constexpr float kLeastSeen = 1e-3f;

// That normal, bent towards wo where interpolation or a map has turned it away: the surface is
// seen, so it may not be black. And towards the mirrored ray, until that leaves the surface, as in
// A. Keller et al., "The Iray Light Transport Simulation and Rendering System", 2017, section on
// shading normals. normal: the geometric one.
PH_INLINE Vec3 bent_normal(Vec3 n, Vec3 normal, Vec3 wo) {
  const float side = copysign(1.0f, dot(wo, normal));
  const Vec3 outside = normal * side;
  const float cosine = side * dot(wo, n);
  n = select(cosine < kLeastSeen, normalize(n + wo * (side * (kLeastSeen - cosine))), n);
  const Vec3 mirrored = n * (2.0f * dot(wo, n)) - wo;
  const float least = min(kLeastSeen, 0.9f * dot(wo, outside));
  const float height = dot(mirrored, outside);
  const Vec3 lifted = normalize(mirrored + outside * (least - height));
  return select(height < least, normalize(wo + lifted) * side, n);
}
// Whether that is another; if not, it is the same to the last bit.
PH_INLINE bool is_bent(Vec3 n, Vec3 normal, Vec3 wo) {
  const float side = copysign(1.0f, dot(wo, normal));
  const Vec3 outside = normal * side, mirrored = n * (2.0f * dot(wo, n)) - wo;
  const float least = min(kLeastSeen, 0.9f * dot(wo, outside));
  const bool unseen = side * dot(wo, n) < kLeastSeen, inside = dot(mirrored, outside) < least;
  return unseen | inside;
}

// Whether light can pass; a surface that is opaque asks for light on the side that it is seen from.
template <class Material>
inline constexpr bool kTransmits = requires { Material::transmits; };

// Whether scattering from wo to wi, in the world, goes through the surface, as its material says by
// their cosines in the shading frame, and so does the geometry. Where they differ light would leak.
PH_INLINE bool consistent(Vec3 normal, Vec3 wo, Vec3 wi, Vec3 local_wo, Vec3 local_wi) {
  return (local_wo.z * local_wi.z > 0.0f) == (dot(wo, normal) * dot(wi, normal) > 0.0f);
}

// Light samples find what lamps send to the base of plastic, but not what its clear coat mirrors of
// them, which so is most of the noise: it is followed more often than by what it reflects, and the
// more so where no camera looks straight at it. In glass, through which lamps are seen, too, by
// less. Without lamps its share is best. How much was measured (docs/performance.md).
template <class Material>
PH_INLINE void pull_to_mirror(const SceneView& scene, u32 depth, Material& m) {
  if constexpr (requires { m.mirror_pull; }) {
    if (asks_for_light(scene)) m.mirror_pull = kTransmits<Material> || depth == 1 ? 0.5f : 2.0f;
  }
}

// --- Light ------------------------------------------------------------------------------------

// Whether a ray gets to `distance`, or before it to `target` on a side that `there` accepts, past
// what may have holes: of each such surface `passes` is told, with its opacity, and says whether
// the ray goes on.
template <class Side, class F>
PH_INLINE bool gets_past(const SceneView& scene, Ray ray, float distance, Slot target, bool tree,
                         PathStats& stats, Side&& there, F&& passes) {
  float left = distance;
  for (u32 i = 0; i < kMaxHoles; ++i) {
    ++stats.rays;
    Hit hit;
    if (!timed(stats, [&] { return intersect(scene, ray, left, tree, hit); })) return true;
    const Surface s = surface_at(scene, ray, hit);
    if (hit.slot.leaf == target.leaf && hit.slot.lane == target.lane &&
        hit.slot.instance == target.instance && there(s)) {
      return true;
    }
    if (!passes(s, clamp(opacity(scene, *s.material, s, 0.0f), 0.0f, 1.0f))) return false;
    left -= hit.t;
    ray = ray_from(s, ray.direction);
  }
  return false;
}

// Share of the light that gets through to `distance`, past holes and clear surfaces; 0 or 1 where
// there are none.
PH_INLINE Vec3 transmittance(const SceneView& scene, const Ray& ray, float distance, Slot light,
                             bool tree, PathStats& stats) {
  constexpr Vec3 kNothing = {0, 0, 0};
  Vec3 through = {1, 1, 1};
  if (!scene.has_holes) {
    ++stats.rays;
    const bool hidden = timed(stats, [&] { return occluded(scene, ray, distance, light, tree); });
    return hidden ? kNothing : through;
  }
  const auto any_side = [](const Surface&) { return true; };
  const bool arrives = gets_past(
      scene, ray, distance, light, tree, stats, any_side, [&](const Surface& s, float solid) {
        const Vec3 color = s.material->clear ? tint(scene, *s.material, s, 0.0f) : kNothing;
        through *= Vec3{1, 1, 1} * (1.0f - solid) + color * solid;
        return !black(through);
      });
  return arrives ? through : kNothing;
}

// How likely a path gets past holes to `target`, at `distance`, on its front or its back; 0 if past
// what is clear, too, which would colour it. To the far side of a sphere it is the near one that
// has to be passed.
PH_INLINE float openness(const SceneView& scene, const Ray& ray, float distance, Slot target,
                         bool front, bool tree, PathStats& stats) {
  float open = 1.0f;
  const auto same_side = [&](const Surface& s) {
    return (dot(ray.direction, s.normal) < 0.0f) == front;
  };
  const bool arrives = gets_past(scene, ray, distance, target, tree, stats, same_side,
                                 [&](const Surface& s, float solid) {
                                   open *= s.material->clear ? 0.0f : 1.0f - solid;
                                   return open > 0.0f;
                                 });
  return arrives ? open : 0.0f;
}

// Light that was scattered so many times on its way to the camera, if that is no more than it may.
PH_INLINE Vec3 bounded(Vec3 light, u32 times, float most_indirect) {
  const float most = max_component(light);
  return light * (((times > 1) & (most > most_indirect)) ? most_indirect / most : 1.0f);
}

// Light that the path's ray met by itself, weighed against the light sample that might have.
PH_INLINE void add_light(const RenderView& view, Paths& paths, u32 k, Vec3 radiance,
                         float light_density) {
  const float own = paths.scatter_pdf[k];
  const float weight = own > 0.0f ? power_heuristic(own, light_density) : 1.0f;
  const Vec3 light = paths.throughput.at(k) * radiance * weight;
  paths.sum.set(k, paths.sum.at(k) + bounded(light, paths.depth[k] - 1, view.clamp_indirect));
}

// What the surface that the path has met gives off, and the density with which a light sample would
// have found it. texture: what the texture of that has there, if it has one.
PH_INLINE LightSight emission_seen(const SceneView& scene, const Surface& s, const Texel& texture,
                                   const Paths& paths, u32 k) {
  const Vec3 direction = paths.direction.at(k);
  const bool front = dot(direction, s.normal) < 0.0f;
  const Vec3 shown =
      emits_texture(*s.material, front) ? max(texture.rgb, {0, 0, 0}) : Vec3{1, 1, 1};
  const Vec3 shine = emission(*s.material, s.color, front, shown);
  const bool asked = !black(shine) && paths.scatter_pdf[k] > 0.0f;
  return {shine, asked
                     ? emitter_pdf(scene, s, paths.receiver.at(k), paths.highlight_of(k), direction)
                     : 0.0f};
}
// Adds it, and returns it.
PH_INLINE Vec3 add_emission(const SceneView& scene, const RenderView& view, const Surface& s,
                            const Texel& texture, Paths& paths, u32 k) {
  const LightSight sight = emission_seen(scene, s, texture, paths, k);
  if (!black(sight.radiance)) add_light(view, paths, k, sight.radiance, sight.pdf);
  return sight.radiance;
}

// What the path's ray, which leaves the scene, sees of a light from outside, and the density with
// which a light sample would have found it.
PH_INLINE LightSight outside_seen(const SceneView& scene, u32 light, const Paths& paths, u32 k) {
  const LightRecord& record = scene.lights[light];
  const Vec3 direction = paths.direction.at(k);
  if (!(paths.scatter_pdf[k] > 0.0f) || light >= scene.smooth_first) {
    return {light_radiance(record, scene.tables, direction), 0.0f};
  }
  const LightSight sight = light_seen(record, scene.tables, direction);
  return {sight.radiance, scene.outside_share * record.share * sight.pdf};
}
PH_INLINE void add_outside(const SceneView& scene, const RenderView& view, u32 light, Paths& paths,
                           u32 k) {
  const LightSight sight = outside_seen(scene, light, paths, k);
  if (!black(sight.radiance)) add_light(view, paths, k, sight.radiance, sight.pdf);
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

// --- Materials ----------------------------------------------------------------------------------

// Glass whose index differs with the wavelength: red, green and blue go different ways, so the path
// goes on with one of them, chosen by how much of each it carries. False if it carries nothing.
// The index of green is `ior`; red and blue are taken at the lines C and F, between which Abbe's
// number measures (glTF's KHR_materials_dispersion, which splits the difference evenly).
template <class Material>
PH_INLINE bool disperse(Paths& paths, u32 k, Material& material) {
  u32& channel = paths.channel[k];
  if (channel == kNone) {
    const Vec3 t = paths.throughput.at(k);
    const float sum = t.x + t.y + t.z;
    if (!(sum > 0.0f)) return false;
    const float u = draw1(paths.samplers.at(k), kDrawChannel) * sum;
    channel = u < t.x ? 0 : u < t.x + t.y || !(t.z > 0.0f) ? 1 : 2;
    paths.throughput.set(
        k, Vec3{channel == 0 ? sum : 0.0f, channel == 1 ? sum : 0.0f, channel == 2 ? sum : 0.0f});
  }
  const float from_green = static_cast<float>(channel) - 1.0f;
  material.ior *= 1.0f + from_green * 0.025f * material.dispersion * (1.0f - 1.0f / material.ior);
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

// The share of a blend's second material, at the surface that `at` returns.
template <class At>
PH_INLINE float second_share(const SceneView& scene, const MaterialRecord& blend, At&& at,
                             float width) {
  const float share = scalar(scene, blend.blend_weight, blend.blend_texture, at, width);
  return clamp(share, 0.0f, 1.0f);
}
// Whether chance, `u`, makes the second of it; leaves what is left of the number in u.
PH_INLINE bool is_second(float share, float& u) {
  const bool second = u < share;
  u = (second ? u : u - share) / (second ? share : 1.0f - share);
  return second;
}

// The material that a blend leaves to chance at a surface; of others that itself.
template <class At>
PH_INLINE const MaterialRecord* chosen_material(const SceneView& scene, u32 from, At&& at,
                                                float width, float u) {
  const MaterialRecord* m = &scene.materials[from];
  while (m->blend_first != kNone) {
    const bool second = is_second(second_share(scene, *m, at, width), u);
    m = &scene.materials[second ? m->blend_second : m->blend_first];
  }
  return m;
}

// The one of a blend's two materials that a path goes on by, and its chance; and the other. What is
// a blend itself among them is left to chance.
struct BlendChoice {
  const MaterialRecord *own, *other;
  float share;
  bool second;
};
template <class At>
PH_INLINE BlendChoice choose_material(const SceneView& scene, const MaterialRecord& blend, At&& at,
                                      float width, float u) {
  const float share = second_share(scene, blend, at, width);
  const bool second = is_second(share, u);
  // In an array, since no branch could be guessed.
  const MaterialRecord* const both[2] = {chosen_material(scene, blend.blend_first, at, width, u),
                                         chosen_material(scene, blend.blend_second, at, width, u)};
  return {both[second ? 1 : 0], both[second ? 0 : 1], second ? share : 1.0f - share, second};
}

}  // namespace parhelion::PH_ISA
