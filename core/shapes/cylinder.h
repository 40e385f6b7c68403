// Round tubes without caps, sixteen to a block: both walls can be hit, through the open ends too.
//
// With f the way from the ray's origin to the axis' start, e the axis and d the ray's direction,
// the lines' distance is |d.(f x e)| / |d x e| and the ray is nearest to the axis at (f x e).(d x
// e) / |d x e|^2; the walls lie half a chord before and behind. As with spheres no large numbers
// are subtracted that way. Float finds the rays that pass by near enough, and double decides, so
// that tubes may be thin, long and far away, and boxes need no margin.
#pragma once
#include "point.h"

namespace parhelion {

// Rows by axis and lane; NaN in unused lanes. side: unit, perpendicular to the axis; where u is 0.
struct alignas(64) CylinderBlock {
  float start[3][16], end[3][16], side[3][16], radius[16];
  u32 id[16];
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// The normal points away from the axis.
struct Cylinder {
  Vec3 start, end, side;
  float radius;
};

PH_INLINE Cylinder primitive(const CylinderBlock& block, u32 lane) {
  return {vector_at(block.start, lane), vector_at(block.end, lane), vector_at(block.side, lane),
          block.radius[lane]};
}

PH_INLINE float area(const Cylinder& c) {
  return 2.0f * kPi * c.radius * static_cast<float>(length(difference(c.end, c.start)));
}

PH_INLINE Box bounds(const Cylinder& c) {
  const DVec3 e = difference(c.end, c.start);
  const double scale = c.radius / length(e);
  const auto half = [&](double p, double q) {
    return static_cast<float>(scale * compiler::sqrt(p * p + q * q));
  };
  const Vec3 h = {half(e.y, e.z), half(e.z, e.x), half(e.x, e.y)};
  return rounded_out(min(c.start, c.end) - h, max(c.start, c.end) + h);
}

// Where a line meets the walls: two distances, the lesser first, and whether each lies between the
// ends.
struct WallPoints {
  double t[2];
  bool between[2];
};

// Without branches all is worked out.
template <bool kBranches = true>
PH_INLINE bool cross_walls(const Cylinder& c, Vec3 origin, Vec3 direction, WallPoints& at) {
  const DVec3 f = difference(c.start, origin), e = difference(c.end, c.start);
  const DVec3 d = to_double(direction);
  const DVec3 k = cross(f, e), m = cross(d, e);
  const double mm = dot(m, m), ee = dot(e, e), r2 = static_cast<double>(c.radius) * c.radius;
  const double triple = dot(d, k);
  const double discriminant = r2 * mm - triple * triple;
  const bool meets = (discriminant >= 0.0) & (mm > 0.0);
  if (kBranches && !meets) return false;
  const double middle = dot(k, m) / mm, half = compiler::sqrt(discriminant * ee) / mm;
  // The product of the two gives the one whose size would come from a difference.
  const double q = middle < 0.0 ? middle - half : middle + half;
  const double other = q == 0.0 ? 0.0 : (dot(k, k) - r2 * ee) / (mm * q);
  at.t[0] = other < q ? other : q;
  at.t[1] = other < q ? q : other;
  for (int i = 0; i < 2; ++i) {
    const double along = at.t[i] * dot(d, e) - dot(f, e);
    at.between[i] = (along >= 0.0) & (along <= ee);
  }
  return meets;
}

// found(lane, t) for each of the block's tubes that is hit at 0 < t <= limit. self_lane: the lane
// that the ray starts on, or kNone. Of that tube only the far wall counts.
template <class Found>
PH_INLINE void intersect(const CylinderBlock& block, const Ray& ray, float limit, u32 self_lane,
                         Found&& found) {
  const LaneVec3 start = load(block.start);
  const LaneVec3 f = start - all(ray.origin), e = load(block.end) - start;
  const LaneVec3 d = all(ray.direction), m = cross(d, e);
  const Lanes r = load(block.radius), triple = dot(d, cross(f, e));
  // Rounding moves the line's distance, times |d x e|, by less than 16 kRounding |f| |e|.
  const Lanes reach =
      r * sqrt(dot(m, m)) + (sqrt(dot(f, f)) + r) * sqrt(dot(e, e)) * all(16.0f * kRounding);
  u32 candidates = bits(triple * triple <= reach * reach * all(1.0f + 16.0f * kRounding));
  for (; candidates != 0; candidates &= candidates - 1) {
    const u32 lane = lowest_bit(candidates);
    WallPoints at;
    if (!cross_walls(primitive(block, lane), ray.origin, ray.direction, at)) continue;
    const bool self = lane == self_lane;
    if (self && !ray.inward) continue;
    for (int i = self ? 1 : 0; i < 2; ++i) {
      const float t = static_cast<float>(at.t[i]);
      if (!at.between[i] || !(t > 0.0f) || !(t <= limit)) continue;
      found(lane, t);
      break;
    }
  }
}

// Where a ray meets the surface at distance t. The point is brought back onto the wall. The
// parameter is (0, the share of the way from start to end).
PH_INLINE void surface(const Cylinder& c, const Ray& ray, float t, SurfacePoint& out) {
  WallPoints at;
  const bool meets = cross_walls<false>(c, ray.origin, ray.direction, at);
  // Of two that are nearer to each other than t tells, the one first met.
  const double told = t, slack = told * 0x1p-23;
  const bool first = at.between[0] & (abs(at.t[0] - told) <= abs(at.t[1] - told) + slack);
  const double wall = first ? at.t[0] : at.t[1], best = meets ? wall : told;
  const DVec3 e = difference(c.end, c.start);
  const DVec3 p = difference(ray.origin, c.start) + to_double(ray.direction) * best;
  const double share = clamp(dot(p, e) / dot(e, e), 0.0, 1.0);
  const DVec3 normal = normalize(p - e * share);
  out.point = to_float(to_double(c.start) + e * share + normal * static_cast<double>(c.radius));
  out.normal = to_float(normal);
  out.parameter = {0.0f, static_cast<float>(share)};
  out.error = 0.0f;
}

// u is the angle from `side` over 360 degrees, counter-clockwise around the axis; v goes from start
// to end.
PH_INLINE void parametrise(const Cylinder& c, const SurfacePoint& at, Vec2& uv, Vec3& dpdu,
                           Vec3& dpdv) {
  const Vec3 axis = c.end - c.start;
  const Vec3 z = normalize(axis);
  uv = {turn(dot(at.normal, cross(z, c.side)), dot(at.normal, c.side)), at.parameter.y};
  dpdu = cross(z, at.normal) * (2.0f * kPi * c.radius);
  dpdv = axis;
}

// Along one direction there may be two points of the tube; the nearer is met, and both count for
// the density, which thus belongs to directions. Points underfoot, closer than this share of the
// radius, do not.
inline constexpr float kUnderfoot = 1e-5f;

inline float density_towards(const Cylinder& c, Vec3 from, Vec3 direction, double& nearest) {
  WallPoints at;
  nearest = 0.0;
  if (!cross_walls(c, from, direction, at)) return 0.0f;
  const DVec3 e = difference(c.end, c.start), f = difference(from, c.start),
              d = to_double(direction);
  const double ee = dot(e, e);
  double sum = 0.0;
  for (int i = 1; i >= 0; --i) {
    const double t = at.t[i];
    if (!at.between[i] || !(t > kUnderfoot * c.radius)) continue;
    const DVec3 p = f + d * t;
    const double cosine = abs(dot(p - e * (dot(p, e) / ee), d)) / c.radius;
    sum += t * t / cosine;
    nearest = t;
  }
  return static_cast<float>(sum / area(c));
}

PH_INLINE float pdf_towards(const Cylinder& c, Vec3 from, Vec3 direction, float, Vec3) {
  double nearest;
  const float pdf = density_towards(c, from, direction, nearest);
  return finite(pdf) ? pdf : 0.0f;
}

// Through a point that is uniform in area.
inline TowardsSample sample_towards(const Cylinder& c, Vec3 from, Vec2 u) {
  const DVec3 e = difference(c.end, c.start), x = to_double(c.side), y = cross(normalize(e), x);
  const CosSin angle = cos_sin_turns(u.x);
  const DVec3 out = x * static_cast<double>(angle.c) + y * static_cast<double>(angle.s);
  const DVec3 way = difference(c.start, from) + e * static_cast<double>(u.y) +
                    out * static_cast<double>(c.radius);
  TowardsSample s = towards(way, {}, {});
  double nearest;
  s.pdf = density_towards(c, from, s.direction, nearest);
  if (!(nearest > 0.0)) return kNowhere;
  SurfacePoint at;
  s.distance = static_cast<float>(nearest);
  surface(c, {from, s.direction, kNoSlot, false}, s.distance, at);
  s.normal = at.normal;
  s.parameter = at.parameter;
  return checked(s);
}

}  // namespace parhelion::PH_ISA
