// Flat disks and ellipses, sixteen to a block.
//
// Float finds the lines that pass a disk's bounding sphere, and double decides: what is hit and
// where is right but for the last rounding, so boxes need no margin, and a disk may be small and
// far away.
#pragma once
#include "point.h"

namespace parhelion {

// Rows by axis and lane; NaN in unused lanes. Places centre + a axis_u + b axis_v, a^2 + b^2 <= 1;
// the axes are perpendicular to each other.
struct alignas(64) DiskBlock {
  float center[3][16], axis_u[3][16], axis_v[3][16];
  u32 id[16];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// The front is where axis_u x axis_v points.
struct Disk {
  Vec3 center, axis_u, axis_v;
};

PH_INLINE Disk primitive(const DiskBlock& block, u32 lane) {
  return {vector_at(block.center, lane), vector_at(block.axis_u, lane),
          vector_at(block.axis_v, lane)};
}

// Along the normal, as long as the product of the axes.
PH_INLINE DVec3 scaled_normal(const Disk& d) {
  return cross(to_double(d.axis_u), to_double(d.axis_v));
}

PH_INLINE float area(const Disk& d) { return static_cast<float>(length(scaled_normal(d))) * kPi; }

PH_INLINE Box bounds(const Disk& d) {
  const Vec3 u = d.axis_u, v = d.axis_v;
  const Vec3 half = {sqrt(u.x * u.x + v.x * v.x), sqrt(u.y * u.y + v.y * v.y),
                     sqrt(u.z * u.z + v.z * v.z)};
  return rounded_out(d.center - half, d.center + half);
}

// Where a line crosses the disk's plane: the distance, and the place in terms of the axes. A line
// within the plane has none.
struct PlanePoint {
  double t, a, b;
};

// Without branches all is worked out.
template <bool kBranches = true>
PH_INLINE bool cross_plane(const Disk& d, Vec3 origin, Vec3 direction, PlanePoint& at) {
  const DVec3 n = scaled_normal(d), u = to_double(d.axis_u), v = to_double(d.axis_v);
  const DVec3 from = difference(origin, d.center), along = to_double(direction);
  const double slope = dot(n, along);
  const bool crosses = slope != 0.0;
  if (kBranches && !crosses) return false;
  at.t = -dot(n, from) / slope;
  const DVec3 p = from + along * at.t;
  at.a = dot(p, u) / dot(u, u);
  at.b = dot(p, v) / dot(v, v);
  return crosses;
}

// found(lane, t) for each of the block's disks that is hit at 0 < t <= limit. self_lane: the lane
// that the ray starts on, which is never hit, or kNone.
template <class Found>
PH_INLINE void intersect(const DiskBlock& block, const Ray& ray, float limit, u32 self_lane,
                         Found&& found) {
  const LaneVec3 f = load(block.center) - all(ray.origin);
  const LaneVec3 u = load(block.axis_u), v = load(block.axis_v), d = all(ray.direction);
  const LaneVec3 off = f - d * dot(f, d);
  // Of the centre's distance from the line; its rounding is below 8 kRounding times that from the
  // origin.
  const Lanes reach = sqrt(max(dot(u, u), dot(v, v))) + sqrt(dot(f, f)) * all(16.0f * kRounding);
  u32 candidates = bits(dot(off, off) <= reach * reach * all(1.0f + 16.0f * kRounding));
  if (self_lane != kNone) candidates &= ~(1u << self_lane);
  for (; candidates != 0; candidates &= candidates - 1) {
    const u32 lane = lowest_bit(candidates);
    PlanePoint at;
    if (!cross_plane(primitive(block, lane), ray.origin, ray.direction, at)) continue;
    const float t = static_cast<float>(at.t);
    if (at.a * at.a + at.b * at.b <= 1.0 && t > 0.0f && t <= limit) found(lane, t);
  }
}

// Where a ray that hits meets the surface. The parameter is the place in terms of the axes.
PH_INLINE void surface(const Disk& d, const Ray& ray, float, SurfacePoint& out) {
  PlanePoint at;
  const bool crosses = cross_plane<false>(d, ray.origin, ray.direction, at);
  const double a = crosses ? at.a : 0.0, b = crosses ? at.b : 0.0;
  place(d.center, to_double(d.axis_u) * a + to_double(d.axis_v) * b, scaled_normal(d), out);
  out.parameter = {static_cast<float>(a), static_cast<float>(b)};
}

// u is the distance from the centre, 0 to 1, v the angle from axis_u over 360 degrees. At the
// centre, where the angle means nothing, it is 0, and dpdv is kept above 0.
PH_INLINE void parametrise(const Disk& d, const SurfacePoint& at, Vec2& uv, Vec3& dpdu,
                           Vec3& dpdv) {
  const Vec2 p = at.parameter;
  const float r = sqrt(p.x * p.x + p.y * p.y);
  const Vec2 ray = r > 0.0f ? Vec2{p.x / r, p.y / r} : Vec2{1.0f, 0.0f};
  uv = {min(r, 1.0f), turn(ray.y, ray.x)};
  dpdu = d.axis_u * ray.x + d.axis_v * ray.y;
  dpdv = (d.axis_v * ray.x - d.axis_u * ray.y) * (2.0f * kPi * max(r, 1e-6f));
}

PH_INLINE float pdf_towards(const Disk& d, Vec3, Vec3 direction, float distance, Vec3 normal) {
  return pdf_by_area(area(d), direction, distance, normal);
}

// Uniform in area.
PH_INLINE TowardsSample sample_towards(const Disk& d, Vec3 from, Vec2 u) {
  const Vec3 p = uniform_disk(u);
  const DVec3 way = difference(d.center, from) + to_double(d.axis_u) * static_cast<double>(p.x) +
                    to_double(d.axis_v) * static_cast<double>(p.y);
  TowardsSample s = towards(way, to_float(normalize(scaled_normal(d))), {p.x, p.y});
  s.pdf = pdf_towards(d, from, s.direction, s.distance, s.normal);
  return checked(s);
}

}  // namespace parhelion::PH_ISA
