// A pinhole or a thin lens before a flat picture: docs/camera.md has the formulas.
#pragma once
#include "../projection.h"

namespace parhelion {

// `corner` leads from the eye to the centre of the top left pixel in the plane of focus, `right`
// and `down` from a pixel to its neighbours; the lens axes span the lens, their length its radius.
struct Perspective {
  DVec3 eye, corner, right, down, lens_x, lens_y;
  double focus;

  static constexpr const char* doc = "straight lines stay straight; pinhole or thin lens";
  static constexpr CameraTraits traits = {40.0, 180.0, true, true, false, true, true};
};

}  // namespace parhelion

namespace parhelion::PH_ISA {

// tan of half an angle in degrees.
inline double half_tangent(double degrees) {
  const DCosSin half = cos_sin_pi(degrees / 360.0);
  return half.s / half.c;
}

inline void place(const Placement& p, Perspective& c) {
  // The step between pixel centres, the same on both axes: 2 g_x / (k - 1) for the published field
  // of view, which spans from the first to the last centre of a row; a single column spans it all.
  // The vertical one spans the picture from edge to edge.
  const double d = p.focus, k = p.columns, m = p.rows;
  const double step = p.fov != 0.0 ? 2.0 * d * half_tangent(p.fov) / (k > 1.0 ? k - 1.0 : 1.0)
                                   : 2.0 * d * half_tangent(p.vfov) / m;
  c.eye = p.eye;
  c.right = p.right * step;
  c.down = p.down * step;
  c.corner = p.forward * d - c.right * (0.5 * (k - 1.0) - p.shift_x * k) -
             c.down * (0.5 * (m - 1.0) - p.shift_y * m);
  c.lens_x = p.right * p.aperture;
  c.lens_y = p.down * -p.aperture;
  c.focus = d;
}

PH_INLINE bool cast(const Perspective& c, double x, double y, Vec3 lens, DRay& ray) {
  const DVec3 on_lens = c.lens_x * lens.x + c.lens_y * lens.y;
  const DVec3 through = c.corner + c.right * x + c.down * y - on_lens;
  ray.direction = through * (1.0 / compiler::sqrt(dot(through, through)));
  ray.origin = c.eye + on_lens;
  return true;
}

inline Cone cone(const Perspective& c) {
  return {0.0f, static_cast<float>(length(c.right) / c.focus)};
}

}  // namespace parhelion::PH_ISA
