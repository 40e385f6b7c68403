// What every camera answers.
//
// A camera C, cameras/NAME.h, has
//   a struct C of plain data, in double, with C::doc and C::traits
//   place(placement, c)     fills it in; the host has checked the placement
//   cast(c, x, y, lens, r)  the ray through a place in the picture; false where it sees nothing
//   cone(c)                 what a pixel in the picture's middle sees
// x and y count pixels to the right and down from the centre of the top left one.
#pragma once
#include "math.h"

namespace parhelion {

struct DVec3 {
  double x, y, z;
};

struct DRay {
  DVec3 origin, direction;  // unit direction
};

// What a kind of camera can be told.
struct CameraTraits {
  double preset_vfov, max_vfov;  // degrees; 0 if it has no field of view
  bool fov;                      // may be told the horizontal one
  bool lens, height, shift;
  bool central;  // all rays start on the lens; else anywhere in the picture's plane
};

// Where a camera stands and what it is told, in the scene's normalised units.
struct Placement {
  DVec3 eye;
  DVec3 forward, right, down;  // unit and perpendicular; as the picture has them
  double columns, rows;        // of pixels
  double fov, vfov;            // degrees; one of them is 0
  double focus, aperture;      // distance of the plane in focus, radius of the lens
  double height;               // of what the picture shows
  double shift_x, shift_y;     // of the picture's middle, in its widths and heights
};

// The round cone around a ray that covers a pixel: its width where the ray starts, in normalised
// units, and by how much it grows along a unit.
// Method: Amanatides, "Ray tracing with cones", SIGGRAPH 1984.
struct Cone {
  float width, spread;
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

PH_INLINE DVec3 operator+(DVec3 a, DVec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
PH_INLINE DVec3 operator-(DVec3 a, DVec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
PH_INLINE DVec3 operator*(DVec3 a, double s) { return {a.x * s, a.y * s, a.z * s}; }
PH_INLINE double dot(DVec3 a, DVec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
PH_INLINE double length(DVec3 a) { return compiler::sqrt(dot(a, a)); }
PH_INLINE Vec3 to_float(DVec3 a) {
  return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}

}  // namespace parhelion::PH_ISA
