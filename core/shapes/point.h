// What every shape says of the places on it, and the algebra in double that some of them need.
#pragma once
#include "../projection.h"
#include "../rows.h"
#include "../special.h"
#include "../warp.h"

namespace parhelion::PH_ISA {

// Where a ray has met a primitive. Normalised units.
struct SurfacePoint {
  Vec3 point;
  Vec3 normal;     // geometric, outward, unit
  Vec2 parameter;  // weights of a triangle's second and third vertex; of other shapes what their
                   // parametrise() needs beside point and normal
  float error;     // bound on the point's distance from the true surface; 0 of shapes that a ray
                   // starting on them meets again only where it should
};

// A direction from a point towards a primitive.
struct TowardsSample {
  Vec3 direction;  // unit
  float distance;
  float pdf;       // per steradian; 0 if there is none
  Vec3 normal;     // of the point met: geometric, outward, unit
  Vec2 parameter;  // as in SurfacePoint
};
inline constexpr TowardsSample kNowhere = {{0, 0, 1}, 0.0f, 0.0f, {0, 0, 1}, {0, 0}};

// Half the spacing of floats around 1: the relative error of one rounding.
inline constexpr float kRounding = 0x1p-24f;

// Coordinates are below 1; rays start within the scene or, in the frame of an instanced group, no
// farther from 0 than 2.7. So nothing is farther from an origin than 4 along an axis, and the
// difference of two coordinates is wrong by 4 kRounding at most.
// A test that works on such differences finds a primitive displaced by some of those. The boxes of
// primitives are padded by this many normalised units, which is more than any of them adds up to,
// so that whatever is hit is hit within its box.
inline constexpr float kBoxPad = 0x1p-19f;

PH_INLINE Box padded(Vec3 low, Vec3 high) {
  const Vec3 pad = {kBoxPad, kBoxPad, kBoxPad};
  return {low - pad, high + pad};
}

PH_INLINE float component(Vec3 a, int axis) { return axis == 0 ? a.x : axis == 1 ? a.y : a.z; }
PH_INLINE int next_axis(int axis) { return axis == 2 ? 0 : axis + 1; }
// Along which a direction's component is the largest; without a branch.
PH_INLINE int fastest_axis(Vec3 d) {
  const float ax = abs(d.x), ay = abs(d.y), az = abs(d.z);
  const bool along_x = (ax >= ay) & (ax >= az);
  return along_x ? 0 : ay >= az ? 1 : 2;
}
PH_INLINE Vec3 min(Vec3 a, Vec3 b) { return {min(a.x, b.x), min(a.y, b.y), min(a.z, b.z)}; }
PH_INLINE Vec3 max(Vec3 a, Vec3 b) { return {max(a.x, b.x), max(a.y, b.y), max(a.z, b.z)}; }

PH_INLINE DVec3 to_double(Vec3 a) { return {a.x, a.y, a.z}; }
// The product of two floats is exact in double, so is nearly always the difference, and so these
// two keep what float would lose of a point seen from close by.
PH_INLINE DVec3 difference(Vec3 a, Vec3 b) { return to_double(a) - to_double(b); }
PH_INLINE DVec3 cross(DVec3 a, DVec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
PH_INLINE DVec3 normalize(DVec3 a) { return a * (1.0 / length(a)); }
PH_INLINE double clamp(double x, double low, double high) {
  return x < low ? low : x > high ? high : x;
}

// A box that holds another one whose corners have been rounded a few times.
PH_INLINE Box rounded_out(Vec3 low, Vec3 high) {
  const auto margin = [](float a, float b) { return max(abs(a), abs(b)) * (8.0f * kRounding); };
  const Vec3 m = {margin(low.x, high.x), margin(low.y, high.y), margin(low.z, high.z)};
  return {low - m, high + m};
}

// The angle of a plane's point from the x axis, as a share of a turn in [0, 1].
PH_INLINE float turn(float y, float x) {
  const float t = atan2(y, x) * (0.5f / kPi);
  return t < 0.0f ? t + 1.0f : t;
}

// A flat shape's point: put together in double and rounded once; what that moves it off the plane
// is measured. n: along the normal, of any length.
PH_INLINE void place(Vec3 start, DVec3 way, DVec3 n, SurfacePoint& out) {
  const double size = length(n);
  out.point = to_float(to_double(start) + way);
  // 1 + 2^-20 covers the roundings of the measure itself.
  out.error =
      static_cast<float>(abs(dot(n, difference(out.point, start))) / size * (1.0 + 0x1p-20));
  out.normal = to_float(n * (1.0 / size));
}

// --- Sixteen vectors ----------------------------------------------------------------------------
struct LaneVec3 {
  Lanes x, y, z;
};

PH_INLINE LaneVec3 load(const float (&rows)[3][16]) {
  return {load(rows[0]), load(rows[1]), load(rows[2])};
}
PH_INLINE Vec3 vector_at(const float (&rows)[3][16], u32 lane) {
  return {rows[0][lane], rows[1][lane], rows[2][lane]};
}
PH_INLINE LaneVec3 all(Vec3 a) { return {all(a.x), all(a.y), all(a.z)}; }
PH_INLINE LaneVec3 operator-(const LaneVec3& a, const LaneVec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
PH_INLINE LaneVec3 operator*(const LaneVec3& a, const Lanes& s) {
  return {a.x * s, a.y * s, a.z * s};
}
PH_INLINE Lanes dot(const LaneVec3& a, const LaneVec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
PH_INLINE LaneVec3 cross(const LaneVec3& a, const LaneVec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// --- Rays that lie close together ---------------------------------------------------------------

struct Bundle {
  // Bounds of the rays' origins, wider by kBoxPad along axes along which none moves, and of the
  // inverses of their directions (there kSteep), whose signs are the same
  Vec3 low, high, inverse_low, inverse_high;
  u32 sign[3];
  // What lies in the middle of them; the direction need not be a unit long. How far they are off it
  // along each axis, and in all.
  Vec3 origin, direction;
  Vec3 origin_off, direction_off;
  float radius, spread;
  int along;  // the axis along which all run fastest
};

// --- Directions towards points of a surface -----------------------------------------------------

// The density per steradian of a point that is uniform in area.
PH_INLINE float pdf_by_area(float area, Vec3 direction, float distance, Vec3 normal) {
  const float projected = abs(dot(normal, direction)) * area;
  return projected > 0.0f ? distance * distance / projected : 0.0f;
}

// The sample of the point that lies `way` from where one looks; the density is yet to come.
PH_INLINE TowardsSample towards(DVec3 way, Vec3 normal, Vec2 parameter) {
  const double distance = length(way);
  return {to_float(way * (1.0 / distance)), static_cast<float>(distance), 0.0f, normal, parameter};
}

// None, where a point has no direction or its density no bound.
PH_INLINE TowardsSample checked(const TowardsSample& s) {
  const bool good = finite(s.direction) && finite(s.distance) && finite(s.pdf);
  TowardsSample out = s;
  out.direction = {good ? s.direction.x : 0.0f, good ? s.direction.y : 0.0f,
                   good ? s.direction.z : 1.0f};
  out.distance = good ? s.distance : 0.0f;
  out.pdf = good ? s.pdf : 0.0f;
  return out;
}

}  // namespace parhelion::PH_ISA
