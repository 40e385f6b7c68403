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
  bool lens;     // where a ray starts takes random numbers
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

// Where a line lies between two planes across an axis: from near on to far.
struct Crossing {
  double near, far;
};
PH_INLINE Crossing crossing(double origin, double direction, double low, double high) {
  const double infinity = static_cast<double>(kInfinity);
  const double a = (low - origin) / direction, b = (high - origin) / direction;
  // Along the planes, also within one of them, where the above is no number.
  const double out = origin < low ? infinity : (origin > high ? infinity : -infinity);
  const bool along = direction == 0.0;
  return {along ? out : (a < b ? a : b), along ? -out : (a > b ? a : b)};
}

// Distance at which a line is about to enter a box; 0 from inside, infinity for a miss. Short of it
// by some of the box's size, and by some roundings of its corners, since what lies in its sides is
// to be met from outside.
PH_INLINE double entry(DVec3 origin, DVec3 direction, const Box& box) {
  const auto least = [](double a, double b) { return a < b ? a : b; };
  const auto most = [](double a, double b) { return a > b ? a : b; };
  const auto larger = [&](double a, double b) { return most(a < 0.0 ? -a : a, b < 0.0 ? -b : b); };
  const DVec3 low = {box.low.x, box.low.y, box.low.z};
  const DVec3 high = {box.high.x, box.high.y, box.high.z};
  const Crossing x = crossing(origin.x, direction.x, low.x, high.x);
  const Crossing y = crossing(origin.y, direction.y, low.y, high.y);
  const Crossing z = crossing(origin.z, direction.z, low.z, high.z);
  const double near = most(most(x.near, y.near), most(z.near, 0.0));
  const double far = least(least(x.far, y.far), z.far);
  const double size = (high.x - low.x) + (high.y - low.y) + (high.z - low.z);
  const double reach = larger(low.x, high.x) + larger(low.y, high.y) + larger(low.z, high.z);
  // Of bounds around nothing no number, and 0 then.
  const double before = near - (size * 0x1p-12 + reach * 0x1p-21);
  return near <= far ? most(before, 0.0) : static_cast<double>(kInfinity);
}

// Of each sample in a batch: its pixel, its random numbers, where in the pixel, and on the
// lens; then its ray, as `full` and, from where it enters the scene's bounds, `start` away from the
// camera, as the scene sees it.
template <u32 kCount>
struct CameraBatch {
  u32 x[kCount], y[kCount], sample[kCount];
  SamplerBatch<kCount> samplers;
  float offset_x[kCount], offset_y[kCount], lens_x[kCount], lens_y[kCount];
  double full_origin[3][kCount], full_direction[3][kCount];
  float origin[3][kCount], direction[3][kCount], start[kCount];
  Sight sight[kCount];
};

template <class Type, u32 kCount>
PH_INLINE void cast_batch(const Type& camera, CameraBatch<kCount>& b) {
  for (u32 i = 0; i < kCount; ++i) {
    DRay full = {};
    const bool sees = cast(camera, static_cast<double>(b.x[i]) + b.offset_x[i],
                           static_cast<double>(b.y[i]) + b.offset_y[i],
                           Vec3{b.lens_x[i], b.lens_y[i], 0.0f}, full);
    b.full_origin[0][i] = full.origin.x;
    b.full_origin[1][i] = full.origin.y;
    b.full_origin[2][i] = full.origin.z;
    b.full_direction[0][i] = full.direction.x;
    b.full_direction[1][i] = full.direction.y;
    b.full_direction[2][i] = full.direction.z;
    b.sight[i] = sees ? Sight::scene : Sight::nothing;
  }
}

// The rays through offsets, in pixels, from the centres of pixels; y counts downwards.
template <u32 kCount>
PH_INLINE void camera_rays(const Camera& camera, const Box& bounds, CameraBatch<kCount>& b) {
  switch (camera.kind) {
#define CAMERA(name, Type) \
  case CameraKind::name: cast_batch(camera.name, b); break;
#include "cameras.def"
#undef CAMERA
  }
  double far[kCount];
  for (u32 i = 0; i < kCount; ++i) far[i] = 0.0;
  if (camera.outside) {
    for (u32 i = 0; i < kCount; ++i) {
      far[i] =
          entry({b.full_origin[0][i], b.full_origin[1][i], b.full_origin[2][i]},
                {b.full_direction[0][i], b.full_direction[1][i], b.full_direction[2][i]}, bounds);
    }
  }
  for (u32 k = 0; k < 3; ++k) {
    for (u32 i = 0; i < kCount; ++i) {
      b.origin[k][i] = static_cast<float>(b.full_origin[k][i] + b.full_direction[k][i] * far[i]);
      b.direction[k][i] = static_cast<float>(b.full_direction[k][i]);
    }
  }
  for (u32 i = 0; i < kCount; ++i) {
    b.start[i] = static_cast<float>(far[i]);
    if (b.sight[i] == Sight::scene && b.start[i] == kInfinity) b.sight[i] = Sight::background;
  }
}

}  // namespace parhelion::PH_ISA
