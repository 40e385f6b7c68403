// What every light of lights.def answers. Emissive shapes are no lights in this sense.
//
// A light L, lights/NAME.h, has
//   a struct L whose members are its parameters in the order of L::params
//   outside                               it shines from infinitely far away
//   sample(l, record, tables, from, u)    a direction in which it lights a point; pdf 0 for none
//   radiance(l, record, tables, d)        what a ray that leaves the scene in direction d sees
//   pdf(l, record, tables, d)             density of sample, per steradian; 0 for delta lights,
//   or seen(l, record, tables, d)         radiance and pdf, where they are cheaper together
//   or seen(l, record, tables, lanes, weighed, d, s)   and that for some of sixteen directions, the
//                               density of those weighed, or false
//   reach(l, record, tables)              of lights that are not outside: for the light tree
// and, if it has an image, has_image = true; if it shines so evenly that scattering alone finds it
// with less noise than asking for it would, smooth = true; and if, smooth, its radiance has no
// branches and takes no tables, branchless = true: sixteen directions are then looked at at once.
//
// Directions lead from the point to the light, in the scene's frame. What depends on a frame of its
// own, such as the rows of an environment's image, is turned by the record's rotation.
#pragma once
#include "distribution.h"
#include "entry.h"
#include "image.h"
#include "warp.h"

namespace parhelion {

struct LightRecord {
  ParamBlock block;
  float to_world[9];  // rotation from the light's own frame, row-major
  Vec3 position;      // of that frame's origin, normalised units
  u32 image;
  u32 distribution;
  float share;  // of the samples that go to lights from outside, if it is one that is asked for
};

// Tables of all lights, indexed by a record's `image` and `distribution`.
struct LightTables {
  const ImageView* images;
  const Distribution* distributions;
};

struct LightSample {
  Vec3 direction;
  float distance;  // infinity from outside
  float pdf;       // per steradian; 1 for delta lights, whose radiance is divided by distance^2
  Vec3 radiance;
  bool delta;
};

// What a ray that leaves the scene sees, and the density with which sampling finds its direction.
struct LightSight {
  Vec3 radiance;
  float pdf;
};

// A local light as the light tree takes it: `power` is its radiant intensity's luminance where it
// is brightest, all directions within cos_o of `axis` being as bright; see host/light_tree.h.
struct LightReach {
  Vec3 position, axis;
  float cos_o, cos_e, power;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// That there is no light to be had.
PH_INLINE LightSample no_light() { return {{0, 0, 1}, 0.0f, 0.0f, {0, 0, 0}, false}; }

PH_INLINE Vec3 to_world(const LightRecord& r, Vec3 v) {
  const float (&m)[9] = r.to_world;
  return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
          m[6] * v.x + m[7] * v.y + m[8] * v.z};
}
PH_INLINE Vec3 to_local(const LightRecord& r, Vec3 v) {
  const float (&m)[9] = r.to_world;
  return {m[0] * v.x + m[3] * v.y + m[6] * v.z, m[1] * v.x + m[4] * v.y + m[7] * v.z,
          m[2] * v.x + m[5] * v.y + m[8] * v.z};
}

// cos and sin of an angle in degrees, from -360 to 360.
PH_INLINE CosSin cos_sin_degrees(float angle) {
  const CosSin r = cos_sin_turns(abs(angle) * (1.0f / 360.0f));
  return {r.c, copysign(1.0f, angle) * r.s};
}

// 1 - cos of half an angle in degrees: what a disk of that angular diameter spans.
PH_INLINE float disk_spread(float angle) {
  const float s = cos_sin_degrees(0.25f * angle).s;
  return 2.0f * s * s;
}

// A sample of a light at a point of the scene, whose intensity towards `from` is asked for with the
// direction from the light in the light's own frame.
template <class Intensity>
PH_INLINE LightSample sample_point(const LightRecord& record, Vec3 at, Vec3 from,
                                   Intensity&& intensity) {
  const Vec3 d = at - from;
  const float distance2 = dot(d, d);
  if (!(distance2 > 0.0f)) return no_light();
  const float distance = sqrt(distance2);
  const Vec3 direction = d * (1.0f / distance);
  const Vec3 radiance = intensity(to_local(record, -direction)) * (1.0f / distance2);
  return {direction, distance, black(radiance) ? 0.0f : 1.0f, radiance, true};
}

// A disk of constant radiance infinitely far away, `spread` being 1 - cos of its half angle.
PH_INLINE LightSample sample_disk(Vec3 toward, float spread, Vec3 radiance, Vec2 u) {
  const Vec3 direction = to_world(frame_around(toward), uniform_cone(u, spread));
  return {direction, kInfinity, 1.0f / (2.0f * kPi * spread), radiance, false};
}
PH_INLINE float disk_pdf(Vec3 toward, float spread, Vec3 direction) {
  return uniform_cone_pdf(to_local(frame_around(toward), direction), spread);
}

}  // namespace parhelion::PH_ISA
