#include "view.h"

#include <cmath>
#include <vector>

#include "errors.h"
#include "kernels.h"

namespace parhelion {
namespace {

using namespace baseline;

DVec3 finite_vector(const double (&v)[3], const char* name) {
  for (double x : v) {
    if (!std::isfinite(x)) throw SceneError(std::string("camera: ") + name + " is not finite");
  }
  return {v[0], v[1], v[2]};
}

[[noreturn]] void reject(const char* name, double x, const std::string& must) {
  throw SceneError(std::string("camera: ") + name + " is " + std::to_string(x) + "; must " + must);
}

void check_angle(double degrees, double most, const char* name) {
  const bool whole = most == 360.0;  // a fisheye may look all the way round
  if (!(degrees > 0.0 && (degrees < most || (whole && degrees == most)))) {
    const std::string range = std::to_string(static_cast<int>(most)) + " degrees";
    reject(name, degrees, whole ? "be above 0 and at most " + range : "lie between 0 and " + range);
  }
}

void check_length(double x, const char* name) {
  if (!std::isfinite(x) || x < 0.0) reject(name, x, "be finite and at least 0");
}

bool inside(DVec3 p, double margin, const Box& b) {
  return p.x - margin >= b.low.x && p.x + margin <= b.high.x && p.y - margin >= b.low.y &&
         p.y + margin <= b.high.y && p.z - margin >= b.low.z && p.z + margin <= b.high.z;
}

// What this kind of camera is told beyond where it stands, in normalised units; `distance` is that
// of the target.
void read_traits(const CameraInput& input, const CameraTraits& traits, double distance,
                 double scale, Placement& p) {
  const auto refuse = [&](bool given, bool taken, const char* name) {
    if (given && !taken) {
      throw SceneError("camera: projection '" + input.projection + "' has no " + name);
    }
  };
  refuse(input.fov != 0.0, traits.fov, "fov");
  refuse(input.vfov != 0.0, traits.max_vfov > 0.0, "vfov");
  refuse(input.height != 0.0, traits.height, "height");
  refuse(input.aperture_radius != 0.0, traits.lens, "aperture_radius");
  refuse(input.shift[0] != 0.0 || input.shift[1] != 0.0, traits.shift, "shift");

  if (input.fov != 0.0 && input.vfov != 0.0) throw SceneError("camera: give fov or vfov, not both");
  p.fov = input.fov;
  p.vfov = input.fov == 0.0 && input.vfov == 0.0 ? traits.preset_vfov : input.vfov;
  if (p.fov != 0.0) check_angle(p.fov, traits.max_vfov, "fov");
  if (p.vfov != 0.0) check_angle(p.vfov, traits.max_vfov, "vfov");
  if (traits.height) {
    if (input.height == 0.0) {
      throw SceneError("camera: projection '" + input.projection + "' needs a height");
    }
    if (!std::isfinite(input.height) || input.height < 0.0) {
      reject("height", input.height, "be finite and above 0");
    }
  }
  check_length(input.aperture_radius, "aperture_radius");
  check_length(input.focus_distance, "focus_distance");
  for (double x : input.shift) {
    if (!(std::abs(x) <= 1e6)) reject("shift", x, "lie between -1e6 and 1e6 pictures");
  }
  p.focus = (input.focus_distance > 0.0 ? input.focus_distance : distance) * scale;
  p.aperture = input.aperture_radius * scale;
  p.height = input.height * scale;
  p.shift_x = input.shift[0];
  p.shift_y = input.shift[1];
}

FilterTable filter_table(FilterKind kind, double r) {
  // The cumulative distribution of the first half, on a fine grid by Simpson's rule, then its
  // inverse at equal steps of the root.
  constexpr int fine = 8 * kFilterSteps;
  constexpr double h = 1.0 / fine;
  std::vector<double> sum(fine + 1, 0.0);
  const auto f = [&](double u) { return filter_value(kind, r * (1.0 - u), r); };
  double left = f(0.0);
  for (int i = 0; i < fine; ++i) {
    const double right = f((i + 1) * h);
    sum[i + 1] = sum[i] + (left + 4.0 * f((i + 0.5) * h) + right) * h / 6.0;
    left = right;
  }
  FilterTable table;
  int at = 0;
  for (int i = 0; i <= kFilterSteps; ++i) {
    const double root = static_cast<double>(i) / kFilterSteps;
    const double wanted = sum[fine] * root * root * root * root;
    while (at < fine - 1 && sum[at + 1] < wanted) ++at;
    const double width = sum[at + 1] - sum[at];
    const double part = width > 0.0 ? (wanted - sum[at]) / width : 0.0;
    table.offset[i] = static_cast<float>(r * ((at + part) * h - 1.0));
  }
  table.offset[0] = static_cast<float>(-r);
  table.offset[kFilterSteps] = 0.0f;
  return table;
}

}  // namespace

// With t towards the target and v up, b = v x t points to the viewer's left. The published formula
// p_ij = p_1m + q_x (i - 1) + q_y (j - 1), with p_1m = t d - g_x b - g_y v, therefore counts i from
// the right and j from the bottom. A picture is stored from the top left: column x is i = k - x and
// row y is j = m - y, so the steps are -q_x and -q_y.
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

  Placement p{};
  p.eye = eye * scale;
  p.forward = t_n;
  p.right = b_n * (input.mirrored ? 1.0 : -1.0);
  p.down = v_n * -1.0;
  p.columns = width;
  p.rows = height;
  std::string choices;
#define CAMERA(name, Type)                                                        \
  choices += (choices.empty() ? "" : ", ") + std::string(#name);                  \
  if (input.projection == #name) {                                                \
    read_traits(input, Type::traits, distance, scale, p);                         \
    Camera camera{};                                                              \
    camera.kind = CameraKind::name;                                               \
    place(p, camera.name);                                                        \
    camera.outside = !Type::traits.central || !inside(p.eye, p.aperture, bounds); \
    camera.lens = p.aperture > 0.0;                                               \
    camera.cone = cone(camera.name);                                              \
    return camera;                                                                \
  }
#include "../core/cameras.def"
#undef CAMERA
  throw SceneError("camera: unknown projection '" + input.projection + "' (choices: " + choices +
                   ")");
}

// Closed bodies look the same in every direction. A sheet of water without sides shows its back in
// some only, so the direction counts in which there are most. The directions are not quite along
// the axes, where modelled things have their edges.
Media media_around(const Scene& scene, const CameraInput& input, bool tree) {
  const DVec3 eye = DVec3{input.eye[0], input.eye[1], input.eye[2]} * scene.scale();
  Media most{};
  if (!scene.has_bodies() || !inside(eye, 0.0, scene.view().bounds)) return most;
  const DVec3 ways[] = {{1.0, 0.0131, 0.0173}, {0.0117, 1.0, 0.0149}, {0.0163, 0.0107, 1.0}};
  for (const DVec3& way : ways) {
    const Vec3 unit = to_float(way * (1.0 / length(way)));
    for (const Vec3& d : {unit, -unit}) {
      const Media media = kernels().media_around(scene.view(), to_float(eye), d, tree);
      if (media.count > most.count) most = media;
    }
  }
  return most;
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
  // Kept: it takes longer than a small picture, and the next one asks for the same. By each thread,
  // so that there is no lock which a fork might leave locked.
  thread_local FilterKind last{};
  thread_local double last_radius = 0.0;
  thread_local FilterTable table;
  if (kind != last || r != last_radius) {
    table = filter_table(kind, r);
    last = kind, last_radius = r;
  }
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
