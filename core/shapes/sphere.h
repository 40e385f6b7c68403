// Spheres, sixteen to a block.
//
// |P - C|^2 = r^2 along P = O + t D, with f = C - O and b = f.D, has the roots b -+ sqrt(b^2 - c),
// c = f.f - r^2. In float, b^2 - c loses everything when the sphere is far away or huge. Here the
// discriminant is r^2 - |f - b D|^2, from the perpendicular that drops on the line, and the root
// that would subtract equals is had as c / q, the product of the roots being c.
// Method: Haines, Guenther and Akenine-Moeller, "Precision Improvements for Ray/Sphere
// Intersection", Ray Tracing Gems, 2019.
#pragma once
#include "point.h"

namespace parhelion {

// Unused lanes have NaN centres, which no comparison accepts. id is the primitive's place in the
// user's arrays.
struct alignas(64) SphereBlock {
  float x[16], y[16], z[16], radius[16];
  u32 id[16];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

struct Sphere {
  Vec3 center;
  float radius;
};

PH_INLINE Sphere primitive(const SphereBlock& block, u32 lane) {
  return {{block.x[lane], block.y[lane], block.z[lane]}, block.radius[lane]};
}

// How a line passes a sphere: b, the discriminant and -c. f: from the ray's origin to the centre;
// d: its direction; r: the radius. Of one ray and sixteen spheres, or of one and one.
template <class Number>
PH_INLINE void pass(Number fx, Number fy, Number fz, Number dx, Number dy, Number dz, Number r,
                    Number& along, Number& under, Number& depth) {
  const Number b = fx * dx + fy * dy + fz * dz;
  const Number px = fx - b * dx, py = fy - b * dy, pz = fz - b * dz;
  const Number r2 = r * r;
  along = b;
  under = r2 - (px * px + py * py + pz * pz);
  depth = r2 - (fx * fx + fy * fy + fz * fz);
}

// The nearest root above 0, if the discriminant and any root are.
PH_INLINE float first_root(float along, float under, float depth) {
  const float s = sqrt(under);
  const bool ahead = along > 0.0f;
  const float q = along + (ahead ? s : -s);
  const float other = -depth / q;
  // Ahead of the ray, q is the far root and c / q the near one, behind the origin if it is inside.
  return ahead && other <= 0.0f ? q : other;
}

// found(lane, t) for each of the block's spheres that is hit at 0 < t <= limit. self_lane: the lane
// that the ray starts on, or kNone.
template <class Found>
PH_INLINE void intersect(const SphereBlock& block, const Ray& ray, float limit, u32 self_lane,
                         Found&& found) {
  const Lanes fx = load(block.x) - all(ray.origin.x);
  const Lanes fy = load(block.y) - all(ray.origin.y);
  const Lanes fz = load(block.z) - all(ray.origin.z);
  Lanes b, discriminant, inside;
  pass(fx, fy, fz, all(ray.direction.x), all(ray.direction.y), all(ray.direction.z),
       load(block.radius), b, discriminant, inside);
  // Of what the line meets a root is above 0 only ahead of the origin, or around it.
  u32 touched = bits(all(0.0f) <= discriminant) & bits(all(0.0f) < max(b, inside));
  // What leaves a sphere for the outside meets it no more. kNone falls on bit 31, which is no lane.
  if (!ray.inward) touched &= ~(1u << self_lane % 32);
  if (touched == 0) return;
  // Few of sixteen are: their roots one by one are faster than sixteen at once.
  alignas(64) float along[16], under[16], depth[16];
  store(along, b);
  store(under, discriminant);
  store(depth, inside);
  do {
    const u32 lane = lowest_bit(touched);
    touched &= touched - 1;
    // Of the sphere underfoot c is 0 exactly: one root is 0, the other 2b.
    const float t = lane == self_lane ? along[lane] + along[lane]
                                      : first_root(along[lane], under[lane], depth[lane]);
    if (t > 0.0f && t <= limit) found(lane, t);
  } while (touched != 0);
}

// A bit for each of the block's spheres that some ray of a bundle may hit before `limit`.
PH_INLINE u32 intersect_bundle(const SphereBlock& block, const Bundle& rays, float limit) {
  const Lanes fx = load(block.x) - all(rays.origin.x);
  const Lanes fy = load(block.y) - all(rays.origin.y);
  const Lanes fz = load(block.z) - all(rays.origin.z);
  const Vec3 d = rays.direction;
  const Lanes far = sqrt(fx * fx + fy * fy + fz * fz);
  // Where the middle of the bundle is nearest to the centre, the rays lie around it, and a sphere
  // of this radius holds all of those that the float test takes for hits (kBoxPad).
  const Lanes along =
      max((fx * all(d.x) + fy * all(d.y) + fz * all(d.z)) * all(1.0f / dot(d, d)), all(0.0f));
  const Lanes size = load(block.radius) + all(rays.radius + kBoxPad);
  const Lanes way = min(far + size, all(limit));
  const Lanes within = size + way * all(rays.spread);
  const Lanes px = fx - along * all(d.x), py = fy - along * all(d.y), pz = fz - along * all(d.z);
  return bits(px * px + py * py + pz * pz <= within * within) & bits(far - size <= all(limit));
}

// The distances at which sixteen rays, none of which starts on a sphere, meet it; 0 where they do
// not. Axes and limits help with nothing here, and it is always true that some may.
PH_INLINE bool intersect_rays(const Sphere& s, const Rows<Vec3, kLanes>& origin,
                              const Rows<Vec3, kLanes>& direction, int, const float (&)[kLanes],
                              float (&distance)[kLanes]) {
  for (u32 k = 0; k < kLanes; ++k) {
    const Vec3 f = s.center - origin.at(k), d = direction.at(k);
    float along, under, depth;
    pass(f.x, f.y, f.z, d.x, d.y, d.z, s.radius, along, under, depth);
    const bool touched = (0.0f <= under) & (0.0f < max(along, depth));
    const float t = first_root(along, under, depth);
    distance[k] = touched ? t : 0.0f;
  }
  return true;
}

// Where a ray meets the surface at distance t. The point is brought back onto the sphere; of a ray
// that starts there the test leaves that sphere out, so nothing is to be allowed for.
PH_INLINE void surface(const Sphere& s, const Ray& ray, float t, SurfacePoint& out) {
  out.normal = normalize(ray.origin - s.center + ray.direction * t);
  out.point = s.center + out.normal * s.radius;
  out.parameter = {0.0f, 0.0f};
  out.error = 0.0f;
}

// u is the longitude over 360 degrees, 0 at the sphere's own x axis and growing towards y; v is the
// angle from its -z pole over 180 degrees. rotation: from the sphere's own frame to the scene, by
// rows. At a pole every meridian would do; the one of u = 0 is taken, and dpdu kept above 0.
PH_INLINE void parametrise(const Sphere& s, const float (&rotation)[9], const SurfacePoint& at,
                           Vec2& uv, Vec3& dpdu, Vec3& dpdv) {
  const Vec3 x = {rotation[0], rotation[3], rotation[6]};
  const Vec3 y = {rotation[1], rotation[4], rotation[7]};
  const Vec3 z = {rotation[2], rotation[5], rotation[8]};
  const Vec3 n = {dot(x, at.normal), dot(y, at.normal), dot(z, at.normal)};
  const float sine = sqrt(n.x * n.x + n.y * n.y);
  const Vec2 meridian = sine > 0.0f ? Vec2{n.x / sine, n.y / sine} : Vec2{1.0f, 0.0f};
  uv = {turn(meridian.y, meridian.x), atan2(sine, -n.z) * (1.0f / kPi)};
  dpdu = (y * meridian.x - x * meridian.y) * (2.0f * kPi * s.radius * max(sine, 1e-6f));
  dpdv = ((x * meridian.x + y * meridian.y) * -n.z + z * sine) * (kPi * s.radius);
}

PH_INLINE float area(const Sphere& s) { return 4.0f * kPi * s.radius * s.radius; }

// The cone of directions from a point that meet the sphere: 1 - cos of its half angle, or 0 from
// inside, where every direction does and sampling the cone makes no sense. Points on the sphere,
// which rounding may move outside, count as inside.
PH_INLINE float subtended_spread(const Sphere& s, Vec3 from) {
  constexpr float kOutside = 1.0f - 1e-5f;
  const Vec3 f = s.center - from;
  const float sine2 = s.radius * s.radius / dot(f, f);
  return sine2 < kOutside ? sine2 / (1.0f + sqrt(1.0f - sine2)) : 0.0f;
}

// Of a direction within that cone.
PH_INLINE float cone_pdf(const Sphere& s, Vec3 from) {
  const float spread = subtended_spread(s, from);
  return spread > 0.0f ? 1.0f / (2.0f * kPi * spread) : 0.0f;
}

// Of points on the near side: only these are sampled.
PH_INLINE float pdf_towards(const Sphere& s, Vec3 from, Vec3 direction, float distance, Vec3) {
  return distance <= dot(s.center - from, direction) ? cone_pdf(s, from) : 0.0f;
}

// Uniform in the solid angle that the sphere subtends; the density is 0 from inside. Without a
// branch, so that a loop over many spheres becomes one of vectors.
// Method: P. Shirley, C. Wang and K. Zimmerman, "Monte Carlo Techniques for Direct Lighting
// Calculations", ACM TOG 15(1), 1996, sampling by solid angle.
PH_INLINE TowardsSample sample_towards(const Sphere& s, Vec3 from, Vec2 u) {
  const float spread = subtended_spread(s, from);
  const Vec3 f = s.center - from;
  const Vec3 local = uniform_cone(u, spread);
  const Vec3 direction = to_world(frame_around(normalize(f)), local);
  const float b = dot(f, direction);
  const Vec3 perpendicular = f - direction * b;
  const float half = safe_sqrt(s.radius * s.radius - dot(perpendicular, perpendicular));
  const Vec3 normal = normalize(-(direction * half + perpendicular));
  TowardsSample t = {direction, b - half, 1.0f / (2.0f * kPi * spread), normal, {0.0f, 0.0f}};
  t.pdf = spread > 0.0f ? t.pdf : 0.0f;
  return t;
}

}  // namespace parhelion::PH_ISA
