#include "rays.h"

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <chrono>
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

constexpr std::chrono::milliseconds kBetweenStops{50};

DVec3 vector(const Numbers& of, size_t i) { return {of.at(i, 0), of.at(i, 1), of.at(i, 2)}; }

bool finite(DVec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

bool starts(const UserRays& rays, size_t i) {
  return rays.from ? rays.from[i].slot.leaf != kNone : finite(vector(rays.origins, i));
}
bool goes(const UserRays& rays, size_t i) {
  const DVec3 d = vector(rays.directions, i);
  return finite(d) && (d.x != 0.0 || d.y != 0.0 || d.z != 0.0);
}

// Beyond float, infinite: a conversion has no meaning there.
float rounded(double x) {
  const double most = static_cast<double>(std::numeric_limits<float>::max());
  return std::abs(x) <= most ? static_cast<float>(x)
                             : std::copysign(kInfinity, x < 0 ? -1.0f : 1.0f);
}

DVec3 unit(DVec3 v) {
  double square = baseline::dot(v, v);
  if (!(square > 0x1p-900 && square < 0x1p900)) {  // by the largest: double has no such squares
    const double most = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
    v = {v.x / most, v.y / most, v.z / most};
    square = baseline::dot(v, v);
  }
  const double inverse = 1.0 / std::sqrt(square);
  return {v.x * inverse, v.y * inverse, v.z * inverse};
}

// The greatest float that is no more than a number >= 0.
float below(double x) {
  const float f = rounded(x);
  return static_cast<double>(f) > x ? std::nextafter(f, 0.0f) : f;
}

bool lies_in(DVec3 p, const Box& b) {
  return p.x >= b.low.x && p.x <= b.high.x && p.y >= b.low.y && p.y <= b.high.y && p.z >= b.low.z &&
         p.z <= b.high.z;
}

std::string text(double x) {
  char buffer[40];
  std::snprintf(buffer, sizeof buffer, "%.9g", x);
  return buffer;
}

// What is wrong with a ray that is none.
std::string problem(const UserRays& rays, size_t i) {
  const auto wrong = [&](const char* field, const std::string& what) {
    return std::string(field) + "[" + std::to_string(i) + "] " + what;
  };
  const auto no_vector = [&](const char* field, DVec3 v) {
    return wrong(field, std::string("is (") + text(v.x) + ", " + text(v.y) + ", " + text(v.z) +
                            (finite(v) ? "), which is no direction" : "); must be finite"));
  };
  if (!starts(rays, i)) {
    return rays.from ? wrong("origins", "has met nothing; rays set off from hits[hits.hit]")
                     : no_vector("origins", vector(rays.origins, i));
  }
  if (!goes(rays, i)) return no_vector("directions", vector(rays.directions, i));
  return wrong("limits", "is " + text(rays.limits.at(i, 0)) + "; must be >= 0");
}

// Rays as the kernels take them. They begin where they enter the scene's bounds, `skipped` away
// from where they were given: float is too coarse far from the scene.
struct Start {
  Ray ray[kRaysAtOnce];
  float limit[kRaysAtOnce];
  double skipped[kRaysAtOnce];

  void set(const Scene& scene, const UserRays& rays, size_t i, size_t k) {
    const DVec3 way = unit(vector(rays.directions, i));
    const Vec3 direction = {static_cast<float>(way.x), static_cast<float>(way.y),
                            static_cast<float>(way.z)};
    const double scale = scene.scale();
    skipped[k] = 0.0;
    if (rays.from) {
      const Met& m = rays.from[i];
      const bool behind = baseline::dot(direction, m.normal) < 0.0f;
      ray[k] = {baseline::ray_origin(m.point, m.normal, m.error, behind), direction, m.slot,
                behind != (m.inside_out != 0)};
    } else {
      const DVec3 o = vector(rays.origins, i), from = {o.x * scale, o.y * scale, o.z * scale};
      const Box& bounds = scene.view().bounds;  // within which most rays begin
      const double far = lies_in(from, bounds) ? 0.0 : baseline::entry(from, way, bounds);
      if (!(far < static_cast<double>(kInfinity))) {  // it passes the scene by
        ray[k] = {{0, 0, 0}, direction, kNoSlot, false};
        limit[k] = 0.0f;
        return;
      }
      skipped[k] = far;
      ray[k] = {{rounded(from.x + way.x * far), rounded(from.y + way.y * far),
                 rounded(from.z + way.z * far)},
                direction,
                kNoSlot,
                false};
    }
    // What was told of a hit, as a limit, leads back to it in spite of its rounding.
    const double most = rays.limits.at(i, 0) * scale * (1.0 + 0x1p-52);
    limit[k] = below(std::max(most - skipped[k], 0.0));
  }
};

// f(first, count, start) of all rays, some at a time. Returns whether it was not stopped. tree: or
// else they are slow, and fewer at a time.
template <class F>
bool for_rays(const Scene& scene, const UserRays& rays, bool tree, const Stop& stop, const F& f) {
  const size_t most = tree ? kRaysAtOnce : 16, chunks = (rays.n + most - 1) / most;
  std::atomic<bool> stopped{false};
#pragma omp parallel if (rays.n > kFewElements)
  {
    const bool asks = omp_get_thread_num() == 0;
    auto asked = std::chrono::steady_clock::now();
#pragma omp for schedule(dynamic, 1)
    for (size_t c = 0; c < chunks; ++c) {
      if (stopped.load(std::memory_order_relaxed)) continue;
      const size_t from = c * most, count = std::min(most, rays.n - from);
      Start start;
      for (size_t k = 0; k < count; ++k) start.set(scene, rays, from + k, k);
      f(from, count, start);
      if (!asks || std::chrono::steady_clock::now() < asked + kBetweenStops) continue;
      if (stop()) stopped = true;
      asked = std::chrono::steady_clock::now();
    }
  }
  return !stopped;
}

}  // namespace

void check(const UserRays& rays) {
  std::atomic<size_t> first{rays.n};  // that is none
  for_all(rays.n, [&](size_t i) {
    if (starts(rays, i) && goes(rays, i) && rays.limits.at(i, 0) >= 0.0) return;
    size_t known = first.load();
    while (i < known && !first.compare_exchange_weak(known, i)) {
    }
  });
  if (first < rays.n) throw SceneError(problem(rays, first));
}

bool intersect(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
               const RayHits& hits, const Stop& stop) {
  const SceneView& view = scene.view();
  return for_rays(scene, rays, tree, stop, [&](size_t from, size_t count, const Start& start) {
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
      const double distance = (static_cast<double>(hit.t) + start.skipped[k]) * view.unit;
      hits.distance[i] =
          is ? std::min(distance, rays.limits.at(i, 0)) : std::numeric_limits<double>::infinity();
      const auto number = [](u32 n) { return n == kNone ? std::int64_t{-1} : std::int64_t{n}; };
      hits.shape[i] = static_cast<std::int32_t>(number(place.shape));
      hits.primitive[i] = number(place.primitive);
      hits.instances[i] = static_cast<std::int32_t>(number(place.instances));
      hits.copy[i] = number(place.copy);
    }
  });
}

bool occluded(const Scene& scene, const Kernels& kernels, const UserRays& rays, bool tree,
              u8* found, const Stop& stop) {
  return for_rays(scene, rays, tree, stop, [&](size_t from, size_t count, const Start& start) {
    kernels.occluded(scene.view(), start.ray, start.limit, count, tree, found + from);
  });
}

}  // namespace parhelion
