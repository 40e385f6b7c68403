// The camera: from a place in the picture to a ray.
//
// In double, because a lens that frames a unit sphere from 1e5 radii away needs directions to
// 1e-8 radians, finer than float has them; the ray is then moved to where it enters the scene's
// bounds, and is float from there on.
#pragma once
#include "random.h"
#include "warp.h"

namespace parhelion {

struct DVec3 {
  double x, y, z;
};

// Frame: scene units (normalised), right-handed. `corner` leads from the eye to the centre of the
// top left pixel in the plane of focus, `right` and `down` from a pixel to its neighbours; the lens
// axes span the lens, their length its radius.
struct Camera {
  DVec3 eye, corner, right, down, lens_x, lens_y;
  bool outside;  // of the scene's bounds, the eye or a part of the lens
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

PH_INLINE DVec3 operator+(DVec3 a, DVec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
PH_INLINE DVec3 operator-(DVec3 a, DVec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
PH_INLINE DVec3 operator*(DVec3 a, double s) { return {a.x * s, a.y * s, a.z * s}; }
PH_INLINE double dot(DVec3 a, DVec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
PH_INLINE Vec3 to_float(DVec3 a) {
  return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}

// Distance at which a line enters a box; 0 from inside, infinity for a miss.
PH_INLINE double entry(DVec3 origin, DVec3 direction, const Box& box) {
  double near = 0.0, far = static_cast<double>(kInfinity);
  const auto clip = [&](double o, double d, double low, double high) {
    const double inverse = 1.0 / d;
    const double a = (low - o) * inverse, b = (high - o) * inverse;
    const double first = a < b ? a : b, last = a < b ? b : a;
    near = first > near ? first : near;  // NaN, a line within the plane, does not clip
    far = last < far ? last : far;
  };
  clip(origin.x, direction.x, box.low.x, box.high.x);
  clip(origin.y, direction.y, box.low.y, box.high.y);
  clip(origin.z, direction.z, box.low.z, box.high.z);
  return near <= far ? near : static_cast<double>(kInfinity);
}

// The ray through offset (dx, dy), in pixels, from the centre of pixel (x, y); y counts downwards.
// False if it passes the scene's bounds by: then only its direction has a meaning.
PH_INLINE bool camera_ray(const Camera& camera, const Box& bounds, u32 x, u32 y, Vec2 offset,
                          Vec3 lens, Ray& ray) {
  const DVec3 on_lens = camera.lens_x * lens.x + camera.lens_y * lens.y;
  const DVec3 through = camera.corner + camera.right * (static_cast<double>(x) + offset.x) +
                        camera.down * (static_cast<double>(y) + offset.y) - on_lens;
  const DVec3 direction = through * (1.0 / compiler::sqrt(dot(through, through)));
  const DVec3 origin = camera.eye + on_lens;
  const double start = camera.outside ? entry(origin, direction, bounds) : 0.0;
  ray.direction = to_float(direction);
  ray.self = kNoSlot;
  ray.inward = false;
  if (start == static_cast<double>(kInfinity)) return false;
  ray.origin = to_float(origin + direction * start);
  return true;
}

}  // namespace parhelion::PH_ISA
