// Rays side by side: lengths across the view keep their size at any distance.
#pragma once
#include "../projection.h"

namespace parhelion {

// `corner` is the centre of the top left pixel in the plane of the eye.
struct Orthographic {
  DVec3 corner, forward, right, down;

  static constexpr const char* doc = "no vanishing points: `height` scene units from top to bottom";
  static constexpr CameraTraits traits = {0.0, 0.0, false, false, true, true, false};
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

inline void place(const Placement& p, Orthographic& c) {
  const double step = p.height / p.rows;
  c.forward = p.forward;
  c.right = p.right * step;
  c.down = p.down * step;
  c.corner = p.eye - c.right * (0.5 * (p.columns - 1.0) - p.shift_x * p.columns) -
             c.down * (0.5 * (p.rows - 1.0) - p.shift_y * p.rows);
}

PH_INLINE bool cast(const Orthographic& c, double x, double y, Vec3, DRay& ray) {
  ray.origin = c.corner + c.right * x + c.down * y;
  ray.direction = c.forward;
  return true;
}

inline Cone cone(const Orthographic& c) { return {static_cast<float>(length(c.right)), 0.0f}; }

}  // namespace parhelion::PH_ISA
