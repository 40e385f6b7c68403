// An equidistant fisheye: the angle from the axis grows in proportion to the distance from the
// picture's middle, up to a circle as high as the picture; outside of it there is nothing to see.
#pragma once
#include "../projection.h"

namespace parhelion {

struct Fisheye {
  DVec3 eye, forward, right, down;
  double middle_x, middle_y;  // pixels
  double radius;              // of the circle, in pixels
  double rate;                // half turns per pixel

  static constexpr const char* doc =
      "a circle as high as the picture, `vfov` degrees across; equidistant";
  static constexpr CameraTraits traits = {180.0, 360.0, false, false, false, false, true};
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

inline void place(const Placement& p, Fisheye& c) {
  c = {p.eye,
       p.forward,
       p.right,
       p.down,
       0.5 * (p.columns - 1.0),
       0.5 * (p.rows - 1.0),
       0.5 * p.rows,
       p.vfov / 180.0 / p.rows};
}

PH_INLINE bool cast(const Fisheye& c, double x, double y, Vec3, DRay& ray) {
  const double dx = x - c.middle_x, dy = y - c.middle_y;
  const double r = compiler::sqrt(dx * dx + dy * dy);
  if (!(r <= c.radius)) return false;
  const DCosSin angle = cos_sin_pi(r * c.rate);
  const double across = r > 0.0 ? angle.s / r : 0.0;
  ray.origin = c.eye;
  ray.direction = c.forward * angle.c + (c.right * dx + c.down * dy) * across;
  return true;
}

inline Cone cone(const Fisheye& c) {
  return {0.0f, static_cast<float>(static_cast<double>(kPi) * c.rate)};
}

}  // namespace parhelion::PH_ISA
