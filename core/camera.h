// The camera: from a place in the picture to a ray. All kinds behind one switch, made from
// cameras.def.
//
// In double, because a lens that frames a unit sphere from 1e5 radii away needs directions to
// 1e-8 radians, finer than float has them; the ray is then moved to where it enters the scene's
// bounds, and is float from there on.
#pragma once
#include "cameras/equirectangular.h"
#include "cameras/fisheye.h"
#include "cameras/orthographic.h"
#include "cameras/perspective.h"
#include "random.h"
#include "warp.h"

namespace parhelion {

enum class CameraKind : u32 {
#define CAMERA(name, Type) name,
#include "cameras.def"
#undef CAMERA
};

struct Camera {
  CameraKind kind;
  bool outside;  // some rays may start outside of the scene's bounds
  Cone cone;     // of a pixel
  union {
#define CAMERA(name, Type) Type name;
#include "cameras.def"
#undef CAMERA
  };
};

// What a place in the picture looks at. Where it passes the scene by, only the ray's direction has
// a meaning; where there is nothing, as around a fisheye's circle, not even that.
enum class Sight : u32 { scene, background, nothing };

}  // namespace parhelion

namespace parhelion::PH_ISA {

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
// start: the distance from the camera at which the ray enters the scene's bounds and begins.
PH_INLINE Sight camera_ray(const Camera& camera, const Box& bounds, u32 x, u32 y, Vec2 offset,
                           Vec3 lens, Ray& ray, float& start) {
  const double column = static_cast<double>(x) + offset.x, row = static_cast<double>(y) + offset.y;
  DRay full = {};
  bool sees = false;
  switch (camera.kind) {
#define CAMERA(name, Type) \
  case CameraKind::name: sees = cast(camera.name, column, row, lens, full); break;
#include "cameras.def"
#undef CAMERA
  }
  if (!sees) return Sight::nothing;
  const double far = camera.outside ? entry(full.origin, full.direction, bounds) : 0.0;
  ray.direction = to_float(full.direction);
  ray.self = kNoSlot;
  ray.inward = false;
  if (far == static_cast<double>(kInfinity)) return Sight::background;
  ray.origin = to_float(full.origin + full.direction * far);
  start = static_cast<float>(far);
  return Sight::scene;
}

}  // namespace parhelion::PH_ISA
