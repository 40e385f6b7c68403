#include "rays.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <limits>
#include <string>

#include "../core/camera.h"
#include "../core/path.h"
#include "errors.h"
#include "place.h"
#include "threads.h"

namespace parhelion {
namespace {

// As many rays, and what is found of them, as stay in the first cache (16 KB).
constexpr size_t kRaysAtOnce = 256;

bool finite(const double* v) {
  return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.9g", x);
  return buffer;
}
std::string text(const double* v) {
  return std::string("(") + text(v[0]) + ", " + text(v[1]) + ", " + text(v[2]) + ")";
}

// What is wrong with a ray; nothing of most.
std::string problem(const UserRays& rays, size_t i) {
  const double *d = rays.directions[i], limit = rays.limits[i];
  const auto wrong = [&](const char* field, const std::string& what) {
    return std::string(field) + "[" + std::to_string(i) + "] " + what;
  };
  if (!rays.origins && rays.from[i].slot.leaf == kNone) {
    return wrong("origins", "has met nothing; rays set off from hits[hits.hit]");
  }
  if (rays.origins && !finite(rays.origins[i])) {
    return wrong("origins", "is " + text(rays.origins[i]) + "; must be finite");
  }
  if (!finite(d)) return wrong("directions", "is " + text(d) + "; must be finite");
  if (d[0] == 0.0 && d[1] == 0.0 && d[2] == 0.0) {
    return wrong("directions", "is (0, 0, 0), which is no direction");
  }
  if (!(limit >= 0.0)) return wrong("limits", "is " + text(limit) + "; must be >= 0");
  return {};
}

// Rays as the kernels take them. They begin where they enter the scene's bounds, `skipped` away
// from where they were given: float is too coarse far from the scene.
struct Start {
  Ray ray[kRaysAtOnce];
  float limit[kRaysAtOnce];
  double skipped[kRaysAtOnce];

  void set(const Scene& scene, const UserRays& rays, size_t i, size_t k) {
    const double* d = rays.directions[i];
    // By the largest, so that no square is beyond double.
    const double most = std::max({std::abs(d[0]), std::abs(d[1]), std::abs(d[2])});
    const double x = d[0] / most, y = d[1] / most, z = d[2] / most;
    const double inverse = 1.0 / std::sqrt(x * x + y * y + z * z);
    const DVec3 way = {x * inverse, y * inverse, z * inverse};
    const Vec3 direction = {static_cast<float>(way.x), static_cast<float>(way.y),
                            static_cast<float>(way.z)};
    const double scale = scene.scale();
    skipped[k] = 0.0;
    if (rays.origins == nullptr) {
      const Met& m = rays.from[i];
      const bool behind = baseline::dot(direction, m.normal) < 0.0f;
      ray[k] = {baseline::ray_origin(m.point, m.normal, m.error, behind), direction, m.slot,
                behind != (m.inside_out != 0)};
    } else {
      const double* o = rays.origins[i];
      const DVec3 from = {o[0] * scale, o[1] * scale, o[2] * scale};
      const double far = baseline::entry(from, way, scene.view().bounds);
      if (!(far < static_cast<double>(kInfinity))) {  // it passes the scene by
        ray[k] = {{0, 0, 0}, direction, kNoSlot, false};
        limit[k] = 0.0f;
        return;
      }
      skipped[k] = far;
      ray[k] = {{static_cast<float>(from.x + way.x * far), static_cast<float>(from.y + way.y * far),
                 static_cast<float>(from.z + way.z * far)},
                direction,
                kNoSlot,
                false};
    }
    const double left = rays.limits[i] * scale - skipped[k];
    limit[k] = static_cast<float>(std::max(left, 0.0));
  }
};

// f(first, count, start) of some rays after the other.
template <class F>
void for_rays(const Scene& scene, const UserRays& rays, size_t first, size_t last, const F& f) {
  const size_t chunks = (last - first + kRaysAtOnce - 1) / kRaysAtOnce;
#pragma omp parallel for schedule(dynamic, 1) if (last - first > kFewElements)
  for (size_t c = 0; c < chunks; ++c) {
    const size_t from = first + c * kRaysAtOnce, count = std::min(kRaysAtOnce, last - from);
    Start start;
    for (size_t k = 0; k < count; ++k) start.set(scene, rays, from + k, k);
    f(from, count, start);
  }
}

}  // namespace

void check(const UserRays& rays) {
  std::atomic<size_t> first{rays.n};  // that is none
  for_all(rays.n, [&](size_t i) {
    if (problem(rays, i).empty()) return;
    size_t known = first.load();
    while (i < known && !first.compare_exchange_weak(known, i)) {
    }
  });
  if (first < rays.n) throw SceneError(problem(rays, first));
}

void intersect(const Scene& scene, const Kernels& kernels, const UserRays& rays, size_t first,
               size_t last, bool tree, const RayHits& hits) {
  const SceneView& view = scene.view();
  for_rays(scene, rays, first, last, [&](size_t from, size_t count, const Start& start) {
    Hit found[kRaysAtOnce];
    kernels.intersect(view, start.ray, start.limit, count, tree, found);
    for (size_t k = 0; k < count; ++k) {
      const size_t i = from + k;
      PrimitivePlace place;
      Met& met = hits.met[i];
      const Hit& hit = found[k];
      const bool is = hit.slot.leaf != kNone;
      if (is) {
        const baseline::Surface s = baseline::surface_at(view, start.ray[k], hit);
        place = place_of(view, *s.shape, s.id, s.slot);
        met = {s.slot, s.point, s.normal, s.error, s.shape->inside_out ? 1u : 0u};
      } else {
        const float none = std::numeric_limits<float>::quiet_NaN();
        met = {kNoSlot, {none, none, none}, {none, none, none}, 0.0f, 0u};
      }
      hits.distance[i] = is ? (static_cast<double>(hit.t) + start.skipped[k]) * view.unit
                            : std::numeric_limits<double>::infinity();
      const auto number = [](u32 n) { return n == kNone ? std::int64_t{-1} : std::int64_t{n}; };
      hits.shape[i] = static_cast<std::int32_t>(number(place.shape));
      hits.primitive[i] = number(place.primitive);
      hits.instances[i] = static_cast<std::int32_t>(number(place.instances));
      hits.copy[i] = number(place.copy);
    }
  });
}

void occluded(const Scene& scene, const Kernels& kernels, const UserRays& rays, size_t first,
              size_t last, bool tree, u8* found) {
  for_rays(scene, rays, first, last, [&](size_t from, size_t count, const Start& start) {
    kernels.occluded(scene.view(), start.ray, start.limit, count, tree, found + from);
  });
}

}  // namespace parhelion
