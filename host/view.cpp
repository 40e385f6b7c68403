#include "view.h"

#include <cmath>
#include <vector>

#include "errors.h"

namespace parhelion {
namespace {

using namespace baseline;

DVec3 cross(DVec3 a, DVec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
double length(DVec3 a) { return std::sqrt(dot(a, a)); }

DVec3 finite_vector(const double (&v)[3], const char* name) {
  for (double x : v) {
    if (!std::isfinite(x)) throw SceneError(std::string("camera: ") + name + " is not finite");
  }
  return {v[0], v[1], v[2]};
}

// tan of half an angle in degrees.
double half_tangent(double degrees, const char* name) {
  if (!(degrees > 0.0 && degrees < 180.0)) {
    throw SceneError(std::string("camera: ") + name + " is " + std::to_string(degrees) +
                     "; must lie between 0 and 180 degrees");
  }
  const DCosSin half = cos_sin_pi(degrees / 360.0);
  return half.s / half.c;
}

bool inside(DVec3 p, double margin, const Box& b) {
  return p.x - margin >= b.low.x && p.x + margin <= b.high.x && p.y - margin >= b.low.y &&
         p.y + margin <= b.high.y && p.z - margin >= b.low.z && p.z + margin <= b.high.z;
}

}  // namespace

// With t towards the target and v up, b = v x t points to the viewer's left. The published formula
// p_ij = p_1m + q_x (i - 1) + q_y (j - 1), with p_1m = t d - g_x b - g_y v, therefore counts i from
// the right and j from the bottom. A picture is stored from the top left: column x is i = k - x and
// row y is j = m - y, so `right` is -q_x and `down` is -q_y.
Camera make_camera(const CameraInput& input, u32 width, u32 height, double scale,
                   const Box& bounds) {
  const DVec3 eye = finite_vector(input.eye, "eye"), target = finite_vector(input.target, "target");
  const DVec3 up = finite_vector(input.up, "up");
  const DVec3 t = target - eye;
  const double distance = length(t);
  if (!(distance > 0.0)) throw SceneError("camera: eye and target are the same point");
  if (!std::isfinite(distance)) throw SceneError("camera: eye and target are too far apart");
  const double up_length = length(up);
  if (!(up_length > 0.0) || !std::isfinite(up_length)) {
    throw SceneError("camera: up has no direction; it must be finite and not 0");
  }
  const DVec3 t_n = t * (1.0 / distance);
  const DVec3 b = cross(up * (1.0 / up_length), t_n);
  if (!(length(b) > 1e-9)) throw SceneError("camera: up is parallel to the viewing direction");
  const DVec3 b_n = b * (1.0 / length(b));
  const DVec3 v_n = cross(t_n, b_n);

  const auto optional_length = [](double x, const char* name) {
    if (!std::isfinite(x) || x < 0.0) {
      throw SceneError(std::string("camera: ") + name + " is " + std::to_string(x) +
                       "; must be finite and at least 0");
    }
  };
  optional_length(input.aperture_radius, "aperture_radius");
  optional_length(input.focus_distance, "focus_distance");
  const double d = (input.focus_distance > 0.0 ? input.focus_distance : distance) * scale;

  // The step between pixel centres, the same on both axes: 2 g_x / (k - 1) for the published field
  // of view, which spans from the first to the last centre of a row; a single column spans it all.
  // The vertical one spans the picture from edge to edge.
  double step;
  if (input.fov != 0.0) {
    step = 2.0 * d * half_tangent(input.fov, "fov") / (width > 1 ? width - 1.0 : 1.0);
  } else {
    step = 2.0 * d * half_tangent(input.vfov, "vfov") / height;
  }
  const DVec3 right = b_n * -step, down = v_n * -step;
  const DVec3 corner = t_n * d - right * (0.5 * (width - 1.0)) - down * (0.5 * (height - 1.0));
  const double lens = input.aperture_radius * scale;
  const DVec3 e = eye * scale;
  return {e, corner, right, down, b_n * -lens, v_n * lens, !inside(e, lens, bounds)};
}

FilterTable make_filter(const std::string& name, double radius) {
  FilterKind kind{};
  double own = 0.0;
  std::string choices;
#define FILTER(id, label, default_radius, doc)                   \
  choices += (choices.empty() ? "" : ", ") + std::string(label); \
  if (name == label) kind = FilterKind::id, own = default_radius;
#include "../core/filters.def"
#undef FILTER
  if (own == 0.0) throw SceneError("unknown filter '" + name + "' (choices: " + choices + ")");
  const double r = radius == 0.0 ? own : radius;
  if (!(r > 0.0 && r <= 32.0)) {
    throw SceneError("filter_radius is " + std::to_string(radius) +
                     "; must lie between 0 and 32 pixels");
  }
  // The cumulative distribution on a fine grid by Simpson's rule, then its inverse at equal steps.
  constexpr int fine = 16 * kFilterSteps;
  std::vector<double> sum(fine + 1, 0.0);
  const auto f = [&](double u) { return filter_value(kind, r * (2.0 * u - 1.0), r); };
  for (int i = 0; i < fine; ++i) {
    const double a = static_cast<double>(i) / fine, h = 1.0 / fine;
    sum[i + 1] = sum[i] + (f(a) + 4.0 * f(a + 0.5 * h) + f(a + h)) * h / 6.0;
  }
  FilterTable table;
  int at = 0;
  for (int i = 0; i <= kFilterSteps; ++i) {
    const double root = static_cast<double>(i) / kFilterSteps;
    const double wanted = sum[fine] * 0.5 * root * root * root * root;
    while (at < fine - 1 && sum[at + 1] < wanted) ++at;
    const double width = sum[at + 1] - sum[at];
    const double part = width > 0.0 ? (wanted - sum[at]) / width : 0.0;
    table.offset[i] = static_cast<float>(r * (2.0 * (at + part) / fine - 1.0));
  }
  table.offset[0] = static_cast<float>(-r);
  table.offset[kFilterSteps] = 0.0f;
  return table;
}

SamplerKind sampler_kind(const std::string& name) {
  std::string choices;
#define SAMPLER(id, doc)                                       \
  choices += (choices.empty() ? "" : ", ") + std::string(#id); \
  if (name == #id) return SamplerKind::id;
#include "../core/samplers.def"
#undef SAMPLER
  throw SceneError("unknown sampler '" + name + "' (choices: " + choices + ")");
}

}  // namespace parhelion
