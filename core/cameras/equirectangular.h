// Everything around the eye: columns are longitudes, rows latitudes.
#pragma once
#include "../projection.h"

namespace parhelion {

struct Equirectangular {
  DVec3 eye, forward, right, down;
  double columns, rows;

  static constexpr const char* doc =
      "360 x 180 degrees; longitude to the right, the target in the middle";
  static constexpr CameraTraits traits = {0.0, 0.0, false, false, false, false, true};
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

inline void place(const Placement& p, Equirectangular& c) {
  c = {p.eye, p.forward, p.right, p.down, p.columns, p.rows};
}

// Angles in half turns, longitude from straight behind and colatitude from straight up. A wide
// filter reaches beyond the picture's edges: on around, and over the poles.
PH_INLINE bool cast(const Equirectangular& c, double x, double y, Vec3, DRay& ray) {
  // the cosine's argument must not be negative, and 2 is a whole turn
  const DCosSin longitude = cos_sin_pi(2.0 + 2.0 * (x + 0.5) / c.columns);
  const DCosSin colatitude = cos_sin_pi(2.0 + (y + 0.5) / c.rows);
  const DVec3 level = c.forward * -longitude.c + c.right * -longitude.s;
  ray.origin = c.eye;
  ray.direction = level * colatitude.s + c.down * -colatitude.c;
  return true;
}

inline Cone cone(const Equirectangular& c) {
  const double column = 2.0 * static_cast<double>(kPi) / c.columns;
  const double row = static_cast<double>(kPi) / c.rows;
  return {0.0f, static_cast<float>(column < row ? column : row)};
}

}  // namespace parhelion::PH_ISA
